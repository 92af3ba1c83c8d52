// What a person does to the labels of one frame, as actions; and the proposals for it that nobody
// confirmed: copies of the frame before, which the browser keeps, and suggestions.

import { say } from "../core/dom.js";
import { clearClass, mission, who } from "../core/mission.js";
import { read, remove, write } from "../core/settings.js";
import { labelsChanged, labelsOf } from "../saving/labels.js";
import { act, changesOf } from "../saving/saver.js";
import { suggestedLabels } from "./suggest.js";

const PREFIX = "tokt.copy/";
const COPY = { text: "copy", strong: true, kept: true, model: null };

/**
 * Put a label on patches.
 * @param {string} camera
 * @param {number} frame
 * @param {number[]} cells
 * @param {?string} label Null takes my labels back.
 * @param {string} [kind]
 */
export function paint(camera, frame, cells, label, kind = "paint") {
  const key = act(label === null ? "erase" : kind, [{ camera, frame, label, cells }]);
  if (key && label !== null) forgetCopies(camera, frame, cells);
  return key;
}

/** Label all patches of a frame that have no label of mine with the class that is no obstacle. */
export function paintRest(camera, frame) {
  const { mine } = labelsOf(camera, frame);
  const cells = mine.map((_, cell) => cell).filter((cell) => mine[cell] === null);
  if (!cells.length) say("Every patch of this frame has a label already.");
  else if (paint(camera, frame, cells, clearClass(), "rest")) {
    say(`The rest (${cells.length}) is ${clearClass()}.`);
  }
}

/**
 * Accept proposals.
 * @param {string} camera
 * @param {number} frame
 * @param {{cells?: number[], all?: boolean}} [options] `cells`: these only; `all`: also those
 *   below the threshold.
 * @returns {number} How many patches have a label now.
 */
export function accept(camera, frame, { cells, all = false } = {}) {
  const hints = hintsOf(camera, frame);
  const chosen = cells ?? hints.map((_, cell) => cell).filter((cell) => hints[cell]);
  const taken = chosen.filter((cell) => hints[cell] && (all || cells || hints[cell].strong));
  const patches = taken.map((cell) => ({ camera, frame, cell, base: null, ...hints[cell] }));
  const kind = patches.some(({ model }) => model) ? "accept" : "copy";
  if (!act(kind, changesOf(patches))) return 0;
  forgetCopies(camera, frame, taken);
  return taken.length;
}

/**
 * Propose the labels of another frame for the patches that have none.
 * @param {string} camera
 * @param {number} from
 * @param {number} frame
 */
export function copyFrom(camera, from, frame) {
  const before = labelsOf(camera, from);
  if (!before) {
    say(`Frame ${from} is not loaded yet.`, { bad: true });
    return;
  }
  const { mine } = labelsOf(camera, frame);
  const copies = before.mine.map((label, cell) => (mine[cell] === null ? label : null));
  const count = copies.filter((label) => label !== null).length;
  if (!count) {
    say(
      before.mine.every((label) => label === null)
        ? `You have no labels on frame ${from}.`
        : "Every patch with a label there has one here already.",
    );
    return;
  }
  if (!setCopies(camera, frame, copies)) {
    say("Not copied: this browser's storage is full or switched off.", { bad: true });
    return;
  }
  labelsChanged(camera, frame);
  say(`${count} labels of frame ${from} copied: Enter accepts, Escape drops them.`);
}

/**
 * Drop the copies that were not accepted.
 * @returns {boolean} Whether there were any.
 */
export function dropAllCopies(camera, frame) {
  const copies = copiesOf(camera, frame);
  if (!copies.some(Boolean)) return false;
  setCopies(camera, frame, copies.map(() => null));
  labelsChanged(camera, frame);
  say("Copies dropped.");
  return true;
}

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
function copiesOf(camera, frame) {
  return read(nameOf(camera, frame)) ?? [];
}

// Returns whether the browser keeps them.
function setCopies(camera, frame, labels) {
  const name = nameOf(camera, frame);
  if (labels.some((label) => label !== null)) return write(name, labels);
  remove(name);
  return true;
}

// They have a label now.
function forgetCopies(camera, frame, cells) {
  const labels = copiesOf(camera, frame);
  if (cells.some((cell) => labels[cell])) {
    for (const cell of cells) labels[cell] = null;
    setCopies(camera, frame, labels);
  }
  labelsChanged(camera, frame);
}
