// Which frame comes next: in order, by filter, the next unlabelled one, the model's queue.

import { get } from "../core/api.js";
import { frameIndex, frames, mission, stateOf } from "../core/mission.js";
import { passing } from "./filters.js";
/** @import { Place } from "../types.js" */

/** The frame some steps away (negative: backwards) that passes the filter; null if there is none.
 * @param {string} camera @param {number} frame @param {number} steps
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

/** The next frame in one of some states, round the end of the mission; null if there is none.
 * @param {string} camera @param {number} frame @param {string} states
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

/** The frame labelled last, else the first not done. @returns {[camera: string, frame: number]} */
export function whereStopped() {
  const last = mission.undo.undo;
  if (last && frameIndex(last.camera, last.frame) >= 0) return [last.camera, last.frame];
  const cameras = Object.keys(mission.cameras);
  /** @type {[string, number][]} */
  const all = [];
  for (const one of cameras) for (const number of frames(one)) all.push([one, number]);
  return all.find((place) => "usp".includes(stateOf(...place))) ?? all[0];
}

const QUEUE_LENGTH = 30;
/** @type {Set<string>} */
const shown = new Set();

/** The frame that the model is least sure about and that is unlike what is labelled, asked for
 * while another is shown; throws ApiError.
 * @returns {Promise<Partial<Place> & {why: string}>}
 */
export async function nextUncertain(/** @type {string} */ camera, /** @type {number} */ frame) {
  if (!mission.model) return { why: "There is no model yet: train one (Files and models)." };
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
  if (queue.why_not) return { why: queue.why_not };
  shown.clear();
  return { why: "These were all uncertain frames; the next press begins again." };
}
