// The model's suggestions in terms of the taxonomy. They are never labels until accepted.
//
// Suggestions follow the frame before, because the model alone flickers and cannot say which
// obstacle it is, or that a person was unsure. For each patch let
//   said   the model's class in the taxonomy (its own name if the taxonomy has it, else the class
//          that obstacles are in this mission or the first that is no obstacle), value >= 0 its
//          decision value,
//   y      what holds in the camera's frame before: my label there, else the suggestion there by
//          this same rule; unknown where that frame is more than 5 numbers away, not loaded, or
//          has neither,
//   b      the setting "follow"; 0 switches following off.
// The suggestion is `said` where y is unknown. Where the model cannot contradict y (the same class,
// or the model knows only obstacle and clear and y is of the kind it says) it is y. Else it is y
// while value < b (value <= b for y = unsure), and `said` from there on. For safety, where `said`
// is an obstacle, a clear class gives way to it at once, and so does unsure that goes back to no
// label of mine: only an obstacle may be missed by the model and kept. A chain goes back 32 frames
// at most and begins at the earliest of them that has a label of mine; where none has, the
// suggestion is `said`, as it is on the chain's first frame. What is kept carries no model version
// when accepted, and where it is of another kind than what the model says it is against the model:
// never confident, and shown as such.

import {
  classOf, clearClass, frameIndex, frames, inView, mission, selectedClass, setting,
} from "../core/mission.js";
import { labelsOf } from "../saving/labels.js";
/** @import { Held, Model, Says, Suggestion } from "../types.js" */

const MAX_CHAIN = 32;
const NEAREST = 5;

/** The obstacle classes of the taxonomy: those that the model learnt first, by their number. */
export function obstacleClasses() {
  const learnt = mission.model?.learnt ?? {};
  const obstacles = mission.classes.filter((known) => known.obstacle).map(({ name }) => name);
  return obstacles.sort((a, b) => (learnt[b] ?? 0) - (learnt[a] ?? 0));
}

/** The classes that somebody said a binary model's "obstacle" may be in this mission. */
export function chosenObstacles() {
  const chosen = new Set(mission.settings.obstacle_as?.split(","));
  return obstacleClasses().filter((name) => chosen.has(name));
}

/** The class that a binary model's "obstacle" stands for: of several chosen ones that which painting
 * gives now, else the one that the model learnt most.
 */
export function obstacleClass() {
  const chosen = chosenObstacles();
  if (chosen.includes(selectedClass())) return selectedClass();
  return chosen[0] ?? obstacleClasses()[0] ?? "";
}

/** Whether nobody said yet which of several classes "obstacle" stands for. */
export function asksObstacleClass() {
  if (!needsObstacleClass() || chosenObstacles().length) return false;
  const learnt = mission.model?.learnt ?? {};
  const classes = obstacleClasses();
  return classes.length > 1 && classes.filter((name) => learnt[name]).length !== 1;
}

/** Whether the model only says obstacle or clear, so that a person must say which class. */
export function needsObstacleClass() {
  const { model } = mission;
  if (!model) return false;
  return model.classes.some((_, at) => model.obstacle[at] && !isNamed(model, at));
}

/** Whether a class of the model's is one of the taxonomy, and an obstacle there as it is here. */
function isNamed(/** @type {Model} */ { classes: names, obstacle }, /** @type {number} */ index) {
  return kindOf(names[index]) === obstacle[index];
}

function labelFor(/** @type {Model} */ model, /** @type {number} */ index) {
  if (isNamed(model, index)) return model.classes[index];
  return model.obstacle[index] ? obstacleClass() : clearClass();
}

/** Which patches of a frame the model calls an obstacle, whether suggestions are shown or not; null
 * while that is not known, empty where no model judges the frame.
 */
export function modelObstacles(/** @type {string} */ camera, /** @type {number} */ frame) {
  const { model } = mission;
  if (!model || mission.blind) return [];
  const suggestions = labelsOf(camera, frame)?.suggestions;
  if (suggestions?.model !== model.label) return null;
  return suggestions.classes.map((index) => model.obstacle[index]);
}

/** For each patch, null where it is not known to be clear; null: no model, blind, not computed, or
 * not judged. @returns {?(?Suggestion)[]}
 */
export function suggestedLabels(/** @type {string} */ camera, /** @type {number} */ frame) {
  const own = setting("suggestions") ? modelSays(camera, frame) : null;
  if (!own) return null;
  const threshold = setting("confidence");
  const before = setting("follow") > 0 ? heldBefore(camera, frame) : null;
  return own.map((says, cell) => {
    const { label } = followed(says, before?.[cell]);
    if (!says.known && kindOf(label) === false) return null;
    const against = kindOf(label) !== kindOf(says.label);
    const confident = !against && says.value >= threshold;
    const percent = percentRight(says.obstacle, says.value);
    return { label, value: says.value, percent, confident, said: says.label, against };
  });
}

/** How many of a hundred patches, at least, that a model called obstacle (or clear) with such a
 * value were so, of patches that it had not learnt from; null where that was not measured.
 */
export function percentRight(/** @type {boolean} */ obstacle, /** @type {number} */ value) {
  const found = mission.model?.right.find(
    ([of, low, high]) => Boolean(of) === obstacle && value >= low && value < (high ?? Infinity),
  );
  return found?.[3] ?? null;
}

/** What the model alone says of each patch. @returns {?Says[]} */
function modelSays(/** @type {string} */ camera, /** @type {number} */ frame) {
  const { model } = mission;
  const suggestions = labelsOf(camera, frame)?.suggestions;
  // The server may have been started anew with another model, which has other classes.
  if (!model || !suggestions?.classes || suggestions.model !== model.label) return null;
  const words = model.classes.map((_, index) => ({
    label: labelFor(model, index),
    named: isNamed(model, index),
    obstacle: model.obstacle[index],
  }));
  return suggestions.classes.map((index, cell) => ({
    ...words[index],
    value: suggestions.values[cell] ?? 0,
    known: suggestions.values[cell] !== null,
  }));
}

/** @param {Says} says @param {?Held | undefined} y @returns {Held} */
function followed(says, y) {
  return !y || contradicts(says, y) ? { label: says.label, mine: false } : y;
}

/** Whether a class is an obstacle; null of one that says neither, such as unsure. */
export function kindOf(/** @type {?string} */ label) {
  return classOf(label).obstacle;
}

/** @param {Says} says @param {Held} held */
function contradicts({ label, named, value }, { label: y, mine }) {
  if (kindOf(label) && !kindOf(y) && (y !== "unsure" || !mine)) return true;
  if (y === "unsure") return value > setting("follow");
  const agrees = label === y || (!named && kindOf(y) === kindOf(label));
  return !agrees && value >= setting("follow");
}

/** The frames before one that its suggestions depend on, latest first. */
export function framesFollowed(/** @type {string} */ camera, /** @type {number} */ frame) {
  if (!mission.model || mission.single_pictures || !setting("follow")) return [];
  const list = frames(camera);
  const chain = [];
  let at = frameIndex(camera, frame);
  while (chain.length < MAX_CHAIN && at > 0 && list[at] - list[at - 1] <= NEAREST) {
    at -= 1;
    chain.push(list[at]);
    // Where all is labelled, what came before does not matter.
    if (mission.states[camera][at] === "d") break;
  }
  return chain;
}

/** Labels of mine on the frame before, else what is suggested there. */
function heldBefore(/** @type {string} */ camera, /** @type {number} */ frame) {
  const chain = [];
  for (const earlier of framesFollowed(camera, frame)) {
    const labels = labelsOf(camera, earlier);
    if (!labels) break;
    chain.unshift({ mine: labels.mine, own: modelSays(camera, earlier) });
  }
  /** @type {?(?Held)[]} */
  let held = null;
  const first = chain.findIndex(({ mine }) => mine.some((label) => label !== null));
  for (const { mine, own } of first < 0 ? [] : chain.slice(first)) {
    /** @type {?(?Held)[]} */
    const before = held;
    held = mine.map((label, cell) => {
      if (label !== null) return { label, mine: true };
      return own ? followed(own[cell], before?.[cell]) : null;
    });
  }
  return held;
}

/** Why a frame has no suggestions; "" where it has or nothing is amiss. */
export function suggestionFault(/** @type {string} */ camera, /** @type {number} */ frame) {
  return labelsOf(camera, frame)?.suggestions?.fault ?? "";
}

/** Why nothing is suggested for the patches of a frame that have no label; "" where something may
 * be, or where all have one.
 */
export function whyNoSuggestions(/** @type {string} */ camera, /** @type {number} */ frame) {
  const labels = labelsOf(camera, frame);
  const open = inView(camera, labels?.mine.keys() ?? []).filter((cell) => !labels?.mine[cell]);
  if (!labels || !open.length) return "";
  if (mission.blind) return "Blind: suggestions are hidden.";
  if (!mission.model) return "No suggestions: there is no model yet.";
  if (!setting("suggestions")) return "Suggestions are switched off (m).";
  const { suggestions } = labels;
  if (suggestions?.model !== mission.model.label) return "The model is looking at this frame.";
  if (suggestions.fault) return `No suggestions: ${suggestions.fault}`;
  if (open.some((cell) => suggestions.values[cell] !== null)) return "";
  return "No suggestions: what the model would call clear is not seen.";
}
