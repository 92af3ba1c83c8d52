// Proposals for a frame that nobody confirmed: copies of the frame before, which the browser keeps,
// and suggestions.

import { labelsOf } from "./labels.js";
import { mission, who } from "../core/mission.js";
import { read, remove, write } from "../core/storage.js";
import { suggestedLabels } from "../frame/suggest.js";

const PREFIX = "tokt.copy/";
const COPY = { text: "copy", strong: true, kept: true, model: null };

/**
 * The proposals for the patches of a frame without a label of mine; a copy goes before a
 * suggestion.
 * @param {string} camera
 * @param {number} frame
 * @returns {(?{label: string, text: string, strong: boolean, kept: boolean,
 *   model: ?string})[]} `strong`: taken by "accept the confident ones"; `kept`: from the frame
 *   before, not what the model says; `model`: the version to record.
 */
export function hintsOf(camera, frame) {
  const labels = labelsOf(camera, frame);
  if (!labels) return [];
  const copies = copiesOf(camera, frame);
  const suggestions = suggestedLabels(camera, frame);
  return labels.mine.map((label, cell) => {
    if (label !== null) return null;
    if (copies[cell]) return { ...COPY, label: copies[cell] };
    if (!suggestions?.[cell]) return null;
    const { label: suggested, value, confident, origin } = suggestions[cell];
    const kept = origin === "kept";
    const text = kept ? "→" : value.toFixed(2);
    const model = kept ? null : mission.model.label;
    return { label: suggested, text, strong: confident, kept, model };
  });
}

/**
 * The changes that accept proposals.
 * @param {string} camera
 * @param {number} frame
 * @param {number[]} cells
 * @returns {Object[]} As `act` takes them.
 */
export function acceptingChanges(camera, frame, cells) {
  const hints = hintsOf(camera, frame);
  const groups = new Map();
  for (const cell of cells) {
    const hint = hints[cell];
    if (!hint) continue;
    const { label, model } = hint;
    const name = `${label}/${model}`;
    const group = groups.get(name) ?? { camera, frame, label, model, cells: [] };
    group.cells.push(cell);
    groups.set(name, group);
  }
  return [...groups.values()];
}

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
