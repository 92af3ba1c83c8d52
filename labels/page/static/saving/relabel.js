// Many patches of many frames given one label in one action.

import { act } from "./saver.js";

/** "23 patches are", "1 patch is" */
export function patchesAre(count) {
  return count === 1 ? "1 patch is" : `${count.toLocaleString("en")} patches are`;
}

/**
 * Changes in the form of the wire: one for each frame and label, cells in order.
 * @param {{camera: string, frame: number, cell: number, label: string | null,
 *   base: string | null, model?: string}[]} patches
 */
function changesOf(patches) {
  const groups = new Map();
  for (const { camera, frame, cell, label, base, model } of patches) {
    const key = JSON.stringify([camera, frame, label, model ?? null]);
    if (!groups.has(key)) {
      const group = { camera, frame, label, cells: [], base: [] };
      groups.set(key, model ? { ...group, model } : group);
    }
    groups.get(key).cells.push(cell);
    groups.get(key).base.push(base);
  }
  return [...groups.values()];
}

/** Do it, as one action that one undo takes back; returns how many patches change. */
export function actOn(kind, patches, options = {}) {
  const changing = patches.filter(({ label, base, model }) => model || label !== base);
  if (changing.length > 0) act(kind, changesOf(changing), options);
  return changing.length;
}
