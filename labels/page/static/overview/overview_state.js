// The state of the overview: what is on the page, and what outlasts it.

/** @import { OverviewState, Sheet } from "../types.js" */

/** The view's state; all of it. @type {OverviewState} */
export const view = { parts: null, page: null, last: null, painted: null, clicks: [] };

/** The elements on show; only to be asked while the view is shown. */
export function parts() {
  if (!view.parts) throw new Error("the overview is not shown");
  return view.parts;
}

/** What is shown; only to be asked while something is. */
export function page() {
  if (!view.page) throw new Error("the overview shows nothing yet");
  return view.page;
}

/** A page from a frame on, with nothing on it yet. */
export function newPage(/** @type {string} */ camera, /** @type {number} */ first) {
  /** @type {Sheet} */
  const made = {
    camera, first, asked: null, excluded: new Set(), thumbs: [], count: 0, width: 0, focus: 0,
    cell: null, stroke: null, touched: new Set(), passes: () => true,
  };
  return made;
}
