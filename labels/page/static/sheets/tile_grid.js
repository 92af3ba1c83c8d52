// A scrolling grid of patch tiles, selected by mouse, by rectangle or by keyboard.

import { el } from "../core/dom.js";
import { patchAspect } from "../core/pictures.js";
import { TilePictures, patchInTile, putAt } from "./tile_pictures.js";

const DRAG_STARTS = 5; // CSS pixels
let grids = 0;

/**
 * Which of a number of tiles are selected, and where the cursor is: as in a file manager, except
 * that a plain click adds to the selection, because odd patches lie scattered.
 */
class TileSelection {
  /** @param {number} count how many tiles there are */
  constructor(count = 0) {
    this.count = count;
    this.cursor = 0;
    this.anchor = 0;
    /** Whether a person put the cursor where it is; else it stands on the first tile. */
    this.pointed = false;
    this.chosen = new Set();
    this.before = null; // the selection before Shift began to extend it
  }

  /** Put the cursor on a tile, without selecting it. */
  place(index) {
    this.pointed = true;
    this.cursor = Math.max(0, Math.min(this.count - 1, index));
    this.anchor = this.cursor;
    this.before = null;
  }

  /** Select the tile, or no longer. */
  toggle(index) {
    this.place(index);
    if (!this.chosen.delete(index)) this.chosen.add(index);
  }

  /** Select all from the last tile clicked to this one. */
  extendTo(index) {
    this.before ??= new Set(this.chosen);
    this.cursor = Math.max(0, Math.min(this.count - 1, index));
    const [first, last] = [this.anchor, this.cursor].sort((a, b) => a - b);
    this.chosen = new Set(this.before);
    for (let tile = first; tile <= last; tile += 1) this.chosen.add(tile);
  }

  /** Move the cursor by this many tiles; with `extend`, select what it passes. */
  move(step, extend) {
    const target = this.cursor + step;
    this.pointed = true;
    if (target < 0 || target >= this.count) return;
    if (extend) this.extendTo(target);
    else this.place(target);
  }

  /** Add these tiles (or take them away) on top of an earlier selection. */
  sweep(earlier, tiles, remove) {
    this.chosen = new Set(earlier);
    for (const tile of tiles) {
      if (remove) this.chosen.delete(tile);
      else this.chosen.add(tile);
    }
    this.before = null;
  }

  /** Select every tile. */
  all() {
    this.chosen = new Set(Array.from({ length: this.count }, (_, tile) => tile));
  }

  /** Select nothing. */
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

/** Grid of tiles; a tile is anything with `camera`, `frame` and `cell`. */
export class TileGrid {
  /**
   * @param {object} options
   * @param {string} options.label what the grid holds, for screen readers
   * @param {(tile: object) => {name: string, lines: Node[], faded?: boolean}} options.describe
   *   the tile in words, and what stands under its picture
   * @param {number} options.captionLines lines kept free under each picture; 0: the caption
   *   stands over it
   * @param {() => void} options.onChange the selection or the cursor changed
   * @param {(tile: object) => void} options.onOpen a tile was double clicked
   */
  constructor({ label, describe, captionLines, onChange, onOpen }) {
    this.describe = describe;
    this.onChange = onChange;
    this.onOpen = onOpen;
    this.prefix = `tiles-${(grids += 1)}`;
    this.tiles = [];
    this.elements = [];
    this.selection = new TileSelection();
    /** Whether the mouse is held down on a tile. */
    this.busy = false;
    this.list = el("div", {
      class: "tiles", role: "listbox", "aria-multiselectable": "true", "aria-label": label,
      tabindex: 0, "data-home": true, "data-caption-lines": captionLines,
    });
    this.band = el("div", { class: "tile-band", "aria-hidden": "true" });
    this.band.hidden = true;
    this.element = el("div", { class: "tile-scroller" }, this.list, this.band);
    this.pictures = new TilePictures(this.element);
    this.list.addEventListener("pointerdown", (event) => this.#press(event));
    this.list.addEventListener("dblclick", (event) => this.#open(event));
  }

  /**
   * Show these tiles.
   * @param {object[]} tiles
   * @param {{width: number, margin: number}} look Width in CSS pixels, margin around each patch in
   *   patches.
   */
  show(tiles, look) {
    this.tiles = tiles;
    this.selection = new TileSelection(tiles.length);
    this.#build(look);
  }

  /** Show the same tiles at another size; selection and cursor stay. */
  resize(look) {
    this.#build(look);
  }

  /** Describe all tiles anew: labels changed. */
  refresh() {
    this.elements.forEach((element, index) => {
      const { name, lines, faded } = this.describe(this.tiles[index]);
      element.setAttribute("aria-label", name);
      element.classList.toggle("faded", Boolean(faded));
      element.lastElementChild.replaceChildren(...lines);
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
  select(change) {
    change(this.selection);
    this.#mark();
    this.elements[this.selection.cursor]?.scrollIntoView({ block: "nearest" });
    this.onChange();
  }

  /** Let the keyboard's next key go here. */
  focus() {
    this.list.focus({ preventScroll: true });
  }

  /** Tiles in one row, as laid out now. */
  columns() {
    const top = this.elements[0]?.offsetTop;
    const second = this.elements.findIndex((element) => element.offsetTop > top);
    return second < 0 ? Math.max(1, this.elements.length) : second;
  }

  /** Forget the tiles; the view is left. */
  close() {
    this.pictures.stop();
  }

  #build({ width, margin }) {
    this.list.style.setProperty("--tile-width", `${width}px`);
    this.elements = this.tiles.map((tile, index) => this.#tile(tile, index, width, margin));
    this.list.replaceChildren(...this.elements);
    const pictures = this.elements.map((element) => element.firstElementChild);
    this.pictures.show(this.tiles, pictures, { width, height: this.height, margin });
    this.refresh();
    this.onChange();
  }

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
    if (this.tiles.length > 0) {
      this.list.setAttribute("aria-activedescendant", `${this.prefix}-${cursor}`);
    } else this.list.removeAttribute("aria-activedescendant");
  }

  #indexOf(event) {
    return this.elements.indexOf(event.target.closest(".tile"));
  }

  #open(event) {
    const tile = this.tiles[this.#indexOf(event)];
    if (tile) this.onOpen(tile);
  }

  #press(event) {
    if (event.button !== 0) return;
    const pressed = this.#indexOf(event);
    this.busy = true;
    const start = this.#point(event);
    const earlier = new Set(this.selection.chosen);
    let band = null;
    const moved = (move) => {
      const rectangle = rectangleOf(start, this.#point(move));
      if (!band && Math.max(rectangle.width, rectangle.height) < DRAG_STARTS) return;
      band = rectangle;
      this.#sweep(band, earlier, move.ctrlKey);
    };
    const ended = (end) => {
      this.busy = false;
      window.removeEventListener("pointermove", moved);
      window.removeEventListener("pointerup", ended);
      window.removeEventListener("pointercancel", ended);
      this.band.hidden = true;
      if (!band && end.type === "pointerup" && pressed >= 0) this.#click(pressed, end.shiftKey);
    };
    window.addEventListener("pointermove", moved);
    window.addEventListener("pointerup", ended);
    window.addEventListener("pointercancel", ended);
  }

  #click(index, extend) {
    this.select((selection) => (extend ? selection.extendTo(index) : selection.toggle(index)));
  }

  #point(event) {
    const box = this.element.getBoundingClientRect();
    return {
      x: event.clientX - box.left + this.element.scrollLeft,
      y: event.clientY - box.top + this.element.scrollTop,
    };
  }

  #sweep(band, earlier, remove) {
    const hit = this.elements
      .map((element, index) => [element, index])
      .filter(([element]) => overlaps(band, element))
      .map(([, index]) => index);
    this.band.hidden = false;
    putAt(this.band, band);
    this.selection.sweep(earlier, hit, remove);
    this.#mark();
    this.onChange();
  }
}

const STEPS = {
  ArrowLeft: () => -1,
  ArrowRight: () => 1,
  ArrowUp: (grid) => -grid.columns(),
  ArrowDown: (grid) => grid.columns(),
};

/**
 * Rows of a view's table of keys that move the cursor of its grid and select.
 * @param {() => TileGrid} gridOf
 * @returns {KeyEntry[]}
 */
export function selectionKeys(gridOf) {
  const select = (change) => gridOf()?.select(change);
  const move = (event) => {
    const grid = gridOf();
    grid?.select((selection) => selection.move(STEPS[event.key](grid), event.shiftKey));
  };
  const row = (keys, does, run) => ({ keys, does, run, group: "Selecting patches" });
  const arrows = Object.keys(STEPS);
  return [
    row(arrows, "move the cursor", move),
    row(arrows.map((key) => `Shift+${key}`), "select what the cursor passes", move),
    row(["Home", "End"], "first, last patch of the page", (event) =>
      select((selection) => selection.place(event.key === "Home" ? 0 : selection.count - 1)),
    ),
    row(["Space"], "select the patch under the cursor, or no longer", () =>
      select((selection) => selection.count && selection.toggle(selection.cursor)),
    ),
    row(["Ctrl+A"], "select all patches of the page", () =>
      select((selection) => selection.all()),
    ),
    row(["Escape"], "select nothing", () => select((selection) => selection.clear())),
  ];
}

function rectangleOf(a, b) {
  return {
    left: Math.min(a.x, b.x),
    top: Math.min(a.y, b.y),
    width: Math.abs(a.x - b.x),
    height: Math.abs(a.y - b.y),
  };
}

function overlaps({ left, top, width, height }, element) {
  const { offsetLeft: x, offsetTop: y, offsetWidth, offsetHeight } = element;
  return (
    left < x + offsetWidth && left + width > x && top < y + offsetHeight && top + height > y
  );
}
