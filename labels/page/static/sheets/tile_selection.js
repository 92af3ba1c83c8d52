/**
 * Which of a number of tiles are selected, and where the cursor is: as in a file manager, except
 * that a plain click adds to the selection, because odd patches lie scattered.
 */
export class TileSelection {
  /** @param {number} count how many tiles there are */
  constructor(count = 0) {
    this.count = count;
    this.cursor = 0;
    this.anchor = 0;
    this.chosen = new Set();
    this.before = null; // the selection before Shift began to extend it
  }

  /** Put the cursor on a tile, without selecting it. */
  place(index) {
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

  /** The selected tiles in their order; if there are none, the one under the cursor. */
  targets() {
    if (this.chosen.size > 0) return [...this.chosen].sort((a, b) => a - b);
    return this.count > 0 ? [this.cursor] : [];
  }
}
