// Pictures of patches: many in one image (a sprite), fetched when they come into view; and one of
// them at a larger size, with where it lies in its frame.

import { address } from "../core/api.js";
import { el } from "../core/dom.js";
import { mission, setting } from "../core/mission.js";
import { frameAspect, patchAspect, thumbAddress } from "../core/pictures.js";
import { cellName, patchSize, rowCol } from "../core/patch_grid.js";
/** @import { Chunk, Look, Patch, Rectangle } from "../types.js" */

const COLUMNS = 10;
const CHUNK = 20;
const LARGEST = 256; // pixels; the server makes no larger tile

// Address of one image with these patches, ten square tiles to a row.
/** @param {Patch[]} tiles @param {number} width @param {number} margin */
function patchesAddress(tiles, width, margin) {
  const pixels = Math.round(width * Math.min(2, window.devicePixelRatio || 1));
  return address("/api/patches", {
    cells: tiles.map(({ camera, frame, cell }) => `${camera}:${frame}:${cell}`).join(","),
    size: Math.min(LARGEST, pixels),
    margin,
    enhance: setting("enhance"),
    v: mission.pictures,
    who: null,
  });
}

/** Show one tile of a sprite in an element as wide as a tile and of the patches' shape.
 * @param {HTMLElement} element @param {string} sprite @param {number} position
 * @param {number} width @param {number} height
 */
function placeTile(element, sprite, position, width, height) {
  const [column, row] = [position % COLUMNS, Math.floor(position / COLUMNS)];
  // Tiles are square with the patch in their middle: what is above and below it is cut off.
  const top = row * width + (width - height) / 2;
  element.style.backgroundImage = `url("${sprite}")`;
  element.style.backgroundSize = `${COLUMNS * width}px auto`;
  element.style.backgroundPosition = `${-column * width}px ${-top}px`;
}

/** Where the patch itself lies within its tile, at a frame's edge not in the middle.
 * @type {(patch: Patch, width: number, height: number, margin: number) => Rectangle}
 */
export function patchInTile({ camera, cell }, width, height, margin) {
  const { rows, cols } = mission.grid;
  const [row, col] = rowCol(cell);
  const [left, right] = [Math.min(margin, col), Math.min(margin, cols - 1 - col)];
  const [above, below] = [Math.min(margin, row), Math.min(margin, rows - 1 - row)];
  const aspect = patchAspect(camera);
  const [across, down] = [1 + left + right, (1 + above + below) * aspect];
  const scale = width / Math.max(across, down); // pixels for the width of a patch
  return {
    left: (width - across * scale) / 2 + left * scale,
    top: (height - down * scale) / 2 + above * aspect * scale,
    width: scale,
    height: aspect * scale,
  };
}

/** Fills elements with the pictures of their patches as they scroll into view. */
export class TilePictures {
  constructor(/** @type {HTMLElement} */ scroller) {
    /** @type {Map<Element, Chunk>} */
    this.chunkOf = new Map();
    this.observer = new IntersectionObserver((entries) => this.#seen(entries), {
      root: scroller,
      rootMargin: "300px",
    });
  }

  /** Show these patches, each in one of the elements.
   * @param {Patch[]} tiles @param {HTMLElement[]} elements @param {Look} look
   */
  show(tiles, elements, look) {
    this.stop();
    for (let first = 0; first < tiles.length; first += CHUNK) {
      /** @type {Chunk} */
      const chunk = {
        sprite: patchesAddress(tiles.slice(first, first + CHUNK), look.width, look.margin),
        elements: elements.slice(first, first + CHUNK),
        look,
        image: null,
      };
      for (const element of chunk.elements) {
        this.chunkOf.set(element, chunk);
        this.observer.observe(element);
      }
    }
  }

  stop() {
    this.observer.disconnect();
    for (const { image } of this.chunkOf.values()) if (image) image.src = "";
    this.chunkOf.clear();
  }

  #seen(/** @type {IntersectionObserverEntry[]} */ entries) {
    for (const entry of entries) {
      const chunk = this.chunkOf.get(entry.target);
      if (entry.isIntersecting && chunk && !chunk.image) load(chunk);
    }
  }
}

function load(/** @type {Chunk} */ chunk) {
  const { sprite, elements, look } = chunk;
  const image = (chunk.image = new Image());
  image.addEventListener("load", () =>
    elements.forEach((one, at) => placeTile(one, sprite, at, look.width, look.height)),
  );
  image.addEventListener("error", () => {
    if (image.src !== new URL(sprite, location.href).href) return; // no longer wanted
    for (const element of elements) element.classList.add("no-picture");
  });
  image.src = sprite;
}

const PREVIEW = 240; // CSS pixels, the width of both pictures
const PREVIEW_MARGIN = 1;

/** A patch in words: "left 17, row 3, column 4". */
export function nameOf(/** @type {Patch} */ { camera, frame, cell }) {
  return `${camera} ${frame}, ${cellName(cell)}`;
}

/** The panel beside a grid of tiles. */
export class PatchPreview {
  constructor() {
    this.patch = el("div", { class: "preview-patch" });
    this.patchMark = el("div", { class: "preview-mark" });
    this.frame = el("img", { alt: "", width: PREVIEW });
    this.frameMark = el("div", { class: "preview-mark" });
    this.words = el("div", { class: "preview-words" });
    this.element = el("aside", { class: "preview", "aria-label": "The patch under the cursor" },
      el("div", { class: "preview-picture" }, this.patch, this.patchMark),
      el("div", { class: "preview-picture" }, this.frame, this.frameMark),
      this.words,
    );
  }

  /** Show a patch, and say these lines about it; without one hide. */
  show(/** @type {Patch | undefined} */ tile, /** @type {string[]} */ lines) {
    this.element.classList.toggle("nothing", !tile);
    if (!tile) return;
    this.#showPatch(tile);
    this.#showFrame(tile);
    this.words.replaceChildren(
      el("strong", { text: nameOf(tile) }),
      ...lines.map((line) => el("p", {}, line)),
    );
  }

  #showPatch(/** @type {Patch} */ tile) {
    const height = Math.round(PREVIEW * patchAspect(tile.camera));
    this.patch.style.height = `${height}px`;
    placeTile(this.patch, patchesAddress([tile], PREVIEW, PREVIEW_MARGIN), 0, PREVIEW, height);
    putAt(this.patchMark, patchInTile(tile, PREVIEW, height, PREVIEW_MARGIN));
  }

  #showFrame(/** @type {Patch} */ { camera, frame, cell }) {
    const { width, height } = patchSize(PREVIEW, PREVIEW * frameAspect(camera));
    const source = thumbAddress(camera, frame, PREVIEW);
    if (this.frame.getAttribute("src") !== source) this.frame.src = source;
    const [row, col] = rowCol(cell);
    putAt(this.frameMark, { left: col * width, top: row * height, width, height });
  }
}

/** Put an element where a rectangle is. */
export function putAt(/** @type {HTMLElement} */ element, /** @type {Rectangle} */ rectangle) {
  for (const [side, value] of Object.entries(rectangle)) {
    element.style.setProperty(side, `${value}px`);
  }
}
