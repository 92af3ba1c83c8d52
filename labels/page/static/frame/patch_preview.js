// One patch at a larger size, and where it lies in its frame.

import { el } from "../core/dom.js";
import { frameAspect, patchAspect, thumbAddress } from "../core/frame_shape.js";
import { cellName, patchSize, rowCol } from "./patch_grid.js";
import { patchInTile, patchesAddress, placeTile } from "../sheets/tile_pictures.js";

const WIDTH = 240; // CSS pixels, of both pictures
const MARGIN = 1;

/**
 * A patch in words: "left 17, row 3, column 4".
 * @param {{camera: string, frame: number, cell: number}} tile
 * @returns {string}
 */
export function nameOf({ camera, frame, cell }) {
  return `${camera} ${frame}, ${cellName(cell)}`;
}

/** The panel beside a grid of tiles. */
export class PatchPreview {
  constructor() {
    this.patch = el("div", { class: "preview-patch" });
    this.patchMark = el("div", { class: "preview-mark" });
    this.frame = el("img", { attrs: { alt: "", width: WIDTH } });
    this.frameMark = el("div", { class: "preview-mark" });
    this.words = el("div", { class: "preview-words" });
    this.element = el(
      "aside",
      { class: "preview", attrs: { "aria-label": "The patch under the cursor" } },
      el("div", { class: "preview-picture" }, this.patch, this.patchMark),
      el("div", { class: "preview-picture" }, this.frame, this.frameMark),
      this.words,
    );
  }

  /**
   * Show a patch.
   * @param {{camera: string, frame: number, cell: number} | undefined} tile Nothing: hide.
   * @param {(string | Node)[]} lines What to say about it.
   */
  show(tile, lines) {
    this.element.classList.toggle("nothing", !tile);
    if (!tile) return;
    this.#showPatch(tile);
    this.#showFrame(tile);
    this.words.replaceChildren(
      el("strong", { text: nameOf(tile) }),
      ...lines.map((line) => el("p", {}, line)),
    );
  }

  #showPatch(tile) {
    const height = Math.round(WIDTH * patchAspect(tile.camera));
    this.patch.style.height = `${height}px`;
    placeTile(this.patch, patchesAddress([tile], WIDTH, MARGIN), 0, WIDTH, height);
    putAt(this.patchMark, patchInTile(tile, WIDTH, height, MARGIN));
  }

  #showFrame({ camera, frame, cell }) {
    const { width, height } = patchSize(WIDTH, WIDTH * frameAspect(camera));
    const source = thumbAddress(camera, frame, WIDTH);
    if (this.frame.getAttribute("src") !== source) this.frame.src = source;
    const [row, col] = rowCol(cell);
    putAt(this.frameMark, { left: col * width, top: row * height, width, height });
  }
}

/**
 * Put an element where a rectangle is.
 * @param {HTMLElement} element
 * @param {{left: number, top: number, width: number, height: number}} rectangle In pixels.
 */
export function putAt(element, rectangle) {
  for (const [side, value] of Object.entries(rectangle)) element.style[side] = `${value}px`;
}
