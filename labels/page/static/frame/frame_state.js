// The state of the view of one frame: what is on the page, and what outlasts it.

import { PatchCursor } from "../core/patch_grid.js";

/** @import { FramePage, Place } from "../types.js" */

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

/** Whether a frame, or all of them (nulls), is what is shown.
 * @param {?string} camera @param {?number} frame
 */
export function isHere(camera, frame) {
  const { show } = page();
  return camera === null || (camera === show.camera && frame === show.frame);
}
