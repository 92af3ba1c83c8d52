// What the three sheets of patches share: tiles with a preview of the one under the cursor, and how
// the server is asked; of the two on which people decide, filters, pages and settling.

import { get, onFailure } from "../core/api.js";
import { pager, swatch } from "../core/controls.js";
import { button, el, say } from "../core/dom.js";
import { mission } from "../core/mission.js";
import { go } from "../core/router.js";
import { labelsOf, prefetchOf } from "../saving/labels.js";
import { actOn } from "../saving/saver.js";
import { TileGrid } from "./tile_grid.js";
import { PatchPreview, nameOf } from "./tile_pictures.js";

/** Tiles on one page. */
export const PAGE = 200;

const OPEN = "open";
const ALL = "all";
const TILE_WIDTH = 110;
const AGAIN_MS = 1000;

/** @import { Answers, Child, Described, KeyEntry } from "../types.js" */
/** @import { Params, Patch, SaidPatch, SheetPlace } from "../types.js" */
/** @import { ApiError } from "../core/api.js" */

/** What a sheet asks of the server, one thing at a time. */
export class Asking {
  #asked = 0;
  #busy = 0;
  #event = 0; // up to which the last answer knows
  #timer = 0;

  /** The answer; null if it fails, which `failed` hears of, or something was asked meanwhile.
   * @template {keyof Answers} P
   * @param {P} path @param {Params} params @param {(error: ApiError) => unknown} [failed]
   * @returns {Promise<?Answers[P]>}
   */
  async get(path, params, failed) {
    const mine = (this.#asked += 1);
    const event = mission.event;
    this.#busy += 1;
    const request = get(path, params).finally(() => (this.#busy -= 1));
    const answer = await request.catch(
      onFailure((error) => void (mine === this.#asked && failed?.(error))),
    );
    if (!answer || mine !== this.#asked) return null;
    this.#event = event;
    return answer;
  }

  /** Ask again by `work` in a while, if labels changed somewhere since the last answer.
   * @param {() => unknown} work
   */
  soon(work) {
    if (this.#event === mission.event) return;
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => (this.#busy ? this.soon(work) : work()), AGAIN_MS);
  }

  /** Take no answer any more, nor ask again. */
  stop() {
    clearTimeout(this.#timer);
    this.#asked += 1;
  }
}

/** A grid of tiles and what stands beside it. A sheet says of its tiles `describe(tile)` (as
 * `TileGrid` takes it), `about(tile)` (lines under the preview) and `chosenWords(count)` (before
 * the buttons that act on the selected ones).
 * @template {Patch} T
 */
export class TileSheet {
  /** @param {string} label @param {number} captionLines */
  constructor(label, captionLines) {
    /** @type {TileGrid<T>} */
    this.grid = new TileGrid(label, captionLines, this);
    this.preview = new PatchPreview();
    this.chosen = el("span", { class: "sheet-chosen", role: "status" });
    this.tiles = el("div", { class: "tiles-and-preview" }, this.grid.element, this.preview.element);
  }

  /** @param {T} _tile @returns {Described} */
  describe(_tile) {
    throw new Error("a sheet describes its tiles");
  }

  /** @param {T} _tile @returns {string[]} */
  about(_tile) {
    return [];
  }

  /** @param {number} _count */
  chosenWords(_count) {
    return "";
  }

  /** The bar of commands for selected patches. @param {string} label @param {...Child} children */
  bar(label, ...children) {
    const options = { class: "bar", role: "group", "aria-label": label };
    return el("div", options, this.chosen, ...children);
  }

  /** Show these tiles, and load the labels of their frames: they say what was done since.
   * @param {T[]} tiles @param {{width: number, margin: number}} look @param {?number} cursor
   */
  showTiles(tiles, look, cursor) {
    prefetchOf(tiles);
    this.grid.show(tiles, look);
    this.grid.select((selection) => cursor !== null && selection.place(cursor));
  }

  /** Where the cursor stands; null where nobody put it there. */
  cursor() {
    const { pointed, cursor } = this.grid.selection;
    return pointed ? cursor : null;
  }

  /** The patches that a person means; where there are none, say how to choose them. */
  targets() {
    const targets = this.grid.targets();
    if (targets.length === 0) say("Select patches first: click them, or use the arrow keys.");
    return targets;
  }

  /** Say what is selected, and show the patch under the cursor. */
  showSelection() {
    const { chosen, pointed } = this.grid.selection;
    const some = chosen.size > 0 || pointed;
    this.chosen.textContent = some ? this.chosenWords(chosen.size) : "Select patches, then:";
    const tile = this.grid.current();
    this.preview.show(tile, tile ? this.about(tile) : []);
  }

  /** Open the frame of the patch under the cursor. */
  openCurrent() {
    const tile = this.grid.current();
    if (!tile) return;
    this.grid.select((selection) => selection.place(selection.cursor));
    this.open(tile);
  }

  /** Open the frame of a patch. @param {Patch} patch */
  open({ camera, frame, cell }) {
    go(`#/label/${camera}/${frame}/${cell}`);
  }

  /** The view is left. */
  close() {
    this.grid.close();
  }
}

/** A sheet of `patches` on which people decide. It says of a patch `decisionOn(patch)` (a class;
 * null while it is open), `opinions(patch)` ([mark, class, words] of each caption line) and
 * `decisionWords(decision)`; and `emptyWords()` where there is no patch to show.
 * @template {SaidPatch} T
 * @extends {TileSheet<T>}
 */
export class DecisionSheet extends TileSheet {
  /** `label`: what the grid holds; `filters`: what is filtered, for screen readers; `decided`: the
   * word for patches that are not open; `margin` around each patch, in patches; `place`: where the
   * person was, or nothing.
   * @param {{label: string, filters: string, decided: string, margin: number,
   *   place?: ?Partial<SheetPlace>}} options
   */
  constructor({ label, filters, decided, margin, place }) {
    super(label, 3);
    /** @type {T[]} */
    this.patches = [];
    this.which = [OPEN, decided, ALL];
    this.look = { width: TILE_WIDTH, margin };
    /** @type {SheetPlace} */
    this.view = { which: OPEN, first: 0, at: null, ...place };
    this.filters = el("span", { class: "pager", role: "group", "aria-label": filters });
  }

  /** @param {T} _patch @returns {?string} */
  decisionOn(_patch) {
    return null;
  }

  /** @param {T} _patch @returns {[mark: string, name: string, words: string][]} */
  opinions(_patch) {
    return [];
  }

  /** @param {?string} decision */
  decisionWords(decision) {
    return decision ?? "";
  }

  emptyWords() {
    return "";
  }

  /** Where the person is, to come back to. @returns {SheetPlace} */
  place() {
    return { ...this.view, ...(this.cursor() !== null && { at: this.grid.current() }) };
  }

  /** Show the patches from where the person is; the one pointed `at` also if it does not match. */
  show(at = this.place().at) {
    /** @param {T} patch */
    const isAt = (patch) => (at ? nameOf(patch) === nameOf(at) : false);
    const matching = new Set(this.matching(this.view.which));
    const all = this.patches.filter((patch) => matching.has(patch) || isAt(patch));
    const found = all.findIndex(isAt);
    const first = Math.max(0, Math.min(found < 0 ? this.view.first : found, all.length - 1));
    this.view.first = first - (first % PAGE);
    const cursor = found < 0 ? null : found % PAGE;
    this.showTiles(all.slice(this.view.first, this.view.first + PAGE), this.look, cursor);
    this.showFilters();
  }

  /** Labels changed: what is decided fades, and stays where it is. */
  refresh() {
    this.grid.refresh();
    this.showFilters();
    this.showSelection();
  }

  /** Pictures or colours look different. */
  redraw() {
    this.grid.resize(this.look);
  }

  /** Show other patches. @param {Partial<SheetPlace>} change */
  choose(change) {
    Object.assign(this.view, { first: 0, at: null }, change);
    this.show(null);
  }

  /** Show the open ones, the decided ones, all of them, in turn. */
  nextWhich() {
    const { which } = this;
    this.choose({ which: which[(which.indexOf(this.view.which) + 1) % which.length] });
  }

  /** Go some pages on. @param {number} step */
  turn(step) {
    const first = this.view.first + step * PAGE;
    if (first < 0) say("This is the first page.");
    else if (first >= this.matching(this.view.which).length) say("This is the last page.");
    else this.choose({ first });
  }

  /** Whether a patch is shown; a sheet may leave some out. @param {T} _patch @returns {boolean} */
  keeps(_patch) {
    return true;
  }

  /** @param {string} which */
  matching(which) {
    const kept = this.patches.filter((patch) => this.keeps(patch));
    if (which === ALL) return kept;
    return kept.filter((patch) => (this.decisionOn(patch) === null) === (which === OPEN));
  }

  /** Select nothing; who decided on the `single` patch under the cursor goes on to the next that is
   * not one of the `decided`: the server may not have told of these yet.
   * @param {boolean} single @param {T[]} [decided]
   */
  goOn(single, decided = []) {
    this.grid.select((selection) => {
      selection.clear();
      if (!single) return;
      const { cursor } = selection;
      /** @param {T} patch @param {number} at */
      const isOpen = (patch, at) =>
        at > cursor && !decided.includes(patch) && this.decisionOn(patch) === null;
      const next = this.grid.tiles.findIndex(isOpen);
      selection.place(next < 0 ? cursor : next);
    });
  }

  showFilters() {
    const { which, first } = this.view;
    const filters = this.which.map((name) =>
      button(`${name} ${this.matching(name).length}`, () => this.choose({ which: name }), {
        "aria-pressed": String(name === which),
      }),
    );
    const total = this.matching(which).length;
    const text = `${first + 1}–${first + this.grid.tiles.length} of ${total}`;
    const pages = total > PAGE ? [pager((step) => this.turn(step), el("span", { text }))] : [];
    this.filters.replaceChildren(...filters, ...this.moreFilters(), ...pages);
  }

  /** Further buttons among the filters. @returns {HTMLElement[]} */
  moreFilters() {
    return [];
  }

  showSelection() {
    super.showSelection();
    this.grid.element.dataset.empty = this.grid.tiles.length === 0 ? this.emptyWords() : "";
  }

  /** @param {T} patch @returns {Described} */
  describe(patch) {
    const decision = this.decisionOn(patch);
    const opinions = this.opinions(patch);
    const lines = opinions.map(([mark, name]) => captionLine(mark, name));
    if (decision !== null) lines.push(captionLine("✓", decision));
    const words = opinions.map(([, , said]) => said);
    const name = [nameOf(patch), ...words, this.decisionWords(decision)].join(", ");
    return { name, lines, faded: decision !== null };
  }
}

/** One of the tabs that lead from sheet to sheet: its words, how many patches it has.
 * @param {Child} words @param {number} patches @param {string} href @param {boolean} isCurrent
 */
export function tab(words, patches, href, isCurrent) {
  const options = { class: "tab", href, "aria-current": isCurrent && "page" };
  const count = el("span", { class: "count", text: patches.toLocaleString("en") });
  return el("a", options, words, count);
}

/** @param {string} mark @param {string} name */
function captionLine(mark, name) {
  return el("span", {}, el("b", { text: mark }), swatch(name), el("span", { text: name }));
}

/** What is settled of a patch, known to the server or not. @param {SaidPatch} patch */
export function settledOf(patch) {
  return nowOf(patch, "settled");
}

/** The person's own label of a patch, known to the server or not. @param {SaidPatch} patch */
export function mineOf(patch) {
  return nowOf(patch, "mine");
}

/** @param {SaidPatch} patch @param {"mine" | "settled"} what */
function nowOf(patch, what) {
  const known = labelsOf(patch.camera, patch.frame);
  return (known ? known[what][patch.cell] : patch[what]) ?? null;
}

/** Give patches other labels of one's own; null takes them away. Gives how many change.
 * @template {SaidPatch} T
 * @param {T[]} patches @param {(one: T) => ?string} labelFor @param {string} [kind]
 */
export function relabel(patches, labelFor, kind = "relabel") {
  const wanted = patches.map((one) => ({ ...one, label: labelFor(one), base: mineOf(one) }));
  return actOn(kind, wanted);
}

/** Settle patches: both opinions stay, and what holds stands beside them; null takes it back. Gives
 * how many change.
 * @template {SaidPatch} T
 * @param {T[]} patches @param {(one: T) => ?string} labelFor @param {string} [kind]
 */
export function settle(patches, labelFor, kind = "settle") {
  const wanted = patches.map((one) => ({ ...one, label: labelFor(one), base: settledOf(one) }));
  return actOn(kind, wanted, { source: "settled" });
}

/** Makes rows of a view's table of keys that only work while its sheet is shown.
 * @template S
 * @param {() => ?S} sheetOf
 * @returns {(keys: string[], does: string, act: (sheet: S) => unknown) => KeyEntry}
 */
export function sheetRow(sheetOf) {
  return (keys, does, act) => {
    const run = () => {
      const sheet = sheetOf();
      return sheet ? act(sheet) : false;
    };
    return { keys, does, run };
  };
}
