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
/** @import { Answers, ApiError, Child, DecisionOptions, Described, KeyEntry } from "../types.js" */
/** @import { Params, Patch, SaidPatch, SheetPlace, TileSize } from "../types.js" */

/** Tiles on one page. */
export const PAGE = 200;

const OPEN = "open";
const ALL = "all";
const TILE_WIDTH = 110;
const AGAIN_MS = 1000;

/** What a sheet asks of the server, one thing at a time. */
export class Asking {
  #asked = 0;
  #busy = 0;
  #event = 0; // up to which the last answer knows
  #timer = 0;

  /** The answer; null if it fails, which `failed` hears of, or something was asked meanwhile.
   * @template {keyof Answers} P @param {P} path @param {Params} params
   * @param {(error: ApiError) => unknown} [failed]
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

  /** Ask again by `work` in a while, if labels changed somewhere since the last answer. */
  soon(/** @type {() => unknown} */ work) {
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
  constructor(/** @type {string} */ label, /** @type {number} */ captionLines) {
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

  chosenWords(/** @type {number} */ _count) {
    return "";
  }

  /** The bar of what can be done to the selected patches. */
  bar(/** @type {string} */ label, /** @type {Child[]} */ ...children) {
    const options = { class: "bar", role: "group", "aria-label": label };
    return el("div", options, this.chosen, ...children);
  }

  /** Show these tiles, and load the labels of their frames: they say what was done since. */
  showTiles(/** @type {T[]} */ tiles, /** @type {TileSize} */ look, /** @type {?number} */ cursor) {
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

  openCurrent() {
    const tile = this.grid.current();
    if (!tile) return;
    this.grid.select((selection) => selection.place(selection.cursor));
    this.open(tile);
  }

  open(/** @type {Patch} */ { camera, frame, cell }) {
    go(`#/label/${camera}/${frame}/${cell}`);
  }

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
  constructor(/** @type {DecisionOptions} */ { label, filters, decided, margin, place }) {
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

  decisionWords(/** @type {?string} */ decision) {
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
    const isAt = (/** @type {T} */ patch) => (at ? nameOf(patch) === nameOf(at) : false);
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

  choose(/** @type {Partial<SheetPlace>} */ change) {
    Object.assign(this.view, { first: 0, at: null }, change);
    this.show(null);
  }

  /** Show the open ones, the decided ones, all of them, in turn. */
  nextWhich() {
    const { which } = this;
    this.choose({ which: which[(which.indexOf(this.view.which) + 1) % which.length] });
  }

  turn(/** @type {number} */ step) {
    const first = this.view.first + step * PAGE;
    if (first < 0) say("This is the first page.");
    else if (first >= this.matching(this.view.which).length) say("This is the last page.");
    else this.choose({ first });
  }

  /** Whether a patch is shown at all; a sheet may leave some out. */
  keeps(/** @type {T} */ _patch) {
    return true;
  }

  matching(/** @type {string} */ which) {
    const kept = this.patches.filter((patch) => this.keeps(patch));
    if (which === ALL) return kept;
    return kept.filter((patch) => (this.decisionOn(patch) === null) === (which === OPEN));
  }

  /** Select nothing; after a `single` patch go on to the next one that is not `decided`: the server
   * may not have told of these yet.
   */
  goOn(/** @type {boolean} */ single, /** @type {T[]} */ decided = []) {
    this.grid.select((selection) => {
      selection.clear();
      if (!single) return;
      const { cursor } = selection;
      const isOpen = (/** @type {T} */ patch, /** @type {number} */ at) =>
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

function captionLine(/** @type {string} */ mark, /** @type {string} */ name) {
  return el("span", {}, el("b", { text: mark }), swatch(name), el("span", { text: name }));
}

/** What is settled of a patch, with what has not reached the server yet. */
export function settledOf(/** @type {SaidPatch} */ patch) {
  return nowOf(patch, "settled");
}

/** The person's own label of a patch, with what has not reached the server yet. */
export function mineOf(/** @type {SaidPatch} */ patch) {
  return nowOf(patch, "mine");
}

function nowOf(/** @type {SaidPatch} */ patch, /** @type {"mine" | "settled"} */ what) {
  const known = labelsOf(patch.camera, patch.frame);
  return (known ? known[what][patch.cell] : patch[what]) ?? null;
}

/** Give patches other labels of one's own, null takes them away; how many change.
 * @template {SaidPatch} T @param {T[]} patches @param {(one: T) => ?string} labelFor
 */
export function relabel(patches, labelFor, kind = "relabel") {
  const wanted = patches.map((one) => ({ ...one, label: labelFor(one), base: mineOf(one) }));
  return actOn(kind, wanted);
}

/** Settle patches: both opinions stay beside what holds; null takes it back. How many change.
 * @template {SaidPatch} T @param {T[]} patches @param {(one: T) => ?string} labelFor
 */
export function settle(patches, labelFor, kind = "settle") {
  const wanted = patches.map((one) => ({ ...one, label: labelFor(one), base: settledOf(one) }));
  return actOn(kind, wanted, { source: "settled" });
}

/** Makes rows of a view's table of keys that only work while its sheet is shown. @template S
 * @returns {(keys: string[], does: string, act: (sheet: S) => unknown) => KeyEntry}
 */
export function sheetRow(/** @type {() => ?S} */ sheetOf) {
  return (keys, does, act) => {
    const run = () => {
      const sheet = sheetOf();
      return sheet ? act(sheet) : false;
    };
    return { keys, does, run };
  };
}
