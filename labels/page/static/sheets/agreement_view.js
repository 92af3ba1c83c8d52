// Agreement of two annotators: figures, the patches on which they differ, and blind labelling.

import { onFailure } from "../core/api.js";
import { choice, classButtons } from "../core/controls.js";
import { button, el, say, soon } from "../core/dom.js";
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

/**
 * The conflicts of one comparison, as the server names them: {camera, frame, cell, a, b, sure,
 * settled, settled_by}. Of the view, `only`: {a, b}, the labels that conflicts must have;
 * `unsure`: also those where one was not sure, null while nobody chose.
 */
class ConflictSheet extends DecisionSheet {
  /** `people`: {a, b}, names; `onChoice()`: other labels were chosen to look at. */
  constructor(people, place, onChoice) {
    super({
      label: "patches on which they differ",
      filters: "which conflicts",
      decided: "settled",
      margin: 0.25,
      place: { only: null, unsure: null, ...place },
    });
    Object.assign(this, { people, onChoice });
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
  take(conflicts, { anew }) {
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
  choosePair(only) {
    const { only: now } = this.view;
    const again = only && now?.a === only.a && now?.b === only.b;
    this.choose({ only: again ? null : only });
    this.onChoice();
    this.grid.focus();
  }

  /** Settle the selected conflicts, or the one under the cursor and go on; null takes it back. */
  settle(label) {
    const targets = this.targets();
    if (targets.length === 0) return;
    const single = this.grid.selection.chosen.size === 0;
    const count = settle(targets, () => label);
    this.goOn(single && label !== null);
    const now = label === null ? "open again" : `settled as ${label}, both opinions are kept`;
    say(count === 0 ? "Nothing to change." : `${patchesAre(count)} ${now}; Ctrl+Z undoes.`);
  }

  decisionOn(conflict) {
    return settledOf(conflict);
  }

  keeps(conflict) {
    const { only, unsure } = this.view;
    if (only) return conflict.a === only.a && conflict.b === only.b;
    return unsure || conflict.sure;
  }

  moreFilters() {
    const { only, unsure } = this.view;
    if (only) return [button(`${only.a} / ${only.b} ×`, () => this.choosePair(null))];
    const count = this.patches.filter((conflict) => !conflict.sure).length;
    if (count === 0) return [];
    const options = { "aria-pressed": String(unsure), title: "show them too (e)" };
    return [button(`with one unsure ${count}`, () => this.withUnsure(), options)];
  }

  opinions({ a, b }) {
    return [["A", a, `${this.people.a} ${a}`], ["B", b, `${this.people.b} ${b}`]];
  }

  decisionWords(settled) {
    return settled === null ? "not settled" : `settled as ${settled}`;
  }

  chosenWords(count) {
    return `Settle ${count > 0 ? `${count} selected` : "this one"} as`;
  }

  emptyWords() {
    if (this.patches.length === 0) return "They agree on every patch that both labelled.";
    return this.view.which === "open" ? "Everything is settled." : "There is no such conflict.";
  }

  about(conflict) {
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

let root = null; // null while another view is shown
let parts = null; // the elements of a comparison; null while there is none
let pair = null; // {a, b}: names
let found = null; // the last answer of /api/agreement
const asking = new Asking();
let last = null; // {pair, place}: where the person was, to come back to

async function show(element, [a, b]) {
  leave();
  root = element;
  if (mission.blind) return showBlind();
  pair = pairFor(a, b);
  if (!pair) return showAlone();
  const here = (parts = build());
  root.replaceChildren(parts.root);
  parts.sheet.grid.focus();
  await lookAtShapes();
  if (here === parts) await compare({ anew: true });
}

function leave() {
  if (found) last = { pair, place: parts.sheet.place() };
  asking.stop();
  parts?.sheet.close();
  parts = null;
  found = null;
}

function hide() {
  leave();
  root = null;
}

/** Who is compared: as the address says, else somebody else with whom works here. */
function pairFor(a, b) {
  const names = mission.annotators;
  if (names.length < 2) return null;
  const known = (name) => names.includes(name);
  const second = known(b) ? b : who();
  const first = known(a) && a !== second ? a : names.find((name) => name !== second);
  return { a: first, b: second };
}

function addressOf({ a, b }) {
  return `#/agreement/${encodeURIComponent(a)}/${encodeURIComponent(b)}`;
}

// ---- What is shown where nothing can be compared

async function showBlind() {
  let fault = "";
  const explain = ({ message }) => (fault = `The list of frames could not be loaded: ${message}.`);
  await loadBlindList().catch(onFailure(explain));
  if (root && mission.blind) showAlso(blindProgress(fault));
}

function showAlone() {
  const [only] = mission.annotators;
  const text = `Only ${only} has worked on this mission so far: there is nothing to compare.`;
  showAlso(el("p", { class: "empty-state", text }), blindForm({ of: only }));
}

function showForm() {
  const back = () => go(addressOf(pair));
  const form = blindForm({ of: pair.a, onCancel: back });
  leave();
  showAlso(form);
  form.querySelector("input").focus();
}

function showAlso(...children) {
  const options = { class: "agreement-alone", tabindex: -1, "data-home": true };
  root.replaceChildren(el("section", options, ...children));
}

// ---- The comparison

function build() {
  const numbers = el("div", { class: "agreement-numbers" });
  const words = el("p", { class: "agreement-words", role: "status" });
  const same = last?.pair.a === pair.a && last.pair.b === pair.b;
  const sheet = new ConflictSheet(pair, same ? last.place : null, showNumbers);
  const options = { class: "agreement tiles-view", "aria-label": "agreement of two annotators" };
  const section = el("section", options,
    el("div", { class: "bar" },
      person("a"),
      button("⇄", swap, { title: "exchange them (s)", "aria-label": "exchange them" }),
      person("b"),
      button("Label blind …", showForm, { title: "label again without seeing this (b)" }),
      words,
    ),
    el("div", { class: "agreement-columns" }, numbers, sheet.element),
  );
  return { root: section, numbers, words, sheet };
}

function person(side) {
  const choose = ({ target }) => {
    const next = { ...pair, [side]: target.value };
    if (next.a === next.b) next[side === "a" ? "b" : "a"] = pair[side];
    go(addressOf(next));
  };
  const letter = side.toUpperCase();
  const options = { "aria-label": `annotator ${letter}`, on: { change: choose } };
  const select = choice(mission.annotators, pair[side], options);
  return el("label", { class: "person-choice" }, el("strong", { text: letter }), select);
}

function swap() {
  go(addressOf({ a: pair.b, b: pair.a }));
}

async function compare({ anew }) {
  if (!found) parts.words.textContent = "Comparing …";
  const answer = await asking.get("/api/agreement", pair, showFault);
  if (!answer) return;
  found = answer;
  parts.words.textContent = "";
  parts.root.classList.remove("not-compared");
  parts.sheet.take(found.conflicts, { anew });
  showNumbers();
}

function showFault({ status, message }) {
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
  const { sheet, numbers } = parts;
  const { only } = sheet.view;
  const confusion = confusionTable(found, only, (chosen) => sheet.choosePair(chosen));
  numbers.replaceChildren(figures(found), confusion, classTable(found));
}

// ---- Keys

function enter() {
  if (mission.blind) continueBlind();
  else parts?.sheet.openCurrent();
}

const row = sheetRow(() => found && parts.sheet);

addView("agreement", {
  title: "Agreement",
  show,
  hide,
  link: () => (pair ? addressOf(pair) : "#/agreement"),
  classKeys: (name) => found && parts.sheet.settle(name),
  keys: [
    { keys: ["class key"], does: "settle the selected conflicts as this class" },
    row(["Delete", "Backspace"], "take settlements back", (sheet) => sheet.settle(null)),
    { keys: ["Enter"], does: "open the frame of the patch; blind: the next frame", run: enter },
    row(["/"], "filter: open, settled, all", (sheet) => sheet.nextWhich()),
    row(["e"], "also where one of them is unsure, or not", (sheet) => sheet.withUnsure()),
    row(["d", "PageDown"], "next page", (sheet) => sheet.turn(1)),
    row(["a", "PageUp"], "previous page", (sheet) => sheet.turn(-1)),
    row(["s"], "exchange the two annotators", swap),
    { keys: ["b"], does: "label blind", run: () => (parts ? showForm() : false) },
    row(["r"], "compare anew", () => compare({ anew: true })),
    ...lookKeys,
    ...selectionKeys(() => parts?.sheet.grid),
  ],
});

onLabels(soon(() => found && parts.sheet.refresh()));
onChange((what) => {
  // Heard again of the server: what is selected stays selected.
  if (found && what === "all") compare({ anew: false });
  else if (root && what === "all") show(root, pair ? [pair.a, pair.b] : []);
  else if (root && mission.blind) showBlind();
  // Figures are computed anew, and the tiles stay where they are.
  else if (found) asking.soon(() => compare({ anew: false }));
});
onReload(() => {
  if (root) leave();
  last = null;
  if (!root) return;
  if (mission.blind) showBlind();
  else root.replaceChildren();
});
onSetting((name) => {
  if (!found || name !== "enhance") return;
  parts.sheet.redraw();
  showNumbers();
});
