// The state of the view of one frame: what is on the page, and what outlasts it.

import { PatchCursor } from "../core/patch_grid.js";
/** @import { FrameState } from "../types.js" */

/** The view's state; all of it. @type {FrameState} */
export const view = {
  page: null, tool: "paint", drafts: {}, why: "", space: null, last: null,
  cursor: new PatchCursor(),
};

/** What is on the page; only to be asked while the view is shown. */
export function page() {
  if (!view.page) throw new Error("the view of one frame is not shown");
  return view.page;
}

/** Whether a frame, or all of them (nulls), is what is shown. */
export function isHere(/** @type {?string} */ camera, /** @type {?number} */ frame) {
  const { show } = page();
  return camera === null || (camera === show.camera && frame === show.frame);
}
