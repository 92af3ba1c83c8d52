// What part of a frame a canvas shows: zoom and pan, from frame pixels to the canvas and back.

import { patchSize } from "../core/patch_grid.js";
/** @import { Box } from "../types.js" */

const MAX_ZOOM = 24;
const MARGIN = { left: 26, top: 20, right: 6, bottom: 6 }; // CSS pixels: row and column heads

/** What part of a frame the canvas shows. Sizes in CSS pixels. */
export class Viewport {
  constructor() {
    this.canvas = { width: 1, height: 1 };
    this.frame = { width: 4, height: 3 };
    this.zoom = 1; // 1: the whole frame fits
    this.centre = { x: 0.5, y: 0.5 }; // parts of the frame
  }

  /** Pixels of the canvas for one of the frame. */
  get scale() {
    const { width, height } = this.room;
    return Math.min(width / this.frame.width, height / this.frame.height) * this.zoom;
  }

  /** The part of the canvas that the frame may fill. */
  get room() {
    return {
      width: Math.max(1, this.canvas.width - MARGIN.left - MARGIN.right),
      height: Math.max(1, this.canvas.height - MARGIN.top - MARGIN.bottom),
    };
  }

  /** Size of a patch in frame pixels. */
  get patch() {
    return patchSize(this.frame.width, this.frame.height);
  }

  /** Where the frame's upper left corner lies on the canvas. */
  get origin() {
    const { width, height } = this.room;
    return {
      x: MARGIN.left + width / 2 - this.centre.x * this.frame.width * this.scale,
      y: MARGIN.top + height / 2 - this.centre.y * this.frame.height * this.scale,
    };
  }

  /** From canvas to frame pixels. */
  toFrame(/** @type {number} */ x, /** @type {number} */ y) {
    const { origin, scale } = this;
    return { x: (x - origin.x) / scale, y: (y - origin.y) / scale };
  }

  /** Zoom by a factor; what lies under (x, y) on the canvas stays there. */
  zoomBy(/** @type {number} */ factor, /** @type {number} */ x, /** @type {number} */ y) {
    const held = this.toFrame(x, y);
    this.zoom = Math.min(MAX_ZOOM, Math.max(1, this.zoom * factor));
    const now = this.toFrame(x, y);
    this.moveCentre(held.x - now.x, held.y - now.y);
  }

  zoomMiddle(/** @type {number} */ factor) {
    const { width, height } = this.room;
    this.zoomBy(factor, MARGIN.left + width / 2, MARGIN.top + height / 2);
  }

  fit() {
    this.zoom = 1;
    this.centre = { x: 0.5, y: 0.5 };
  }

  pan(/** @type {number} */ dx, /** @type {number} */ dy) {
    this.moveCentre(-dx / this.scale, -dy / this.scale);
  }

  /** Move so that a box of frame pixels is in sight. */
  reveal(/** @type {Box} */ { x, y, width, height }) {
    const first = this.toFrame(MARGIN.left, MARGIN.top);
    const { width: w, height: h } = this.room;
    const last = this.toFrame(MARGIN.left + w, MARGIN.top + h);
    this.moveCentre(
      Math.min(0, x - first.x) + Math.max(0, x + width - last.x),
      Math.min(0, y - first.y) + Math.max(0, y + height - last.y),
    );
  }

  moveCentre(/** @type {number} */ dx, /** @type {number} */ dy) {
    const { centre, frame, room, scale } = this;
    this.centre = {
      x: hold(centre.x + dx / frame.width, room.width, frame.width * scale),
      y: hold(centre.y + dy / frame.height, room.height, frame.height * scale),
    };
  }
}

// The frame's edge does not come inside the canvas while the frame is larger than it.
/** @param {number} centre @param {number} room @param {number} size */
function hold(centre, room, size) {
  if (size <= room) return 0.5;
  const half = room / size / 2;
  return Math.min(1 - half, Math.max(half, centre));
}
