// What is proposed for a frame but said by nobody: copies of the frame before, suggestions.

import { copiesOf } from "./copies.js";
import { labelsOf } from "./labels.js";
import { mission } from "./mission.js";
import { suggestedLabels } from "./suggest.js";

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
