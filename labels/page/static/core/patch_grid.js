// Where patches lie on a frame, which of them a pointer crosses, and the one the keyboard is on.

import { mission } from "./mission.js";
/** @import { CursorMove, Point } from "./types.js" */

/** The size of a patch in pixels of a frame, rounded down as in features/frames/grid.py. */
export function patchSize(/** @type {number} */ width, /** @type {number} */ height) {
  const { rows, cols, width: resized } = mission.grid;
  const w = resized ?? width;
  const h = resized ? Math.floor((height * resized) / width) : height;
  return { width: (Math.floor(w / cols) * width) / w, height: (Math.floor(h / rows) * height) / h };
}

/** Row and column of a cell. @returns {[row: number, col: number]} */
export function rowCol(/** @type {number} */ cell) {
  return [Math.floor(cell / mission.grid.cols), cell % mission.grid.cols];
}

/** "row 3, column 4", counted from 0 as in label files. */
export function cellName(/** @type {number} */ cell) {
  const [row, col] = rowCol(cell);
  return `row ${row}, column ${col}`;
}

/** The cell at a row and column, or -1. */
export function cellAt(/** @type {number} */ row, /** @type {number} */ col) {
  const { rows, cols } = mission.grid;
  return row >= 0 && col >= 0 && row < rows && col < cols ? row * cols + col : -1;
}

/** All cells that a straight line crosses, none left out however long it is, in the order in which
 * they are met. Its ends {x, y} are in patches: x in columns, y in rows.
 */
export function cellsOnLine(/** @type {Point} */ from, /** @type {Point} */ to) {
  /** @type {number[]} */
  const cells = [];
  const cuts = [0, 1, ...crossings(from.x, to.x), ...crossings(from.y, to.y)].sort((a, b) => a - b);
  for (let at = 0; at + 1 < cuts.length; at += 1) {
    const t = (cuts[at] + cuts[at + 1]) / 2;
    const row = Math.floor(from.y + (to.y - from.y) * t);
    const col = Math.floor(from.x + (to.x - from.x) * t);
    const cell = cellAt(row, col);
    if (cell >= 0 && cell !== cells.at(-1)) cells.push(cell);
  }
  return cells;
}

/** Where, from 0 to 1 along the way, a coordinate passes whole numbers. */
function crossings(/** @type {number} */ from, /** @type {number} */ to) {
  const cuts = [];
  const low = Math.min(from, to);
  const high = Math.max(from, to);
  for (let whole = Math.floor(low) + 1; whole < high; whole += 1) {
    cuts.push((whole - from) / (to - from));
  }
  return cuts;
}

/** The cells of the rectangle between two of them. */
export function cellsBetween(/** @type {number} */ one, /** @type {number} */ other) {
  const [row1, col1] = rowCol(one);
  const [row2, col2] = rowCol(other);
  const cells = [];
  for (let row = Math.min(row1, row2); row <= Math.max(row1, row2); row += 1) {
    for (let col = Math.min(col1, col2); col <= Math.max(col1, col2); col += 1) {
      cells.push(cellAt(row, col));
    }
  }
  return cells;
}

export function cellsOfRow(/** @type {number} */ row) {
  return cellsBetween(cellAt(row, 0), cellAt(row, mission.grid.cols - 1));
}

export function cellsOfColumn(/** @type {number} */ col) {
  return cellsBetween(cellAt(0, col), cellAt(mission.grid.rows - 1, col));
}

/** Rows and columns that keys add. @type {Record<string, [rows: number, cols: number]>} */
export const ARROWS = {
  ArrowLeft: [0, -1],
  ArrowRight: [0, 1],
  ArrowUp: [-1, 0],
  ArrowDown: [1, 0],
};

/** The names of the arrow keys in tables of keys, with "Shift+" or "Ctrl+" before them. */
export const arrowKeys = (held = "") => Object.keys(ARROWS).map((key) => held + key);

/** The cell some rows and columns away, or the last one before the edge.
 * @param {number} cell @param {number} rows @param {number} cols
 */
export function cellFrom(cell, rows, cols) {
  const [row, col] = rowCol(cell);
  /** @param {number} value @param {number} count */
  const limit = (value, count) => Math.min(count - 1, Math.max(0, value));
  return cellAt(limit(row + rows, mission.grid.rows), limit(col + cols, mission.grid.cols));
}

/** The patch that the keyboard is on, and the rectangle that Shift+arrows spans from it. */
export class PatchCursor {
  constructor() {
    this.cell = 0;
    /** @type {?number} */
    this.anchor = null;
    this.visible = false;
  }

  /** The cells that a key acts on. */
  get cells() {
    return this.anchor === null ? [this.cell] : cellsBetween(this.anchor, this.cell);
  }

  /** Whether more than the cursor's own patch is selected. */
  get spans() {
    return this.anchor !== null && this.anchor !== this.cell;
  }

  /** The first press only shows where the cursor is. @type {CursorMove} */
  move(rows, cols, extend) {
    if (!this.visible) {
      this.visible = true;
      return;
    }
    if (!extend) this.anchor = null;
    else this.anchor ??= this.cell;
    this.cell = cellFrom(this.cell, rows, cols);
  }

  /** Stand on a cell, seen or not. */
  put(/** @type {number} */ cell, /** @type {boolean} */ visible) {
    Object.assign(this, { cell, visible, anchor: null });
  }

  /** Give the rectangle up; whether there was one. */
  collapse() {
    const was = this.spans;
    this.anchor = null;
    return was;
  }
}
