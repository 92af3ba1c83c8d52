// A scrolling grid of patch tiles, selected by mouse, by rectangle or by keyboard.

import { el, part, setAttribute, targetOf } from "../core/dom.js";
import { patchAspect } from "../core/pictures.js";
import { ARROWS, arrowKeys } from "../core/patch_grid.js";
import { TilePictures, patchInTile, putAt } from "./tile_pictures.js";
/** @import { GridHost, KeyEntry, Patch, Point, Rectangle, Selecting } from "../types.js" */
/** @import { SelectionChange, TileSize } from "../types.js" */

const DRAG_STARTS = 5; // CSS pixels
let grids = 0;

/** As in a file manager; but a plain click adds, because odd patches lie scattered. */
export class TileSelection {
  constructor(/** @type {number} */ count) {
    this.count = count;
    this.cursor = 0;
    this.anchor = 0;
    /** Whether a person put the cursor where it is; else it stands on the first tile. */
    this.pointed = false;
    /** @type {Set<number>} */
    this.chosen = new Set();
    /** @type {?Set<number>} The selection before Shift began to extend it. */
    this.before = null;
  }

  /** Put the cursor on a tile, without selecting it. */
  place(/** @type {number} */ index) {
    this.pointed = true;
    this.cursor = Math.max(0, Math.min(this.count - 1, index));
    this.anchor = this.cursor;
    this.before = null;
  }

  toggle(/** @type {number} */ index) {
    this.place(index);
    if (!this.chosen.delete(index)) this.chosen.add(index);
  }

  /** Select all from the last tile clicked to this one. */
  extendTo(/** @type {number} */ index) {
    this.before ??= new Set(this.chosen);
    this.cursor = Math.max(0, Math.min(this.count - 1, index));
    const [first, last] = [this.anchor, this.cursor].sort((a, b) => a - b);
    this.chosen = new Set(this.before);
    for (let tile = first; tile <= last; tile += 1) this.chosen.add(tile);
  }

  /** Move the cursor by this many tiles; with `extend`, select what it passes. */
  move(/** @type {number} */ step, /** @type {boolean} */ extend) {
    const target = this.cursor + step;
    this.pointed = true;
    if (target < 0 || target >= this.count) return;
    if (extend) this.extendTo(target);
    else this.place(target);
  }

  /** Add these tiles (or take them away) on top of an earlier selection.
   * @param {Set<number>} earlier @param {number[]} tiles @param {boolean} remove
   */
  sweep(earlier, tiles, remove) {
    const others = [...earlier].filter((tile) => !tiles.includes(tile));
    this.chosen = new Set(remove ? others : [...others, ...tiles]);
    this.before = null;
  }

  all() {
    this.chosen = new Set(Array(this.count).keys());
  }

  clear() {
    this.chosen.clear();
    this.before = null;
  }

  /** The selected tiles in their order; if there are none, the one that a person pointed at. */
  targets() {
    if (this.chosen.size > 0) return [...this.chosen].sort((a, b) => a - b);
    return this.count > 0 && this.pointed ? [this.cursor] : [];
  }
}

/** Grid of tiles. @template {Patch} T */
export class TileGrid {
  /** `captionLines`: kept free under each picture; 0: the caption stands over it.
   * @param {string} label @param {number} captionLines @param {GridHost<T>} sheet
   */
  constructor(label, captionLines, sheet) {
    this.sheet = sheet;
    this.prefix = `tiles-${(grids += 1)}`;
    /** @type {T[]} */
    this.tiles = [];
    /** @type {HTMLElement[]} */
    this.elements = [];
    this.height = 0; // of each picture, in CSS pixels
    this.selection = new TileSelection(0);
    /** Whether the mouse is held down on a tile. */
    this.busy = false;
    this.list = el("div", {
      class: "tiles", role: "listbox", "aria-multiselectable": "true", "aria-label": label,
      tabindex: 0, "data-home": true, "data-caption-lines": captionLines,
    });
    this.band = el("div", { class: "tile-band", "aria-hidden": "true", hidden: true });
    this.element = el("div", { class: "tile-scroller" }, this.list, this.band);
    this.pictures = new TilePictures(this.element);
    this.list.addEventListener("pointerdown", (event) => this.#press(event));
    this.list.addEventListener("dblclick", (event) => {
      const tile = this.tiles[this.#indexOf(event)];
      if (tile) sheet.open(tile);
    });
  }

  /** Show these tiles, as `resize` does. */
  show(/** @type {T[]} */ tiles, /** @type {TileSize} */ look) {
    this.tiles = tiles;
    this.selection = new TileSelection(tiles.length);
    this.resize(look);
  }

  /** Show the same tiles, maybe at another size; selection and cursor stay. */
  resize(/** @type {TileSize} */ { width, margin }) {
    this.list.style.setProperty("--tile-width", `${width}px`);
    this.elements = this.tiles.map((tile, index) => this.#tile(tile, index, width, margin));
    this.list.replaceChildren(...this.elements);
    const pictures = this.elements.map((element) => part(element, "div"));
    this.pictures.show(this.tiles, pictures, { width, height: this.height, margin });
    this.refresh();
    this.sheet.showSelection();
  }

  /** Describe all tiles anew: labels changed. */
  refresh() {
    this.elements.forEach((element, index) => {
      const { name, lines, faded } = this.sheet.describe(this.tiles[index]);
      element.setAttribute("aria-label", name);
      element.classList.toggle("faded", Boolean(faded));
      element.lastElementChild?.replaceChildren(...lines);
    });
    this.#mark();
  }

  /** The tile under the cursor, if there is one. */
  current() {
    return this.tiles[this.selection.cursor];
  }

  /** The selected tiles; if there are none, the one that a person pointed at. */
  targets() {
    return this.selection.targets().map((index) => this.tiles[index]);
  }

  /** Change the selection by `change(selection)` and show it. */
  select(/** @type {(selection: TileSelection) => unknown} */ change) {
    change(this.selection);
    this.#mark();
    this.elements[this.selection.cursor]?.scrollIntoView({ block: "nearest" });
    this.sheet.showSelection();
  }

  /** Let the keyboard's next key go here. */
  focus() {
    this.list.focus({ preventScroll: true });
  }

  /** Tiles in one row, as laid out now. */
  columns() {
    const top = this.elements[0]?.offsetTop;
    const second = this.elements.findIndex((element) => element.offsetTop > (top ?? 0));
    return second < 0 ? Math.max(1, this.elements.length) : second;
  }

  close() {
    this.pictures.stop();
  }

  /** @param {T} tile @param {number} index @param {number} width @param {number} margin */
  #tile(tile, index, width, margin) {
    this.height = Math.round(width * patchAspect(tile.camera));
    const picture = el("div", { class: "tile-picture" });
    picture.style.height = `${this.height}px`;
    if (margin > 0) {
      const mark = el("div", { class: "tile-mark" });
      putAt(mark, patchInTile(tile, width, this.height, margin));
      picture.append(mark);
    }
    return el("div", { class: "tile", role: "option", id: `${this.prefix}-${index}` },
      picture,
      el("div", { class: "tile-caption" }),
    );
  }

  #mark() {
    const { chosen, cursor } = this.selection;
    this.elements.forEach((element, index) => {
      element.setAttribute("aria-selected", String(chosen.has(index)));
      element.classList.toggle("at-cursor", index === cursor);
    });
    const active = this.tiles.length > 0 && `${this.prefix}-${cursor}`;
    setAttribute(this.list, "aria-activedescendant", active);
  }

  #indexOf(/** @type {Event} */ event) {
    return this.elements.findIndex((element) => element.contains(targetOf(event)));
  }

  #press(/** @type {PointerEvent} */ event) {
    if (event.button !== 0) return;
    const pressed = this.#indexOf(event);
    this.busy = true;
    const start = this.#point(event);
    const earlier = new Set(this.selection.chosen);
    /** @type {?Rectangle} */
    let band = null;
    const moved = (/** @type {PointerEvent} */ move) => {
      const rectangle = rectangleOf(start, this.#point(move));
      if (!band && Math.max(rectangle.width, rectangle.height) < DRAG_STARTS) return;
      band = rectangle;
      this.#sweep(band, earlier, move.ctrlKey);
    };
    const stop = new AbortController();
    const ended = (/** @type {PointerEvent} */ { type, shiftKey }) => {
      this.busy = false;
      stop.abort();
      this.band.hidden = true;
      if (band || type !== "pointerup" || pressed < 0) return;
      this.select((tiles) => (shiftKey ? tiles.extendTo(pressed) : tiles.toggle(pressed)));
    };
    const { signal } = stop;
    window.addEventListener("pointermove", moved, { signal });
    window.addEventListener("pointerup", ended, { signal });
    window.addEventListener("pointercancel", ended, { signal });
  }

  /** @param {MouseEvent} event @returns {Point} */
  #point(event) {
    const box = this.element.getBoundingClientRect();
    return {
      x: event.clientX - box.left + this.element.scrollLeft,
      y: event.clientY - box.top + this.element.scrollTop,
    };
  }

  /** @param {Rectangle} band @param {Set<number>} earlier @param {boolean} remove */
  #sweep(band, earlier, remove) {
    const every = [...this.elements.keys()];
    const hit = every.filter((index) => overlaps(band, this.elements[index]));
    this.band.hidden = false;
    putAt(this.band, band);
    this.selection.sweep(earlier, hit, remove);
    this.#mark();
    this.sheet.showSelection();
  }
}

/** Rows of a view's table of keys that move the cursor of its grid and select. */
export function selectionKeys(/** @type {() => Selecting | undefined} */ gridOf) {
  /** @type {(keys: string[], does: string, change: SelectionChange) => KeyEntry} */
  const row = (keys, does, change) => {
    const run = (/** @type {KeyboardEvent} */ event) => {
      const grid = gridOf();
      grid?.select((selection) => change(selection, event, grid));
    };
    return { keys, does, run, group: "Selecting patches" };
  };
  /** @type {SelectionChange} */
  const move = (selection, { key, shiftKey }, grid) => {
    const [down, right] = ARROWS[key];
    selection.move(down * grid.columns() + right, shiftKey);
  };
  /** @type {SelectionChange} */
  const toEnd = (selection, { key }) => selection.place(key === "Home" ? 0 : selection.count - 1);
  /** @type {SelectionChange} */
  const toggle = (selection) => selection.count && selection.toggle(selection.cursor);
  return [
    row(arrowKeys(), "move the cursor", move),
    row(arrowKeys("Shift+"), "select what the cursor passes", move),
    row(["Home", "End"], "first, last patch of the page", toEnd),
    row(["Space"], "select the patch under the cursor, or no longer", toggle),
    row(["Ctrl+A"], "select all patches of the page", (selection) => selection.all()),
    row(["Escape"], "select nothing", (selection) => selection.clear()),
  ];
}

/** @param {Point} a @param {Point} b @returns {Rectangle} */
function rectangleOf(a, b) {
  return {
    left: Math.min(a.x, b.x),
    top: Math.min(a.y, b.y),
    width: Math.abs(a.x - b.x),
    height: Math.abs(a.y - b.y),
  };
}

/** @param {Rectangle} rectangle @param {HTMLElement} element */
function overlaps({ left, top, width, height }, element) {
  const { offsetLeft: x, offsetTop: y, offsetWidth, offsetHeight } = element;
  return (
    left < x + offsetWidth && left + width > x && top < y + offsetHeight && top + height > y
  );
}
