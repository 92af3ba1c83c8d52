// What a person does to the labels of one frame, as actions.

import { say } from "../core/dom.js";
import { labelsChanged, labelsOf } from "../saving/labels.js";
import { clearClass } from "../core/mission.js";
import { act } from "../saving/saver.js";
import {
  acceptingChanges,
  copiesOf,
  dropCopiesOf,
  hintsOf,
  setCopies,
} from "../saving/unconfirmed.js";

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

function forgetCopies(camera, frame, cells) {
  dropCopiesOf(camera, frame, cells);
  labelsChanged(camera, frame);
}

/** Label all patches of a frame that have no label of mine with the class that is no obstacle. */
export function paintRest(camera, frame) {
  const cells = unlabelled(camera, frame);
  if (!cells.length) say("Every patch of this frame has a label already.");
  else if (paint(camera, frame, cells, clearClass(), "rest")) {
    say(`The rest (${cells.length}) is ${clearClass()}.`);
  }
}

/** The cells of a frame without a label of mine. */
export function unlabelled(camera, frame) {
  const { mine } = labelsOf(camera, frame);
  return mine.map((_, cell) => cell).filter((cell) => mine[cell] === null);
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
  const changes = acceptingChanges(camera, frame, taken);
  if (!changes.length) return 0;
  const kind = changes.some(({ model }) => model) ? "accept" : "copy";
  if (!act(kind, changes)) return 0;
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
