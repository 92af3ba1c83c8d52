// Sentences about a frame and its patches, for the status line and for screen readers.

import { disagree } from "./cell_drawing.js";
import { stateOf } from "../core/mission.js";
import { cellName } from "./patch_grid.js";
import { STATES } from "./timeline.js";

/**
 * A frame in words.
 * @param {string} camera
 * @param {number} frame
 * @param {?Object} labels
 * @returns {string}
 */
export function describeFrame(camera, frame, labels) {
  const words = [`${camera} frame ${frame}`];
  if (labels) {
    const done = labels.mine.filter((label) => label !== null).length;
    words.push(`${done} of ${labels.mine.length} labelled`);
  }
  const state = stateOf(camera, frame);
  if (state === "x" || state === "d") words.push(STATES[state].words);
  return words.join(" · ");
}

/**
 * A patch in words.
 * @param {number} cell
 * @param {Object} labels
 * @param {?Object} hint
 * @returns {string}
 */
export function describeCell(cell, labels, hint) {
  const words = [`${cellName(cell)}: ${labels.mine[cell] ?? "no label of mine"}`];
  const version = labels.models[cell];
  if (version) words.push(`confirmed from ${version}`);
  if (labels.pending.has(cell)) words.push("not saved yet");
  if (hint) {
    if (hint.text === "copy") words.push(`copied ${hint.label}`);
    else if (hint.kept) words.push(`${hint.label} kept from the frame before`);
    else words.push(`${hint.model} suggests ${hint.label} ${hint.text}`);
  }
  const said = [labels.mine[cell]];
  for (const [name, theirs] of Object.entries(labels.others)) {
    if (theirs[cell] === null) continue;
    words.push(`${name}: ${theirs[cell]}`);
    said.push(theirs[cell]);
  }
  if (labels.settled[cell] !== null) words.push(`settled: ${labels.settled[cell]}`);
  else if (disagree(said)) words.push("disagreement");
  return words.join(", ");
}
