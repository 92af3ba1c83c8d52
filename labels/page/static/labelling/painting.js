// What a person does to the labels of one frame, as actions; and the proposals for it that nobody
// confirmed: copies of the frame before, which the browser keeps, and suggestions.

import { say } from "../core/dom.js";
import { clearClass, inView, maskedCells, mission, who } from "../core/mission.js";
import { read, remove, write } from "../core/settings.js";
import { labelsChanged, labelsOf } from "../saving/labels.js";
import { act, changesOf } from "../saving/saver.js";
import { askObstacleClass } from "./obstacle_class.js";
import { asksObstacleClass, kindOf, modelObstacles, suggestedLabels } from "./suggest.js";
/** @import { AcceptOptions, Hint, LabelledPatch, Place, Rest } from "../types.js" */

const PREFIX = "tokt.copy/";
const COPY = { text: "copy", percent: null, strong: true, kept: true, model: null };
/** @type {Map<string, Place & {copies: (?string)[]}>} What an accepting action took, by its key. */
const taken = new Map();

/** Put a label on patches; null takes my labels back.
 * @param {string} camera @param {number} frame @param {number[]} cells @param {?string} label
 */
export function paint(camera, frame, cells, label, kind = "paint") {
  const key = act(label === null ? "erase" : kind, [{ camera, frame, label, cells }]);
  if (key && label !== null) forgetCopies(camera, frame, cells);
  return key;
}

/** The patches of a frame without a label of mine, which one key makes clear; but not those that
 * the model calls an obstacle, or that are proposed as one: to call them clear takes a stroke of
 * their own.
 * @param {string} camera @param {number} frame @returns {Rest}
 */
export function restOf(camera, frame, hints = hintsOf(camera, frame)) {
  const mine = labelsOf(camera, frame)?.mine ?? [];
  const open = inView(camera, mine.keys()).filter((cell) => mine[cell] === null);
  const obstacles = modelObstacles(camera, frame);
  if (!obstacles) return { cells: [], left: open.length, waits: true };
  const cells = open.filter((cell) => !obstacles[cell] && !kindOf(hints[cell]?.label ?? ""));
  return { cells, left: open.length - cells.length, waits: false };
}

/** Label the rest of a frame with the class that is no obstacle. */
export function paintRest(/** @type {string} */ camera, /** @type {number} */ frame) {
  const { cells, left, waits } = restOf(camera, frame);
  const words = waits ? "What the model says is still being loaded." : leftWords(left);
  if (!cells.length) say(words || "Every patch of this frame has a label already.");
  else if (paint(camera, frame, cells, clearClass(), "rest")) {
    say(`The rest (${cells.length}) is ${clearClass()}. ${words}`);
  }
}

/** What is said of patches that a key for many left out. */
export function leftWords(/** @type {number} */ left) {
  const patches = left === 1 ? "1 patch stays" : `${left} patches stay`;
  return left ? `${patches} open: the model sees an obstacle there.` : "";
}

/** Accept proposals; how many patches have a label now, null where something is asked first.
 * @param {string} camera @param {number} frame @param {AcceptOptions} [options]
 */
export function accept(camera, frame, { cells, all = false } = {}) {
  const hints = hintsOf(camera, frame);
  const patches = (cells ?? [...hints.keys()]).flatMap((cell) => {
    const hint = hints[cell];
    if (!hint || !(all || cells || hint.strong)) return [];
    return [{ camera, frame, cell, base: null, ...hint }];
  });
  const named = withKnownClass(patches);
  if (!named) return null;
  const kind = named.some(({ model }) => model) ? "accept" : "copy";
  const key = act(kind, changesOf(named));
  if (!key) return 0;
  taken.set(key, { camera, frame, copies: copiesOf(camera, frame) });
  forgetCopies(camera, frame, named.map(({ cell }) => cell));
  return named.length;
}

/** The patches whose class is known; null where it is asked first which obstacle the model means.
 * While that is put off they are those that are no obstacles of the model alone.
 * @template {LabelledPatch} T @param {T[]} patches
 */
export function withKnownClass(patches) {
  const named = patches.filter(({ model, label }) => !(model && kindOf(label)));
  if (named.length === patches.length || !asksObstacleClass()) return patches;
  return askObstacleClass() ? null : named;
}

/** Propose the copies again that an action took which is undone now. */
export function proposeAgain(/** @type {string | undefined} */ key) {
  const { camera, frame, copies } = taken.get(key ?? "") ?? { camera: "", frame: 0, copies: [] };
  if (!copies.some(Boolean) || !setCopies(camera, frame, copies)) return;
  labelsChanged(camera, frame);
}

/** Propose labels, one a cell or null, for the patches that have none; `whose`: where they come
 * from, in words; `none`: what to say where there are none.
 * @param {string} camera @param {number} frame @param {(?string)[]} labels
 * @param {string} whose @param {string} none
 */
export function propose(camera, frame, labels, whose, none) {
  const mine = labelsOf(camera, frame)?.mine ?? [];
  const open = new Set(inView(camera, mine.keys()).filter((cell) => mine[cell] === null));
  const copies = labels.map((label, cell) => (open.has(cell) ? label : null));
  const count = copies.filter((label) => label !== null).length;
  if (!count) {
    const isNone = labels.every((label) => label === null);
    return say(isNone ? none : "Every patch with a label there has one here already.");
  }
  if (!setCopies(camera, frame, copies)) {
    return say("Not copied: this browser's storage is full or switched off.", { bad: true });
  }
  labelsChanged(camera, frame);
  const copied = hintsOf(camera, frame).filter((hint) => hint?.text === COPY.text).length;
  const words = leftWords(count - copied);
  say(`${copied} labels of ${whose} copied: Enter accepts, Escape drops them. ${words}`);
}

/** Drop the copies that were not accepted; whether there were any. */
export function dropAllCopies(/** @type {string} */ camera, /** @type {number} */ frame) {
  const copies = copiesOf(camera, frame);
  if (!copies.some(Boolean)) return false;
  setCopies(camera, frame, copies.map(() => null));
  labelsChanged(camera, frame);
  say("Copies dropped.");
  return true;
}

/** The proposals for the patches in view of a frame without a label of mine; a copy goes before a
 * suggestion, but a clear class is not copied over what the model calls an obstacle.
 * @returns {(?Hint)[]}
 */
export function hintsOf(/** @type {string} */ camera, /** @type {number} */ frame) {
  const labels = labelsOf(camera, frame);
  if (!labels) return [];
  const copies = copiesOf(camera, frame);
  const suggestions = suggestedLabels(camera, frame);
  const obstacles = modelObstacles(camera, frame);
  const masked = maskedCells(camera);
  return labels.mine.map((label, cell) => {
    if (label !== null || masked.has(cell)) return null;
    const suggestion = suggestions?.[cell];
    const said = suggestion?.said;
    const copy = copies[cell];
    if (copy && !(kindOf(copy) === false && (!obstacles || obstacles[cell]))) {
      const against = said !== undefined && kindOf(copy) !== kindOf(said);
      const unknown = kindOf(copy) === false && labels.suggestions?.values[cell] === null;
      return { ...COPY, label: copy, strong: !unknown, said, against };
    }
    if (!suggestion) return null;
    const { label: suggested, value, percent, confident, against } = suggestion;
    const kept = suggested !== said;
    const text = kept ? "→" : value.toFixed(2);
    const model = kept ? null : (mission.model?.label ?? null);
    return { label: suggested, text, percent, strong: confident, kept, model, said, against };
  });
}

function nameOf(/** @type {string} */ camera, /** @type {number} */ frame) {
  const { rows, cols } = mission.grid;
  return `${PREFIX}${mission.mission}/${rows}x${cols}/${who()}/${camera}/${frame}`;
}

/** Unconfirmed copies on a frame, one a cell; empty: there are none. @returns {(?string)[]} */
function copiesOf(/** @type {string} */ camera, /** @type {number} */ frame) {
  return read(nameOf(camera, frame)) ?? [];
}

// Whether the browser keeps them.
/** @param {string} camera @param {number} frame @param {(?string)[]} labels */
function setCopies(camera, frame, labels) {
  const name = nameOf(camera, frame);
  if (labels.some((label) => label !== null)) return write(name, labels);
  remove(name);
  return true;
}

/** They have a label now. @param {string} camera @param {number} frame @param {number[]} cells */
function forgetCopies(camera, frame, cells) {
  const labels = copiesOf(camera, frame);
  if (cells.some((cell) => labels[cell])) {
    for (const cell of cells) labels[cell] = null;
    setCopies(camera, frame, labels);
  }
  labelsChanged(camera, frame);
}
