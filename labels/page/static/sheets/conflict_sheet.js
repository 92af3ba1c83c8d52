// The patches on which two annotators differ, as tiles: filtered, looked at, settled.

import { pager } from "../core/bar_parts.js";
import { classButtons, swatch } from "../core/class_buttons.js";
import { button, el, say } from "../core/dom.js";
import { labelsOf, prefetch } from "../saving/labels.js";
import { who } from "../core/mission.js";
import { PatchPreview, nameOf } from "../frame/patch_preview.js";
import { actOn, patchesAre } from "../saving/relabel.js";
import { TileGrid } from "./tile_grid.js";

const PAGE = 200;
const LOOK = { width: 110, margin: 0.25 };
const WHICH = ["open", "settled", "all"];
/** What is shown at first. `only`: {a, b}, the labels that conflicts must have; `unsure`: also
    those where one was not sure, null while nobody chose. */
const BEGINNING = { which: "open", only: null, unsure: null, first: 0, cursor: 0 };

/**
 * @typedef {{camera: string, frame: number, cell: number, a: string, b: string, sure: boolean,
 *   settled: ?string, settled_by: ?string}} Conflict
 */

/** The conflicts of one comparison. */
export class ConflictSheet {
  /**
   * @param {object} options
   * @param {{a: string, b: string}} options.pair Names of the annotators.
   * @param {?Object} options.place Where the person was, from `place()`.
   * @param {(conflict: Conflict) => void} options.onOpen Show the patch in its frame.
   * @param {() => void} options.onChoice Other labels were chosen to look at.
   */
  constructor({ pair, place, onOpen, onChoice }) {
    Object.assign(this, { pair, onOpen, onChoice, found: [], shown: [] });
    this.view = { ...BEGINNING, ...place };
    this.grid = new TileGrid({
      label: "patches on which they differ",
      describe: (conflict) => this.#describe(conflict),
      captionLines: 3,
      onChange: () => this.#showSelection(),
      onOpen,
    });
    this.preview = new PatchPreview();
    const attrs = { role: "group", "aria-label": "which conflicts" };
    this.filters = el("span", { class: "pager", attrs });
    this.chosen = el("span", { class: "sheet-chosen", attrs: { role: "status" } });
    this.element = el(
      "div",
      { class: "conflicts" },
      el("div", { class: "bar" }, el("h2", { text: "Conflicts" }), this.filters),
      this.#settleBar(),
      el("div", { class: "tiles-and-preview" }, this.grid.element, this.preview.element),
    );
  }

  /**
   * Take what the server found.
   * @param {Conflict[]} conflicts
   * @param {{anew: boolean}} options `anew`: show them from where the person was; else the tiles
   *   stay as they are.
   */
  take(conflicts, { anew }) {
    this.found = conflicts;
    this.view.unsure ??= !conflicts.some((conflict) => conflict.sure);
    if (anew) this.#show(this.view.cursor);
    else this.#showFilters();
  }

  /** Where the person is, to come back to. */
  place() {
    return { ...this.view, cursor: this.grid.selection.cursor };
  }

  /** Labels changed. */
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
    const conflict = this.grid.current();
    if (conflict) this.onOpen(conflict);
  }

  /** Show the open ones, the settled ones, all of them, in turn. */
  nextWhich() {
    this.#choose({ which: WHICH[(WHICH.indexOf(this.view.which) + 1) % WHICH.length] });
  }

  /** Show those too that one of them was unsure of, or no longer. */
  withUnsure() {
    this.#choose({ unsure: !this.view.unsure });
  }

  /**
   * Show only the conflicts of two labels; of the same two again: all.
   * @param {?{a: string, b: string}} only
   */
  choosePair(only) {
    const { only: now } = this.view;
    const again = only && now?.a === only.a && now?.b === only.b;
    this.#choose({ only: again ? null : only });
    this.onChoice();
    this.grid.focus();
  }

  /** Go some pages on. */
  turn(step) {
    const first = this.view.first + step * PAGE;
    if (first < 0) say("This is the first page.");
    else if (first >= this.#matching(this.view.which).length) say("This is the last page.");
    else this.#choose({ first });
  }

  /**
   * Settle the selected conflicts, or the one under the cursor and go on to the next.
   * @param {?string} label Null takes settlements back.
   */
  settle(label) {
    if (this.shown.length === 0) return;
    const single = this.grid.selection.chosen.size === 0;
    const targets = this.grid.targets();
    const patches = targets.map((one) => ({ ...one, label, base: settledNow(one) }));
    const count = actOn("settle", patches, { source: "settled" });
    this.grid.select((selection) => {
      selection.clear();
      if (single && label !== null) selection.place(this.#nextOpen(selection.cursor));
    });
    const now = label === null ? "open again" : `settled as ${label}, both opinions are kept`;
    say(count === 0 ? "Nothing to change." : `${patchesAre(count)} ${now}; Ctrl+Z undoes.`);
  }

  #settleBar() {
    return el(
      "div",
      { class: "bar", attrs: { role: "group", "aria-label": "settle the selected conflicts" } },
      this.chosen,
      ...classButtons((name) => this.settle(name)),
      button("take back", () => this.settle(null), { title: "no longer settled (Delete)" }),
    );
  }

  #choose(change) {
    Object.assign(this.view, { first: 0 }, change);
    this.#show(0);
  }

  #matching(which) {
    const { only, unsure } = this.view;
    return this.found.filter((conflict) => {
      if (only && (conflict.a !== only.a || conflict.b !== only.b)) return false;
      if (!only && !unsure && !conflict.sure) return false;
      return which === "all" || (settledNow(conflict) === null) === (which === "open");
    });
  }

  #show(cursor) {
    const all = this.#matching(this.view.which);
    const first = Math.min(this.view.first, Math.max(0, all.length - 1));
    this.view.first = first - (first % PAGE);
    this.shown = all.slice(this.view.first, this.view.first + PAGE);
    for (const [camera, tiles] of Map.groupBy(this.shown, (conflict) => conflict.camera)) {
      prefetch(camera, [...new Set(tiles.map((conflict) => conflict.frame))]);
    }
    this.grid.show(this.shown, LOOK);
    this.grid.select((selection) => selection.place(cursor));
    this.#showFilters();
  }

  #showFilters() {
    const { which, only, unsure, first } = this.view;
    const filters = WHICH.map((name) =>
      button(`${name} ${this.#matching(name).length}`, () => this.#choose({ which: name }), {
        attrs: { "aria-pressed": String(name === which) },
      }),
    );
    const count = this.found.filter((conflict) => !conflict.sure).length;
    if (count > 0 && !only) {
      const options = { attrs: { "aria-pressed": String(unsure) }, title: "show them too (e)" };
      filters.push(button(`with one unsure ${count}`, () => this.withUnsure(), options));
    }
    if (only) filters.push(button(`${only.a} / ${only.b} ×`, () => this.choosePair(null)));
    const total = this.#matching(which).length;
    const text = `${first + 1}–${first + this.shown.length} of ${total}`;
    if (total > PAGE) filters.push(pager((step) => this.turn(step), el("span", { text })));
    this.filters.replaceChildren(...filters);
  }

  #describe(conflict) {
    const settled = settledNow(conflict);
    const said = (mark, name) =>
      el("span", {}, el("b", { text: mark }), swatch(name), el("span", { text: name }));
    const lines = [said("A", conflict.a), said("B", conflict.b)];
    if (settled !== null) lines.push(said("✓", settled));
    const opinions = `${this.pair.a} ${conflict.a}, ${this.pair.b} ${conflict.b}`;
    const words = settled === null ? "not settled" : `settled as ${settled}`;
    const name = `${nameOf(conflict)}, ${opinions}, ${words}`;
    return { name, lines, faded: settled !== null };
  }

  #showSelection() {
    const count = this.grid.selection.chosen.size;
    this.chosen.textContent = `Settle ${count > 0 ? `${count} selected` : "this one"} as`;
    const conflict = this.grid.current();
    this.preview.show(conflict, conflict ? this.#about(conflict) : []);
    this.grid.element.dataset.empty = this.shown.length === 0 ? this.#emptyWords() : "";
  }

  #emptyWords() {
    if (this.found.length === 0) return "They agree on every patch that both labelled.";
    return this.view.which === "open" ? "Everything is settled." : "There is no such conflict.";
  }

  #about(conflict) {
    const settled = settledNow(conflict);
    const known = settled === conflict.settled && conflict.settled_by;
    return [
      `${this.pair.a}: ${conflict.a}`,
      `${this.pair.b}: ${conflict.b}`,
      settled === null ? "Not settled." : `Settled as ${settled} by ${known || who()}.`,
      "Enter opens its frame.",
    ];
  }

  #nextOpen(index) {
    const next = this.shown.findIndex((one, at) => at > index && settledNow(one) === null);
    return next < 0 ? index : next;
  }
}

/** What is settled of a patch, with what has not reached the server yet. */
function settledNow({ camera, frame, cell, settled }) {
  const known = labelsOf(camera, frame);
  return known ? known.settled[cell] : settled;
}
