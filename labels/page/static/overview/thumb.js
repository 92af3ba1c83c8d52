// One frame of the overview: its picture, its labels and suggestions, and its state in words.
// Labels are drawn as in the view of one frame.

import { contextOf, el, setAttribute } from "../core/dom.js";
import { maskedCells, mission, setting, stateOf } from "../core/mission.js";
import { learnShape, thumbAddress } from "../core/pictures.js";
import { hintsOf } from "../labelling/painting.js";
import { MASKED, drawCells, drawCursor, drawMasked, shownCell } from "../labelling/cell_drawing.js";
import { cellAt, patchSize, rowCol } from "../core/patch_grid.js";
import { suggestionFault } from "../labelling/suggest.js";
import { STATES } from "../labelling/frame_states.js";
import { labelsOf } from "../saving/labels.js";
/** @import { ShownCell, ThumbContent, ThumbHost, ThumbMarks } from "../types.js" */

/** What a frame shows; null while it is not loaded. @returns {?ThumbContent} */
export function contentOf(/** @type {string} */ camera, /** @type {number} */ frame) {
  const labels = labelsOf(camera, frame);
  if (!labels) return null;
  const waits = suggesting() && labels.suggestions === null;
  const fault = suggestionFault(camera, frame);
  const noted = labels.notes.length > 0;
  return { mine: labels.mine, hints: hintsOf(camera, frame), waits, fault, noted };
}

/** Whether a model's suggestions are shown. */
export function suggesting() {
  return Boolean(mission.model) && !mission.blind && setting("suggestions");
}

export class Thumb {
  /** @param {string} camera @param {number} frame @param {ThumbHost} told */
  constructor(camera, frame, { onShape, onPicture }) {
    this.camera = camera;
    this.frame = frame;
    this.size = { width: 0, height: 0 };
    this.drawn = ""; // what was drawn and said last
    this.name = "";
    /** @type {?ThumbContent} */
    this.content = null;
    this.image = el("img", { alt: "", draggable: "false" });
    this.canvas = el("canvas", { "aria-hidden": "true" });
    this.number = el("span", { class: "thumb-number", text: String(frame) });
    this.state = el("span", { class: "thumb-state" });
    const title = "leave this frame out, or no longer (x)";
    this.leave = el("span", { class: "thumb-leave", text: "×", title });
    this.picture = el("div", { class: "thumb-picture" }, this.image, this.canvas);
    const names = { "data-camera": camera, "data-frame": frame };
    this.element = el("div", { class: "thumb", role: "option", ...names },
      this.picture,
      el("div", { class: "thumb-caption" }, this.number, this.state, this.leave),
    );
    /** @type {?boolean} Whether the picture is on the screen; null while it is loading. */
    this.seen = null;
    this.picture.addEventListener("pointermove", ({ clientX, clientY }) => {
      const masked = maskedCells(camera).has(this.cellAt(clientX, clientY));
      setAttribute(this.picture, "title", masked ? MASKED : null);
    });
    this.image.addEventListener("load", () => {
      this.seen = true;
      if (learnShape(camera, this.image)) onShape();
      else onPicture();
    });
    this.image.addEventListener("error", () => {
      this.seen = false;
      this.picture.classList.add("unreadable");
      this.picture.dataset.words = "This frame cannot be shown.";
      onPicture();
    });
  }

  /** Take a place and a size in CSS pixels; a picture that is there stays until a better one is. */
  place(/** @type {string} */ id, /** @type {number} */ width, /** @type {number} */ height) {
    this.element.id = id;
    this.size = { width, height };
    this.element.style.width = `${width}px`;
    this.picture.style.height = `${height}px`;
    setAttribute(this.image, "src", thumbAddress(this.camera, this.frame, width));
  }

  /** The cell under a point of the window; -1 if it is not over the picture. */
  cellAt(/** @type {number} */ x, /** @type {number} */ y) {
    const box = this.canvas.getBoundingClientRect();
    const { width, height } = patchSize(box.width, box.height);
    return cellAt(Math.floor((y - box.top) / height), Math.floor((x - box.left) / width));
  }

  /** Draw labels and suggestions, and say the state. */
  draw(/** @type {ThumbMarks} */ { excluded, painted, cursor }) {
    const content = contentOf(this.camera, this.frame);
    this.content = content;
    this.element.classList.toggle("left-out", excluded);
    this.element.classList.toggle("loading", !content || this.seen === null);
    const masked = maskedCells(this.camera);
    this.#drawOnce(content ? shownCells(content, masked, painted) : [], [...masked], cursor);
    this.#say(content, excluded);
  }

  /** Drawing takes much longer than finding out that nothing is to be drawn. */
  /** @param {(?ShownCell)[]} cells @param {number[]} masked @param {?number} cursor */
  #drawOnce(cells, masked, cursor) {
    const drawn = JSON.stringify([setting("tint"), this.size, cursor, cells, masked]);
    if (drawn === this.drawn) return;
    this.drawn = drawn;
    const { width, height } = this.size;
    const scale = Math.min(2, window.devicePixelRatio || 1);
    this.canvas.width = Math.round(width * scale);
    this.canvas.height = Math.round(height * scale);
    const ctx = contextOf(this.canvas);
    ctx.scale(scale, scale);
    const patch = patchSize(width, height);
    const boxOf = (/** @type {number} */ index) => {
      const [row, col] = rowCol(index);
      return { x: col * patch.width, y: row * patch.height, ...patch };
    };
    drawMasked({ ctx, boxOf }, masked);
    if (cells.length) drawCells({ ctx, boxOf }, cells);
    drawCursor({ ctx, boxOf }, cursor, []);
  }

  #say(/** @type {?ThumbContent} */ content, /** @type {boolean} */ excluded) {
    const state = STATES[stateOf(this.camera, this.frame)]?.words ?? "";
    const shown = excluded ? "left out" : content ? content.fault || state : "loading";
    const words = content?.noted ? `${shown}, note` : shown;
    const proposed = content?.hints.filter(Boolean).length ?? 0;
    const more = proposed ? `, ${proposed} patches suggested` : "";
    const name = `${this.camera} ${this.frame}, ${words}${more}`;
    if (name === this.name) return;
    this.name = name;
    this.state.textContent = words;
    this.state.title = words;
    this.element.setAttribute("aria-label", name);
  }
}

/** @param {ThumbContent} content @param {Set<number>} masked @param {?Map<number, string>} painted */
function shownCells({ mine, hints }, masked, painted) {
  const labelOf = (/** @type {number} */ cell) => painted?.get(cell) ?? mine[cell];
  return mine.map((_, cell) => masked.has(cell) ? null : shownCell(labelOf(cell), hints[cell]));
}
