// Agreement of two annotators: figures, the patches on which they differ, and blind labelling.

import { onFailure } from "../core/api.js";
import { choice, classButtons } from "../core/controls.js";
import { button, el, part, say, soon } from "../core/dom.js";
import { lookKeys } from "../core/keys.js";
import { mission, onChange, onReload, onSetting, who } from "../core/mission.js";
import { lookAtShapes } from "../core/pictures.js";
import { addView, go } from "../core/router.js";
import { loadBlindList } from "../labelling/blind_list.js";
import { onLabels } from "../saving/labels.js";
import { patchesAre } from "../saving/saver.js";
import { classTable, confusionTable, figures } from "./agreement_tables.js";
import { blindForm, blindProgress, continueBlind } from "./blind_panel.js";
import { selectionKeys } from "./tile_grid.js";
import { Asking, DecisionSheet, settle, settledOf, sheetRow } from "./tile_sheet.js";
/** @import { Agreement, ApiError, Child, Conflict, Pair, SheetPlace } from "../types.js" */

/** The conflicts of one comparison. @extends {DecisionSheet<Conflict>} */
class ConflictSheet extends DecisionSheet {
  // `onChoice`: other labels were chosen to look at.
  /** @param {Pair} people @param {?SheetPlace} place @param {() => void} onChoice */
  constructor(people, place, onChoice) {
    super({
      label: "patches on which they differ",
      filters: "which conflicts",
      decided: "settled",
      margin: 0.25,
      place: { only: null, unsure: null, ...place },
    });
    this.people = people;
    this.onChoice = onChoice;
    this.element = el("div", { class: "conflicts" },
      el("div", { class: "bar" }, el("h2", { text: "Conflicts" }), this.filters),
      this.bar(
        "settle the selected conflicts",
        ...classButtons((name) => this.settle(name)),
        button("take back", () => this.settle(null), { title: "no longer settled (Delete)" }),
      ),
      this.tiles,
    );
  }

  /** Take what the server found; `anew`: show it from where the person was, else tiles stay. */
  take(/** @type {Conflict[]} */ conflicts, /** @type {{anew: boolean}} */ { anew }) {
    this.patches = conflicts;
    this.view.unsure ??= !conflicts.some((conflict) => conflict.sure);
    if (anew) this.show();
    else this.showFilters();
  }

  /** Show those too that one of them was unsure of, or no longer. */
  withUnsure() {
    this.choose({ unsure: !this.view.unsure });
  }

  /** Show `only` the conflicts of two labels, {a, b}; of the same two again, or of null: all. */
  choosePair(/** @type {?Pair} */ only) {
    const { only: now } = this.view;
    const again = only && now?.a === only.a && now?.b === only.b;
    this.choose({ only: again ? null : only });
    this.onChoice();
    this.grid.focus();
  }

  /** Settle the selected conflicts, or the one under the cursor and go on; null takes it back. */
  settle(/** @type {?string} */ label) {
    const targets = this.targets();
    if (targets.length === 0) return;
    const single = this.grid.selection.chosen.size === 0;
    const count = settle(targets, () => label);
    this.goOn(single && label !== null);
    const now = label === null ? "open again" : `settled as ${label}, both opinions are kept`;
    say(count === 0 ? "Nothing to change." : `${patchesAre(count)} ${now}; Ctrl+Z undoes.`);
  }

  decisionOn(/** @type {Conflict} */ conflict) {
    return settledOf(conflict);
  }

  keeps(/** @type {Conflict} */ conflict) {
    const { only, unsure } = this.view;
    if (only) return conflict.a === only.a && conflict.b === only.b;
    return Boolean(unsure) || conflict.sure;
  }

  moreFilters() {
    const { only, unsure } = this.view;
    if (only) return [button(`${only.a} / ${only.b} ×`, () => this.choosePair(null))];
    const count = this.patches.filter((conflict) => !conflict.sure).length;
    if (count === 0) return [];
    const options = { "aria-pressed": String(unsure), title: "show them too (e)" };
    return [button(`with one unsure ${count}`, () => this.withUnsure(), options)];
  }

  /** @param {Conflict} conflict @returns {[string, string, string][]} */
  opinions({ a, b }) {
    return [["A", a, `${this.people.a} ${a}`], ["B", b, `${this.people.b} ${b}`]];
  }

  decisionWords(/** @type {?string} */ settled) {
    return settled === null ? "not settled" : `settled as ${settled}`;
  }

  chosenWords(/** @type {number} */ count) {
    return `Settle ${count > 0 ? `${count} selected` : "this one"} as`;
  }

  emptyWords() {
    if (this.patches.length === 0) return "They agree on every patch that both labelled.";
    return this.view.which === "open" ? "Everything is settled." : "There is no such conflict.";
  }

  about(/** @type {Conflict} */ conflict) {
    const settled = settledOf(conflict);
    const known = settled === conflict.settled && conflict.settled_by;
    return [
      `${this.people.a}: ${conflict.a}`,
      `${this.people.b}: ${conflict.b}`,
      settled === null ? "Not settled." : `Settled as ${settled} by ${known || who()}.`,
      "Enter opens its frame.",
    ];
  }
}

// ---- The view

/** @typedef {ReturnType<typeof build>} Comparison */

/** The view's state; all of it. */
const view = {
  /** @type {?HTMLElement} Null while another view is shown. */
  root: null,
  /** @type {?Comparison} The elements of a comparison; null while there is none. */
  parts: null,
  /** @type {?Pair} Names. */
  pair: null,
  /** @type {?Agreement} The last answer. */
  found: null,
  /** @type {?{pair: Pair, place: SheetPlace}} Where the person was, to come back to. */
  last: null,
};
const asking = new Asking();

/** The sheet of a comparison whose figures are there; else null. */
function shownSheet() {
  return view.found && view.parts ? view.parts.sheet : null;
}

async function show(/** @type {HTMLElement} */ root, /** @type {string[]} */ [a, b]) {
  leave();
  view.root = root;
  if (mission.blind) return showBlind();
  view.pair = pairFor(a, b);
  if (!view.pair) return showAlone();
  const here = (view.parts = build(view.pair));
  root.replaceChildren(here.root);
  here.sheet.grid.focus();
  await lookAtShapes();
  if (here === view.parts) await compare({ anew: true });
}

function leave() {
  const sheet = shownSheet();
  if (sheet) view.last = { pair: sheet.people, place: sheet.place() };
  asking.stop();
  view.parts?.sheet.close();
  view.parts = null;
  view.found = null;
}

function hide() {
  leave();
  view.root = null;
}

/** As the address says, else somebody else with whom works here. @returns {?Pair} */
function pairFor(/** @type {string} */ a, /** @type {string} */ b) {
  const names = mission.annotators;
  if (names.length < 2) return null;
  const known = (/** @type {string} */ name) => names.includes(name);
  const second = known(b) ? b : who();
  const first = known(a) && a !== second ? a : (names.find((name) => name !== second) ?? "");
  return { a: first, b: second };
}

function addressOf(/** @type {Pair} */ { a, b }) {
  return `#/agreement/${encodeURIComponent(a)}/${encodeURIComponent(b)}`;
}

// ---- What is shown where nothing can be compared

async function showBlind() {
  let fault = "";
  await loadBlindList().catch(
    onFailure(({ message }) => (fault = `The list of frames could not be loaded: ${message}.`)),
  );
  if (view.root && mission.blind) showAlso(blindProgress(fault));
}

function showAlone() {
  const [only] = mission.annotators;
  const text = `Only ${only} has worked on this mission so far: there is nothing to compare.`;
  showAlso(el("p", { class: "empty-state", text }), blindForm({ of: only }));
}

function showForm(/** @type {Pair} */ pair) {
  const form = blindForm({ of: pair.a, onCancel: () => go(addressOf(pair)) });
  leave();
  showAlso(form);
  part(form, "input").focus();
}

function showAlso(/** @type {Child[]} */ ...children) {
  const options = { class: "agreement-alone", tabindex: -1, "data-home": true };
  view.root?.replaceChildren(el("section", options, ...children));
}

// ---- The comparison

function build(/** @type {Pair} */ pair) {
  const numbers = el("div", { class: "agreement-numbers" });
  const words = el("p", { class: "agreement-words", role: "status" });
  const { last } = view;
  const same = last?.pair.a === pair.a && last.pair.b === pair.b;
  const sheet = new ConflictSheet(pair, same ? last.place : null, showNumbers);
  const options = { class: "agreement tiles-view", "aria-label": "agreement of two annotators" };
  const section = el("section", options,
    el("div", { class: "bar" },
      person(pair, "a"),
      button("⇄", () => swap(pair), { title: "exchange them (s)", "aria-label": "exchange them" }),
      person(pair, "b"),
      button("Label blind …", () => showForm(pair), {
        title: "label again without seeing this (b)",
      }),
      words,
    ),
    el("div", { class: "agreement-columns" }, numbers, sheet.element),
  );
  return { root: section, numbers, words, sheet };
}

function person(/** @type {Pair} */ pair, /** @type {"a" | "b"} */ side) {
  const letter = side.toUpperCase();
  const options = { "aria-label": `annotator ${letter}` };
  const select = choice(mission.annotators, pair[side], options);
  select.addEventListener("change", () => {
    const next = { ...pair, [side]: select.value };
    if (next.a === next.b) next[side === "a" ? "b" : "a"] = pair[side];
    go(addressOf(next));
  });
  return el("label", { class: "person-choice" }, el("strong", { text: letter }), select);
}

function swap(/** @type {Pair} */ { a, b }) {
  go(addressOf({ a: b, b: a }));
}

async function compare(/** @type {{anew: boolean}} */ { anew }) {
  const { parts, pair } = view;
  if (!parts || !pair) return;
  if (!view.found) parts.words.textContent = "Comparing …";
  const failed = (/** @type {ApiError} */ error) => showFault(parts, pair, error);
  const answer = await asking.get("/api/agreement", pair, failed);
  if (!answer) return;
  view.found = answer;
  parts.words.textContent = "";
  parts.root.classList.remove("not-compared");
  parts.sheet.take(answer.conflicts, { anew });
  showNumbers();
}

/** @param {Comparison} parts @param {Pair} pair @param {ApiError} error */
function showFault(parts, pair, { status, message }) {
  const yet = status === 404 || status === 409;
  const words = yet
    ? `${pair.a} and ${pair.b} cannot be compared yet: ${message}.`
    : `The labels could not be compared: ${message}.`;
  const hint = "A second person labels the same frames blind: “Label blind …” begins that.";
  parts.root.classList.add("not-compared");
  parts.words.textContent = "";
  parts.numbers.replaceChildren(
    el("p", { class: "empty-state", text: words, role: "status" }),
    yet ? el("p", { class: "empty-state", text: hint }) : "",
  );
}

function showNumbers() {
  const { parts, found } = view;
  if (!parts || !found) return;
  const { sheet, numbers } = parts;
  const { only = null } = sheet.view;
  const confusion = confusionTable(found, only, (chosen) => sheet.choosePair(chosen));
  numbers.replaceChildren(figures(found), confusion, classTable(found));
}

// ---- Keys

function enter() {
  if (mission.blind) continueBlind();
  else view.parts?.sheet.openCurrent();
}

function formOrNothing() {
  return view.parts ? showForm(view.parts.sheet.people) : false;
}

const row = sheetRow(shownSheet);

addView("agreement", {
  title: "Agreement",
  show,
  hide,
  link: () => (view.pair ? addressOf(view.pair) : "#/agreement"),
  classKeys: (name) => shownSheet()?.settle(name),
  keys: [
    { keys: ["class key"], does: "settle the selected conflicts as this class" },
    row(["Delete", "Backspace"], "take settlements back", (sheet) => sheet.settle(null)),
    { keys: ["Enter"], does: "open the frame of the patch; blind: the next frame", run: enter },
    row(["/"], "filter: open, settled, all", (sheet) => sheet.nextWhich()),
    row(["e"], "also where one of them is unsure, or not", (sheet) => sheet.withUnsure()),
    row(["d", "PageDown"], "next page", (sheet) => sheet.turn(1)),
    row(["a", "PageUp"], "previous page", (sheet) => sheet.turn(-1)),
    row(["s"], "exchange the two annotators", (sheet) => swap(sheet.people)),
    { keys: ["b"], does: "label blind", run: formOrNothing },
    row(["r"], "compare anew", () => compare({ anew: true })),
    ...lookKeys,
    ...selectionKeys(() => view.parts?.sheet.grid),
  ],
});

onLabels(soon(() => shownSheet()?.refresh()));
onChange((what) => {
  // Heard again of the server: what is selected stays selected.
  const { root, pair, found } = view;
  if (found && what === "all") compare({ anew: false });
  else if (root && what === "all") show(root, pair ? [pair.a, pair.b] : []);
  else if (root && mission.blind) showBlind();
  // Figures are computed anew, and the tiles stay where they are.
  else if (found) asking.soon(() => compare({ anew: false }));
});
onReload(() => {
  if (view.root) leave();
  view.last = null;
  if (view.root && mission.blind) showBlind();
  else view.root?.replaceChildren();
});
onSetting((name) => {
  if (!view.found || name !== "enhance") return;
  shownSheet()?.redraw();
  showNumbers();
});
