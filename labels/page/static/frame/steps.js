// Which frame comes next: in order, by filter, the next unlabelled one, the model's queue.

import { get } from "../core/api.js";
import { hasClass } from "../overview/class_frames.js";
import { blind, classes, frameIndex, frames, mission, setting, stateOf } from "../core/mission.js";

const CLASS = "class:";

/** What frames a filter lets through; the words are what the page shows. */
const FILTERS = {
  all: { words: "all frames", states: "uspdx" },
  open: { words: "not done", states: "usp" },
  u: { words: "unseen", states: "u" },
  s: { words: "seen, no label", states: "s" },
  p: { words: "part labelled", states: "p" },
  d: { words: "done", states: "d" },
  x: { words: "disagreement", states: "x" },
};

/**
 * The filters to choose from.
 * @returns {[string, string][]} Value of the setting "filter", and its words.
 */
export function filterChoices() {
  const states = Object.entries(FILTERS)
    .filter(([name]) => name !== "x" || !blind())
    .map(([name, { words }]) => [name, words]);
  const byClass = classes().map(({ name }) => [CLASS + name, `with ${name} of mine`]);
  return [...states, ...byClass];
}

/** The value of the filter in force: one of `filterChoices`. */
export function filterName() {
  const chosen = setting("filter");
  return filterChoices().some(([name]) => name === chosen) ? chosen : "all";
}

/** The filter in force in words. */
export function filterWords() {
  const chosen = filterName();
  return filterChoices().find(([name]) => name === chosen)[1];
}

/**
 * What the filter in force lets through, looked up once for many frames.
 * @returns {(camera: string, frame: number) => boolean}
 */
export function passing() {
  const name = filterName();
  if (name === "all") return () => true;
  if (name.startsWith(CLASS)) {
    const wanted = name.slice(CLASS.length);
    return (camera, frame) => hasClass(wanted, camera, frame);
  }
  const { states } = FILTERS[name];
  return (camera, frame) => states.includes(stateOf(camera, frame));
}

/** How many frames of a camera pass the filter. */
export function countPassing(camera) {
  const pass = passing();
  return frames(camera).filter((frame) => pass(camera, frame)).length;
}

/**
 * The frame some steps away among those that pass the filter.
 * @param {string} camera
 * @param {number} frame
 * @param {number} steps Negative: backwards.
 * @returns {?number} Null if there is none in that direction.
 */
export function stepFrom(camera, frame, steps) {
  const list = frames(camera);
  const pass = passing();
  const direction = Math.sign(steps);
  let left = Math.abs(steps);
  let found = null;
  for (let at = frameIndex(camera, frame) + direction; left && at in list; at += direction) {
    if (!pass(camera, list[at])) continue;
    found = list[at];
    left -= 1;
  }
  return found;
}

/**
 * The next frame in one of some states, round the end of the mission.
 * @param {string} camera
 * @param {number} frame
 * @param {string} states
 * @param {number} [direction]
 * @returns {?number}
 */
export function nextIn(camera, frame, states, direction = 1) {
  const list = frames(camera);
  const from = frameIndex(camera, frame);
  for (let step = 1; step <= list.length; step += 1) {
    const at = (from + direction * step + list.length * 2) % list.length;
    if (list[at] !== frame && states.includes(mission.states[camera][at])) return list[at];
  }
  return null;
}

/** The first or last frame that passes the filter. */
export function endFrame(camera, last) {
  const pass = passing();
  const list = frames(camera).filter((frame) => pass(camera, frame));
  return (last ? list.at(-1) : list[0]) ?? null;
}

const QUEUE_LENGTH = 30;
const shown = new Set();

/**
 * The frame that the model is least sure about and that is unlike what is labelled.
 * @param {string} camera Of the frame that is shown.
 * @param {number} frame
 * @returns {Promise<{camera?: string, frame?: number, why: string}>} Without a frame: `why` says
 *   why there is none.
 * @throws {ApiError}
 */
export async function nextUncertain(camera, frame) {
  if (!mission.model) return { why: "There is no model: start tokt label with --model." };
  const queue = await get("/api/queue", { n: QUEUE_LENGTH, camera, frame });
  if (!queue.ready) {
    const progress = queue.total ? ` (${queue.done} of ${queue.total} frames)` : "";
    return { why: queue.why_not || `The model is still looking through the mission${progress}.` };
  }
  shown.add(`${camera}/${frame}`);
  const fresh = queue.frames.filter((entry) => !shown.has(`${entry.camera}/${entry.frame}`));
  const next = fresh.find((entry) => entry.camera === camera) ?? fresh[0];
  if (next) {
    shown.add(`${next.camera}/${next.frame}`);
    return next;
  }
  shown.clear();
  return { why: "That was the whole queue; the next press begins it again." };
}
