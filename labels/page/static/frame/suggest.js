// The model's suggestions in terms of the taxonomy. They are never labels until accepted.
//
// Suggestions follow the frame before, because the model alone flickers and cannot say which
// obstacle it is, or that a person was unsure. For each patch let
//   said   the model's class in the taxonomy (its own name if the taxonomy has it, else the class
//          "obstacle is" or the first that is no obstacle), value >= 0 its decision value,
//   y      what holds in the camera's frame before: my label there, else the suggestion there by
//          this same rule; unknown where that frame is more than 5 numbers away, not loaded, or
//          has neither,
//   b      the setting "follow"; 0 switches following off.
// The suggestion is `said` where y is unknown. Where the model cannot contradict y (the same class,
// or the model knows only obstacle and clear and y is of the kind it says) it is y. Else it is y
// while value < b (value <= b for y = unsure), and `said` from there on. For safety, where y goes
// back to no label of mine, only an obstacle is kept against the model: a clear class or unsure
// gives way to `said` at once where `said` is an obstacle. A chain goes back 32 frames at most and
// begins at the earliest of them that has a label of mine; where none has, the suggestion is `said`,
// as it is on the chain's first frame. `origin` is "model" where the suggestion is what the model
// says, else "kept"; a kept one carries no model version when accepted. It counts as confident
// where it goes back to a label of mine on this patch (the chain's y was mine, and was kept since),
// whatever the value; where it goes back to an earlier suggestion only, it does not, unless the
// threshold is 0: nobody said it yet, and the model now says otherwise.

import { classOf, classes, clearClass, frameIndex, frames, mission, setting } from "../core/mission.js";
import { labelsOf } from "../saving/labels.js";

const MAX_CHAIN = 32;
const NEAREST = 5;

/** The class that a binary model's "obstacle" stands for. */
export function obstacleClass() {
  const chosen = setting("obstacleAs");
  if (classOf(chosen).obstacle) return chosen;
  return classes().find((known) => known.obstacle)?.name ?? "";
}

/** Whether the model only says obstacle or clear, so that a person must say which class. */
export function needsObstacleClass() {
  const names = new Set(classes().map((known) => known.name));
  const { model } = mission;
  return Boolean(model) && model.classes.some((name, at) => model.obstacle[at] && !names.has(name));
}

function labelFor(index) {
  const name = mission.model.classes[index];
  if (classes().some((known) => known.name === name)) return name;
  return mission.model.obstacle[index] ? obstacleClass() : clearClass();
}

/**
 * The suggestion for each patch of a frame.
 * @param {string} camera
 * @param {number} frame
 * @returns {?({label: string, value: number, confident: boolean, origin: string})[]} Null where
 *   there are none (no model, blind, not computed yet, or the frame cannot be judged). `value` is
 *   the model's, also where the suggestion was kept from the frame before.
 */
export function suggestedLabels(camera, frame) {
  const own = setting("suggestions") ? modelSays(camera, frame) : null;
  if (!own) return null;
  const threshold = setting("confidence");
  const before = setting("follow") > 0 ? heldBefore(camera, frame) : null;
  return own.map((says, cell) => {
    const { label, mine } = followed(says, before?.[cell]);
    const origin = label === says.label ? "model" : "kept";
    const confident = origin === "kept" ? mine || threshold === 0 : says.value >= threshold;
    return { label, value: says.value, confident, origin };
  });
}

// What the model alone says: {label, value, named} a patch; `named`: by a class of the taxonomy.
function modelSays(camera, frame) {
  const { model } = mission;
  const suggestions = model && labelsOf(camera, frame)?.suggestions;
  // The server may have been started anew with another model, which has other classes.
  if (!suggestions?.classes || suggestions.model !== model.label) return null;
  const known = new Set(classes().map(({ name }) => name));
  const words = model.classes.map((name, index) => ({
    label: labelFor(index),
    named: known.has(name),
  }));
  return suggestions.classes.map((index, cell) => ({
    ...words[index],
    value: suggestions.values[cell],
  }));
}

// `y` and the result: {label, mine}; `mine`: it goes back to what a person said.
function followed(says, y) {
  return !y || contradicts(says, y) ? { label: says.label, mine: false } : y;
}

function contradicts({ label, named, value }, { label: y, mine }) {
  if (!mine && classOf(label).obstacle && !classOf(y).obstacle) return true;
  if (y === "unsure") return value > setting("follow");
  const agrees = label === y || (!named && classOf(y).obstacle === classOf(label).obstacle);
  return !agrees && value >= setting("follow");
}

/**
 * The frames before one that its suggestions depend on, latest first.
 * @param {string} camera
 * @param {number} frame
 * @returns {number[]}
 */
export function framesFollowed(camera, frame) {
  if (!mission.model || !setting("follow")) return [];
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

// What holds on the frame before: labels of mine, else what is suggested there by the same rule.
function heldBefore(camera, frame) {
  const chain = [];
  for (const earlier of framesFollowed(camera, frame)) {
    const labels = labelsOf(camera, earlier);
    if (!labels) break;
    chain.unshift({ mine: labels.mine, own: modelSays(camera, earlier) });
  }
  let held = null;
  const first = chain.findIndex(({ mine }) => mine.some((label) => label !== null));
  for (const { mine, own } of first < 0 ? [] : chain.slice(first)) {
    const before = held;
    held = mine.map((label, cell) => {
      if (label !== null) return { label, mine: true };
      return own ? followed(own[cell], before?.[cell]) : null;
    });
  }
  return held;
}

/**
 * Why a frame has no suggestions; "" where it has or nothing is amiss.
 * @param {string} camera
 * @param {number} frame
 */
export function suggestionFault(camera, frame) {
  return labelsOf(camera, frame)?.suggestions?.fault ?? "";
}
