// The patches of a label audit as tiles: looked at, confirmed or relabelled.

import { pager } from "../core/bar_parts.js";
import { classButtons, swatch } from "../core/class_buttons.js";
import { button, el, say } from "../core/dom.js";
import { labelsOf, prefetch } from "../saving/labels.js";
import { PatchPreview, nameOf } from "../frame/patch_preview.js";
import { actOn, patchesAre } from "../saving/relabel.js";
import { TileGrid } from "./tile_grid.js";

const PAGE = 200;
const LOOK = { width: 110, margin: 0.5 };
const WHICH = ["open", "decided", "all"];
const BEGINNING = { which: "open", first: 0, cursor: 0 };

/**
 * @typedef {{camera: string, frame: number, cell: number, label: string, suggested: string,
 *   margin: number, reason: string, mine: ?string, settled: ?string}} Doubt What `who` says and what
 *   is settled, when the audit was loaded.
 */

/** One audit's patches. */
export class AuditSheet {
  /**
   * @param {object} options
   * @param {Doubt[]} options.patches The worst first.
   * @param {?Object} options.place Where the person was, from `place()`.
   * @param {(doubt: Doubt) => void} options.onOpen Show the patch in its frame.
   */
  constructor({ patches, place, onOpen }) {
    Object.assign(this, { patches, onOpen, shown: [] });
    this.view = { ...BEGINNING, ...place };
    this.grid = new TileGrid({
      label: "patches whose label is doubted",
      describe,
      captionLines: 3,
      onChange: () => this.#showSelection(),
      onOpen,
    });
    this.preview = new PatchPreview();
    const attrs = { role: "group", "aria-label": "which patches" };
    this.filters = el("span", { class: "pager", attrs });
    this.chosen = el("span", { class: "sheet-chosen", attrs: { role: "status" } });
    this.element = el(
      "div",
      { class: "conflicts" },
      this.#decideBar(),
      el("div", { class: "tiles-and-preview" }, this.grid.element, this.preview.element),
    );
  }

  /** Show the patches, once the element is in the page. */
  start() {
    this.#show(this.view.cursor);
  }

  /** Where the person is, to come back to. */
  place() {
    return { ...this.view, cursor: this.grid.selection.cursor };
  }

  /**
   * Take in what is decided now.
   * @param {Doubt[]} patches As the server has them.
   */
  learn(patches) {
    const placeOf = ({ camera, frame, cell }) => `${camera}:${frame}:${cell}`;
    const known = new Map(patches.map((doubt) => [placeOf(doubt), doubt]));
    for (const doubt of this.patches) {
      const now = known.get(placeOf(doubt));
      if (now) Object.assign(doubt, { mine: now.mine, settled: now.settled });
    }
    this.refresh();
  }

  /** Labels changed: what is decided fades, and stays where it is. */
  refresh() {
    this.grid.refresh();
    this.#showFilters();
    this.#showSelection();
  }

  /** Pictures or colours look different. */
  redraw() {
    this.grid.resize(LOOK);
  }

  /** The view is left. */
  close() {
    this.grid.close();
  }

  /** Open the frame of the patch under the cursor. */
  openCurrent() {
    const doubt = this.grid.current();
    if (doubt) this.onOpen(doubt);
  }

  /** Show the open ones, the decided ones, all of them, in turn. */
  nextWhich() {
    this.#choose(WHICH[(WHICH.indexOf(this.view.which) + 1) % WHICH.length]);
  }

  /** Go some pages on. */
  turn(step) {
    const first = this.view.first + step * PAGE;
    if (first < 0) return say("This is the first page.");
    if (first >= this.#matching(this.view.which).length) return say("This is the last page.");
    this.view.first = first;
    this.#show(0);
  }

  /** The labels of the selected patches are right. */
  confirm() {
    this.decide((doubt) => doubt.label);
  }

  /** The selected patches are what the model takes them for. */
  takeSuggestion() {
    this.decide((doubt) => doubt.suggested);
  }

  /**
   * Decide what the selected patches are, or the one under the cursor and go on to the next.
   * A label of one's own is changed; a confirmation, and a decision on what somebody else
   * labelled, stands beside the labels as a settlement.
   * @param {(doubt: Doubt) => string} labelFor
   */
  decide(labelFor) {
    if (this.shown.length === 0) return;
    const single = this.grid.selection.chosen.size === 0;
    const targets = this.grid.targets().map((doubt) => ({ ...doubt, to: labelFor(doubt) }));
    const own = ({ to, ...doubt }) => to !== doubt.label && mineOf(doubt) !== null;
    const relabelled = targets.filter(own);
    const settled = targets.filter((one) => !own(one));
    const count =
      this.#act("relabel", relabelled, mineOf) +
      this.#act("settle", settled, settledOf, { source: "settled" });
    this.grid.select((selection) => {
      selection.clear();
      if (single) selection.place(this.#nextOpen(selection.cursor));
    });
    const words = `${patchesAre(count)} decided; Ctrl+Z undoes.`;
    say(count === 0 ? "Nothing to change." : words);
  }

  /** Take decisions back: the label holds again, and is doubted again. */
  takeBack() {
    const targets = this.grid.targets().filter((doubt) => decisionOn(doubt) !== null);
    const settled = targets.filter((doubt) => settledOf(doubt) !== null);
    const relabelled = targets.filter((doubt) => settledOf(doubt) === null);
    const count =
      this.#act("settle", settled.map((doubt) => ({ ...doubt, to: null })), settledOf, {
        source: "settled",
      }) + this.#act("relabel", relabelled.map((doubt) => ({ ...doubt, to: doubt.label })), mineOf);
    say(count === 0 ? "Nothing to take back." : `${patchesAre(count)} open again.`);
  }

  #act(kind, targets, baseOf, options = {}) {
    const patches = targets.map((doubt) => {
      const { camera, frame, cell, to } = doubt;
      return { camera, frame, cell, label: to, base: baseOf(doubt) };
    });
    return actOn(kind, patches, options);
  }

  #decideBar() {
    return el(
      "div",
      { class: "bar", attrs: { role: "group", "aria-label": "decide on the selected patches" } },
      this.chosen,
      button("label is right", () => this.confirm(), { title: "keep the label (y)" }),
      button("suggestion is right", () => this.takeSuggestion(), { title: "relabel (n)" }),
      ...classButtons((name) => this.decide(() => name)),
      button("take back", () => this.takeBack(), { title: "not decided (Delete)" }),
      this.filters,
    );
  }

  #choose(which) {
    Object.assign(this.view, { which, first: 0 });
    this.#show(0);
  }

  #matching(which) {
    return this.patches.filter(
      (doubt) => which === "all" || (decisionOn(doubt) === null) === (which === "open"),
    );
  }

  #show(cursor) {
    const all = this.#matching(this.view.which);
    const first = Math.min(this.view.first, Math.max(0, all.length - 1));
    this.view.first = first - (first % PAGE);
    this.view.cursor = Math.max(0, Math.min(cursor, all.length - this.view.first - 1));
    this.shown = all.slice(this.view.first, this.view.first + PAGE);
    for (const [camera, tiles] of Map.groupBy(this.shown, (doubt) => doubt.camera)) {
      prefetch(camera, [...new Set(tiles.map((doubt) => doubt.frame))]);
    }
    this.grid.show(this.shown, LOOK);
    this.grid.select((selection) => selection.place(this.view.cursor));
    this.#showFilters();
  }

  #showFilters() {
    const { which, first } = this.view;
    const filters = WHICH.map((name) =>
      button(`${name} ${this.#matching(name).length}`, () => this.#choose(name), {
        attrs: { "aria-pressed": String(name === which) },
      }),
    );
    const total = this.#matching(which).length;
    const text = `${first + 1}–${first + this.shown.length} of ${total}`;
    if (total > PAGE) filters.push(pager((step) => this.turn(step), el("span", { text })));
    this.filters.replaceChildren(...filters);
  }

  #showSelection() {
    const count = this.grid.selection.chosen.size;
    this.chosen.textContent = count > 0 ? `${count} selected:` : "This one:";
    const doubt = this.grid.current();
    this.preview.show(doubt, doubt ? about(doubt) : []);
    const done = this.view.which === "open" ? "Everything is decided." : "There is none.";
    this.grid.element.dataset.empty = this.shown.length === 0 ? done : "";
  }

  #nextOpen(index) {
    const next = this.shown.findIndex((one, at) => at > index && decisionOn(one) === null);
    return next < 0 ? index : next;
  }
}

function describe(doubt) {
  const said = (mark, name) =>
    el("span", {}, el("b", { text: mark }), swatch(name), el("span", { text: name }));
  const decision = decisionOn(doubt);
  const lines = [said("", doubt.label), said("?", doubt.suggested)];
  if (decision !== null) lines.push(said("✓", decision));
  const words = decision === null ? "not decided" : `decided: ${decision}`;
  const name = `${nameOf(doubt)}, labelled ${doubt.label}, taken for ${doubt.suggested}, ${words}`;
  return { name, lines, faded: decision !== null };
}

function about(doubt) {
  const decision = decisionOn(doubt);
  return [
    `Labelled ${doubt.label}; margin ${doubt.margin.toFixed(2)}.`,
    `${doubt.reason[0].toUpperCase()}${doubt.reason.slice(1)}.`,
    decision === null ? "Not decided: y keeps the label, n takes the other." : `Decided: ${decision}.`,
    "Enter opens its frame.",
  ];
}

/** What has been decided since the audit, with what has not reached the server yet; else null. */
function decisionOn(doubt) {
  const settled = settledOf(doubt);
  if (settled !== null) return settled;
  const mine = mineOf(doubt);
  return mine !== null && mine !== doubt.label ? mine : null;
}

function settledOf({ camera, frame, cell, settled }) {
  const known = labelsOf(camera, frame);
  return known ? known.settled[cell] : settled;
}

function mineOf({ camera, frame, cell, mine }) {
  const known = labelsOf(camera, frame);
  return known ? known.mine[cell] : mine;
}
