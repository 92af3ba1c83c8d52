// The state of the view of one frame: what is on the page, and what outlasts it.

import { PatchCursor } from "../core/patch_grid.js";

/**
 * @import { Hint } from "../labelling/painting.js"
 * @import { Place } from "../core/messages.js"
 * @import { SaveState } from "../saving/saver.js"
 * @import { Beside } from "./beside.js"
 * @import { FrameCanvas } from "./frame_canvas.js"
 * @import { FrameShow } from "./frame_show.js"
 * @import { PointerGestures } from "./gestures.js"
 * @import { Player } from "./play.js"
 * @import { Timeline } from "./timeline.js"
 */

/**
 * What is on the page while the view is shown.
 * @typedef {Object} FramePage
 * @property {HTMLElement} root
 * @property {FrameCanvas} canvas
 * @property {HTMLElement} element     The canvas's own.
 * @property {HTMLElement} status      The line of words.
 * @property {FrameShow} show
 * @property {Beside} beside
 * @property {Timeline} timeline
 * @property {Player} player
 * @property {PointerGestures} pointer
 * @property {{show: (chosen: string) => void}} tools
 * @property {HTMLButtonElement[]} toggles
 * @property {{show: (said: string) => void}} drawer
 * @property {{number: HTMLInputElement, show: (camera: string, frame: number) => void}} bar
 * @property {(() => void)[]} stops    What ends listening to news.
 * @property {(?Hint)[]} hints         What is proposed for each patch.
 * @property {number} hovered          The cell under the pointer; -1: none.
 * @property {string} info             When and where the frame was taken, in words.
 * @property {Record<string, number | undefined>} timers
 * @property {SaveState} [savedState]  As it was shown last.
 * @property {number} [noted]          When the address was changed last.
 */

/** The view's state; all of it. */
export const view = {
  /** @type {?FramePage} Null while another view is shown. */
  page: null,
  /** @type {"paint" | "erase" | "confirm"} What the chosen tool does. */
  tool: "paint",
  /** Why this frame is shown, where it was asked for. */
  why: "",
  /** @type {?{panned: boolean}} While the space bar is down. */
  space: null,
  /** @type {?Place} Where the person was, to come back to. */
  last: null,
  cursor: new PatchCursor(),
};

/** What is on the page; only to be asked while the view is shown. */
export function page() {
  if (!view.page) throw new Error("the view of one frame is not shown");
  return view.page;
}

/**
 * Whether a frame, or all of them (nulls), is what is shown.
 * @param {?string} camera @param {?number} frame
 */
export function isHere(camera, frame) {
  const { show } = page();
  return camera === null || (camera === show.camera && frame === show.frame);
}
