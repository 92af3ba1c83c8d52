// The frames of a blind second labelling: those that the first annotator labelled, without how.

import { get } from "../core/api.js";
import { blind, frameIndex, onChange, onReload, setting, stateOf } from "../core/mission.js";

let list = null; // [{camera, frame}] in the mission's order
let listed = new Set(); // "camera/frame"
let ofWhom = "";
let asking = null;

/**
 * Fetch the list, if somebody labels blind after somebody else here.
 * @returns {Promise<void>}
 * @throws {ApiError}
 */
export async function loadBlindList() {
  const of = setting("blindOf");
  if (!blind() || !of || (list && ofWhom === of)) return;
  asking ??= get("/api/labelled", { of }).finally(() => (asking = null));
  const { cameras } = await asking;
  ofWhom = of;
  list = Object.entries(cameras).flatMap(([camera, frames]) =>
    frames
      .filter((frame) => frameIndex(camera, frame) >= 0)
      .map((frame) => ({ camera, frame })),
  );
  listed = new Set(list.map(({ camera, frame }) => `${camera}/${frame}`));
}

/**
 * Whether a frame is on the list, or there is none.
 * @param {string} camera
 * @param {number} frame
 * @returns {boolean}
 */
export function passesBlindList(camera, frame) {
  return blindFrames().length === 0 || listed.has(`${camera}/${frame}`);
}

/**
 * All frames to be labelled blind; empty while there is no such list.
 * @returns {{camera: string, frame: number}[]}
 */
export function blindFrames() {
  return blind() && ofWhom === setting("blindOf") ? (list ?? []) : [];
}

/**
 * The next frame to label blind that is not done, after this one and then from the beginning.
 * @param {string} [camera]
 * @param {number} [frame]
 * @returns {?{camera: string, frame: number}} Null when all are done or there is no list.
 */
export function nextBlindFrame(camera, frame) {
  const open = blindFrames().filter((one) => stateOf(one.camera, one.frame) !== "d");
  const after = open.find((one) => one.camera === camera && one.frame > frame);
  return after ?? open.find((one) => one.camera !== camera || one.frame !== frame) ?? null;
}

/**
 * Fetch the list if it can be had.
 * @returns {Promise<void>}
 */
export async function tryBlindList() {
  try {
    await loadBlindList();
  } catch (error) {
    if (error.name !== "ApiError") throw error;
    // The agreement view asks again, and says why there is no list.
  }
}

onReload(() => (list = null));
onChange((what) => {
  if (what === "all") tryBlindList();
});
tryBlindList();
