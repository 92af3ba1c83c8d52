// The mask of a camera as it is being drawn: what a person changed of it and did not save yet.

import { maskedCells } from "../core/mission.js";
import { view } from "./frame_state.js";

/** The changes that are not saved. */
function changes(/** @type {string} */ camera) {
  const saved = maskedCells(camera);
  return [...(view.drafts[camera] ?? [])].filter(([cell, masks]) => saved.has(cell) !== masks);
}

/** The cells whose change is not saved. */
export function unsaved(/** @type {string} */ camera) {
  return changes(camera).map(([cell]) => cell);
}

/** Whether a cell was changed in Mask mode, which is on, and not saved. */
export function isUnsaved(/** @type {string} */ camera, /** @type {number} */ cell) {
  return view.tool === "mask" && unsaved(camera).includes(cell);
}

/** The masked cells with the changes that are not saved. */
export function drawnMask(/** @type {string} */ camera) {
  const drawn = new Set(maskedCells(camera));
  for (const [cell, masks] of changes(camera)) {
    if (masks) drawn.add(cell);
    else drawn.delete(cell);
  }
  return drawn;
}

/** The mask that is shown: as it is drawn in Mask mode, else as it is saved. */
export function shownMask(/** @type {string} */ camera) {
  return view.tool === "mask" ? drawnMask(camera) : maskedCells(camera);
}

/** Mask patches, or make them view again: by default all as the first of them is not.
 * @param {string} camera @param {number[]} cells
 */
export function drawMask(camera, cells, masks = !drawnMask(camera).has(cells[0])) {
  const draft = (view.drafts[camera] = new Map(changes(camera)));
  for (const cell of cells) draft.set(cell, masks);
}

/** Forget what is saved by now, or all of it. @param {string} camera */
export function endDraft(camera, all = false) {
  view.drafts[camera] = new Map(all ? [] : changes(camera));
}
