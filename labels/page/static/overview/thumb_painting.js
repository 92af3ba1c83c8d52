// Painting patches in thumbnails: a click, a stroke over one or several frames, a rectangle,
// or the same patches in all frames shown.

import { cellsBetween } from "../core/patch_grid.js";
/** @import { Cells, Point, StrokeHost, Thumb } from "../types.js" */

const STEP = 4; // CSS pixels between two looks at what a stroke passes

/** Let strokes be painted over the thumbnails in an element. */
export function paintOver(/** @type {HTMLElement} */ element, /** @type {StrokeHost} */ host) {
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("pointerdown", (event) => {
    const thumb = host.thumbAt(event.clientX, event.clientY);
    if (!thumb || ![0, 2].includes(event.button)) return;
    event.preventDefault();
    new Stroke(event, thumb, host).begin();
  });
}

class Stroke {
  /** @param {PointerEvent} event @param {Thumb} thumb @param {StrokeHost} host */
  constructor(event, thumb, host) {
    this.thumb = thumb;
    this.host = host;
    this.button = event.button;
    this.last = { x: event.clientX, y: event.clientY };
    this.first = thumb.cellAt(this.last.x, this.last.y);
    /** @type {Cells} */
    this.cells = new Map();
    this.painted = this.cells;
    this.stop = new AbortController();
    this.#add(event);
  }

  begin() {
    const { signal } = this.stop;
    window.addEventListener("pointermove", (event) => this.#add(event), { signal });
    window.addEventListener("pointerup", () => this.#end(true), { signal });
    window.addEventListener("pointercancel", () => this.#end(false), { signal });
    window.addEventListener("blur", () => this.#end(false), { signal });
    window.addEventListener("keydown", (event) => this.#key(event), { signal, capture: true });
  }

  #key(/** @type {KeyboardEvent} */ event) {
    if (event.key !== "Escape") return;
    event.stopPropagation();
    this.#end(false);
  }

  #add(/** @type {PointerEvent} */ event) {
    const to = { x: event.clientX, y: event.clientY };
    if (event.shiftKey) this.#rectangle(to);
    else this.#line(to);
    this.last = to;
    this.painted = event.ctrlKey ? this.#everywhere() : this.cells;
    this.host.onStroke(this.painted, this.button);
  }

  #line(/** @type {Point} */ to) {
    const length = Math.hypot(to.x - this.last.x, to.y - this.last.y);
    const steps = Math.max(1, Math.ceil(length / STEP));
    for (let step = 0; step <= steps; step += 1) {
      const x = this.last.x + ((to.x - this.last.x) * step) / steps;
      const y = this.last.y + ((to.y - this.last.y) * step) / steps;
      const thumb = this.host.thumbAt(x, y);
      const cell = thumb ? thumb.cellAt(x, y) : -1;
      if (thumb && cell >= 0) this.#of(thumb).add(cell);
    }
  }

  #rectangle(/** @type {Point} */ to) {
    const last = this.thumb.cellAt(to.x, to.y);
    if (last >= 0) this.cells = new Map([[this.thumb, new Set(cellsBetween(this.first, last))]]);
  }

  #of(/** @type {Thumb} */ thumb) {
    const cells = this.cells.get(thumb) ?? new Set();
    this.cells.set(thumb, cells);
    return cells;
  }

  #everywhere() {
    const cells = new Set([...this.cells.values()].flatMap((some) => [...some]));
    return new Map(this.host.allThumbs(this.thumb).map((thumb) => [thumb, cells]));
  }

  #end(/** @type {boolean} */ done) {
    this.stop.abort();
    this.host.onStroke(null, this.button);
    if (done) this.host.onPainted(this.painted, this.button, this.cells);
  }
}
