// Labels copied from the frame before: unconfirmed until accepted, kept in the browser meanwhile.

import { mission, who } from "./mission.js";
import { read, remove, write } from "./storage.js";

const PREFIX = "tokt.copy/";

function nameOf(camera, frame) {
  const { rows, cols } = mission.grid;
  return `${PREFIX}${mission.mission}/${rows}x${cols}/${who()}/${camera}/${frame}`;
}

/**
 * The unconfirmed copies on a frame.
 * @param {string} camera
 * @param {number} frame
 * @returns {(?string)[]} One a cell; empty where there are none.
 */
export function copiesOf(camera, frame) {
  return read(nameOf(camera, frame)) ?? [];
}

/**
 * Set the copies of a frame.
 * @param {string} camera
 * @param {number} frame
 * @param {(?string)[]} labels
 * @returns {boolean} Whether the browser keeps them.
 */
export function setCopies(camera, frame, labels) {
  const name = nameOf(camera, frame);
  if (labels.some((label) => label !== null)) return write(name, labels);
  remove(name);
  return true;
}

/**
 * Drop the copies of some cells: they have a label now.
 * @param {string} camera
 * @param {number} frame
 * @param {number[]} cells
 */
export function dropCopiesOf(camera, frame, cells) {
  const labels = copiesOf(camera, frame);
  if (!cells.some((cell) => labels[cell])) return;
  for (const cell of cells) labels[cell] = null;
  setCopies(camera, frame, labels);
}
