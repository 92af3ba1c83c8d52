// The patch that the keyboard is on, and the rectangle that Shift+arrows spans from it.

import { mission } from "../core/mission.js";
import { cellAt, cellsBetween, rowCol } from "./patch_grid.js";

/** Where the keyboard works on the frame. */
export class PatchCursor {
  constructor() {
    this.cell = 0;
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

  /**
   * Move by rows and columns; the first press only shows where the cursor is.
   * @param {number} rows
   * @param {number} cols
   * @param {boolean} extend Keep the other corner of the rectangle.
   */
  move(rows, cols, extend) {
    if (!this.visible) {
      this.visible = true;
      return;
    }
    if (!extend) this.anchor = null;
    else this.anchor ??= this.cell;
    const [row, col] = rowCol(this.cell);
    const limit = (value, count) => Math.min(count - 1, Math.max(0, value));
    this.cell = cellAt(limit(row + rows, mission.grid.rows), limit(col + cols, mission.grid.cols));
  }

  /**
   * Stand on a cell.
   * @param {number} cell
   * @param {boolean} visible Whether to show it.
   */
  put(cell, visible) {
    this.cell = cell;
    this.anchor = null;
    this.visible = visible;
  }

  /**
   * Give the rectangle up.
   * @returns {boolean} Whether there was one.
   */
  collapse() {
    const was = this.spans;
    this.anchor = null;
    return was;
  }
}
