// Label audit: patches whose label a model that did not learn it contradicts, the worst first.
// Each is confirmed or relabelled by a person; nothing changes by itself.

import { classButtons, nothingYet } from "../core/controls.js";
import { button, el, say, soon } from "../core/dom.js";
import { lookKeys } from "../core/keys.js";
import { mission, onChange, onReload, onSetting } from "../core/mission.js";
import { lookAtShapes } from "../core/pictures.js";
import { addView } from "../core/router.js";
import { onLabels } from "../saving/labels.js";
import { CONFIRM, patchesAre } from "../saving/saver.js";
import { selectionKeys } from "./tile_grid.js";
import { nameOf } from "./tile_pictures.js";
import {
  Asking, DecisionSheet, mineOf, relabel, settle, settledOf, sheetRow, tab,
} from "./tile_sheet.js";
/** @import { ApiError, Audit, AuditListed, Doubt, SheetPlace } from "../types.js" */

const NONE = "No audit doubts a label of this mission.";
const LOOK = "Look for labels that may be wrong";

/** A finding has no label yet. */
const labelOf = (/** @type {Doubt} */ { label, suggested }) => label || suggested;
const suggestedOf = (/** @type {Doubt} */ { suggested }) => suggested;

/** One audit's patches, the worst first. @extends {DecisionSheet<Doubt>} */
class AuditSheet extends DecisionSheet {
  constructor(/** @type {Doubt[]} */ patches, /** @type {SheetPlace | undefined} */ place) {
    super({
      label: "patches whose label is doubted",
      filters: "which patches",
      decided: "decided",
      margin: 0.5,
      place,
    });
    this.patches = patches;
    const decisions = this.bar(
      "decide on the selected patches",
      button("label is right", () => this.decide(labelOf), { title: "keep the label (y)" }),
      button("suggestion is right", () => this.decide(suggestedOf), { title: "relabel (n)" }),
      ...classButtons((label) => this.decide(() => label)),
      button("take back", () => this.takeBack(), { title: "not decided (Delete)" }),
      this.filters,
    );
    this.element = el("div", { class: "conflicts" }, decisions, this.tiles);
  }

  /** Take in what is decided now, as the server has it. */
  learn(/** @type {Doubt[]} */ patches) {
    const known = new Map(patches.map((doubt) => [nameOf(doubt), doubt]));
    for (const doubt of this.patches) Object.assign(doubt, known.get(nameOf(doubt)));
    this.refresh();
  }

  /** Decide what the selected patches are, or the one under the cursor and go on to the next. One's
   * own labels are changed; a confirmation, and a decision on what somebody else labelled, stands
   * beside the labels as a settlement: one action, which one undo takes back.
   */
  decide(/** @type {(doubt: Doubt) => string} */ labelFor) {
    const targets = this.whole(this.targets());
    if (targets.length === 0) return;
    const single = this.grid.selection.chosen.size === 0;
    const own = (/** @type {Doubt} */ doubt) =>
      ![doubt.label, mineOf(doubt)].includes(labelFor(doubt)) &&
      (mineOf(doubt) !== null || !doubt.label);
    const relabels = targets.every(own);
    const count = relabels ? relabel(targets, labelFor) : settle(targets, labelFor, CONFIRM);
    this.goOn(single, targets);
    say(`${patchesAre(count)} decided; Ctrl+Z undoes.`);
  }

  /** The patches, and all of the findings that they are of: a finding is decided at once. */
  whole(/** @type {Doubt[]} */ patches) {
    const groups = new Set(patches.map(({ group }) => group).filter(Boolean));
    const others = this.patches.filter(({ group }) => groups.has(group));
    return [...new Set([...patches, ...others])];
  }

  /** Take decisions back: the label holds again, and is doubted again. */
  takeBack() {
    const all = this.whole(this.targets());
    if (all.length === 0) return;
    const targets = all.filter((doubt) => this.decisionOn(doubt) !== null);
    const settled = targets.filter((doubt) => settledOf(doubt) !== null);
    const relabelled = targets.filter(
      (doubt) => settledOf(doubt) === null && mineOf(doubt) === this.decisionOn(doubt),
    );
    const undone = relabel(relabelled, ({ label }) => label || null, "take back");
    const count = settle(settled, () => null) + undone;
    say(count === 0 ? "Nothing to take back." : `${patchesAre(count)} open again.`);
  }

  /** What has been decided since the audit, also what has not reached the server yet; else null. */
  decisionOn(/** @type {Doubt} */ doubt) {
    const [mine, settled] = [mineOf(doubt), settledOf(doubt)];
    if (settled !== doubt.settled) return settled;
    if (mine === doubt.mine) return doubt.decided;
    return mine !== doubt.label ? mine : null; // null again where it was taken back
  }

  /** @param {Doubt} doubt @returns {[mark: string, name: string, words: string][]} */
  opinions({ label, suggested }) {
    /** @type {[string, string, string]} */
    const taken = ["?", suggested, `taken for ${suggested}`];
    return label ? [["", label, `labelled ${label}`], taken] : [taken];
  }

  decisionWords(/** @type {?string} */ decision) {
    return decision === null ? "not decided" : `decided: ${decision}`;
  }

  chosenWords(/** @type {number} */ count) {
    return count > 0 ? `${count} selected:` : "This one:";
  }

  emptyWords() {
    return this.view.which === "open" ? "Everything is decided." : "There is none.";
  }

  about(/** @type {Doubt} */ doubt) {
    const decision = this.decisionOn(doubt);
    const open = doubt.label
      ? "Not decided: y keeps the label, n takes the other."
      : "Not decided: y labels it so, a class key labels it otherwise; all its patches at once.";
    const now = doubt.label ? `Labelled ${doubt.label}; margin ${doubt.margin.toFixed(2)}` : "Not labelled";
    return [
      `${now}.`,
      `${doubt.reason[0].toUpperCase()}${doubt.reason.slice(1)}.`,
      decision === null ? open : `Decided: ${decision}.`,
      "Enter opens its frame.",
    ];
  }
}

// ---- The view

/** The view's state; all of it. */
const view = {
  /** @type {?ReturnType<typeof build>} The elements on show; null while another view is. */
  parts: null,
  /** @type {?AuditSheet} Null while there is nothing to show. */
  sheet: null,
  name: "",
  /** @type {Map<string, SheetPlace>} By audit: where the person was, to come back to. */
  places: new Map(),
};
const asking = new Asking();

async function show(/** @type {HTMLElement} */ root, /** @type {string[]} */ [wanted]) {
  leave();
  const here = (view.parts = build());
  root.replaceChildren(here.root);
  here.root.focus();
  await lookAtShapes();
  if (here === view.parts) await load(wanted);
}

function leave() {
  const { sheet, name, places } = view;
  if (sheet) places.set(name, sheet.place());
  asking.stop();
  sheet?.close();
  view.sheet = null;
  view.parts = null;
}

function build() {
  const tabs = el("nav", { class: "sheet-tabs", "aria-label": "audits" });
  const words = el("p", { class: "sheet-words", role: "status" });
  const body = el("div", { class: "audit-body" });
  const options = { class: "sheet tiles-view", "aria-label": "label audit", tabindex: -1 };
  const root = el("section", options, tabs, el("div", { class: "bar" }, words), body);
  return { root, tabs, words, body };
}

async function load(/** @type {string} */ wanted) {
  asking.stop();
  const { parts } = view;
  if (!parts) return;
  if (mission.blind) return void (parts.words.textContent = "Not while labelling blind.");
  parts.words.textContent = "Loading ...";
  const failed = (/** @type {ApiError} */ { message }) =>
    (parts.words.textContent = `It could not be loaded: ${message}.`);
  const listed = await asking.get("/api/audits", {}, failed);
  if (!listed) return;
  const { audits } = listed;
  const chosen = audits.find((one) => one.name === wanted) ?? audits[0];
  view.name = chosen?.name ?? "";
  parts.tabs.replaceChildren(...tabsOf(audits));
  if (!chosen) return parts.words.replaceChildren(nothingYet(NONE, LOOK, "#/files"));
  const audit = await asking.get("/api/audit", { name: chosen.name }, failed);
  if (!audit) return;
  parts.words.textContent = wordsOf(audit);
  parts.body.replaceChildren(newSheet(audit));
  view.sheet?.show();
  view.sheet?.grid.focus();
}

function tabsOf(/** @type {AuditListed[]} */ audits) {
  const back = el("a", { class: "tab", text: "‹ by class", href: "#/sheet" });
  const tabs = audits.map((one) => {
    const href = `#/audit/${encodeURIComponent(one.name)}`;
    const made = tab(`Audit ${one.name}`, one.patches, href, one.name === view.name);
    made.title = one.fault || one.of;
    return made;
  });
  return [back, ...tabs];
}

function wordsOf(/** @type {Audit} */ { of, rule, total, patches }) {
  const shown = patches.length < total ? ` The worst ${patches.length} of ${total}.` : "";
  return `${of}: ${rule}${shown}`;
}

/** A sheet in place of the one that was shown. */
function newSheet(/** @type {Audit} */ { patches }) {
  const place = view.sheet?.place() ?? view.places.get(view.name);
  view.sheet?.close();
  view.sheet = new AuditSheet(patches, place);
  return view.sheet.element;
}

/** Labels changed somewhere, maybe in frames that are not shown: tiles stay where they are. */
async function learn() {
  // Where the server is away the page says so; what was decided meanwhile is learnt with the next.
  const audit = await asking.get("/api/audit", { name: view.name });
  if (audit) view.sheet?.learn(audit.patches);
}

const row = sheetRow(() => view.sheet);

addView("audit", {
  title: "Label audit",
  under: "sheet",
  show,
  hide: leave,
  classKeys: (label) => view.sheet?.decide(() => label),
  keys: [
    { keys: ["class key"], does: "the selected patches are of this class" },
    row(["y"], "the label is right", (it) => it.decide(labelOf)),
    row(["n"], "the label is wrong, the suggestion right", (it) => it.decide(suggestedOf)),
    row(["Delete", "Backspace"], "take the decision back", (it) => it.takeBack()),
    row(["Enter"], "open the frame of the patch", (it) => it.openCurrent()),
    row(["/"], "filter: open, decided, all", (it) => it.nextWhich()),
    row(["d", "PageDown"], "next page", (it) => it.turn(1)),
    row(["a", "PageUp"], "previous page", (it) => it.turn(-1)),
    { keys: ["r"], does: "load it anew", run: () => load(view.name) },
    ...lookKeys,
    ...selectionKeys(() => view.sheet?.grid),
  ],
});

onLabels(soon(() => view.sheet?.refresh()));
onChange((what) => {
  if (view.parts && !view.sheet && what === "all") load(view.name);
  else if (view.sheet) asking.soon(learn);
});
onReload(() => {
  view.places.clear();
  if (view.parts) load(view.name);
});
onSetting((what) => {
  if (what === "enhance") view.sheet?.redraw();
});
