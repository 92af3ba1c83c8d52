// The frames of a blind second labelling: those that the first annotator labelled, not how.

import { get, onFailure } from "../core/api.js";
import { frameIndex, mission, onChange, onReload, setting, stateOf } from "../core/mission.js";
/** @import { BlindList } from "../types.js" */

/** @type {BlindList} */
const list = { frames: null, names: new Set(), of: "", asking: null };

/** Fetch the list, if somebody labels blind after somebody else here. Throws ApiError. */
export async function loadBlindList() {
  const of = setting("blindOf");
  if (!mission.blind || !of || (list.frames && list.of === of)) return;
  list.asking ??= get("/api/labelled", { of }).finally(() => (list.asking = null));
  const { cameras } = await list.asking;
  list.of = of;
  list.frames = Object.entries(cameras).flatMap(([camera, all]) =>
    all.filter((frame) => frameIndex(camera, frame) >= 0).map((frame) => ({ camera, frame })),
  );
  list.names = new Set(list.frames.map(({ camera, frame }) => `${camera}/${frame}`));
}

/** Fetch the list if it can be had; the agreement view asks again, and says why there is none. */
export function tryBlindList() {
  return loadBlindList().catch(onFailure());
}

/** Whether a frame is on the list, or there is none. */
export function passesBlindList(/** @type {string} */ camera, /** @type {number} */ frame) {
  return blindFrames().length === 0 || list.names.has(`${camera}/${frame}`);
}

/** All frames to be labelled blind, as {camera, frame}; empty while there is no such list. */
export function blindFrames() {
  return mission.blind && list.of === setting("blindOf") ? (list.frames ?? []) : [];
}

/** The next frame to label blind, after this one and round the list's end; null: all are done. */
export function nextBlindFrame(camera = "", frame = -1) {
  const open = blindFrames().filter((one) => stateOf(one.camera, one.frame) !== "d");
  const after = open.find((one) => one.camera === camera && frameIndex(camera, one.frame) > frameIndex(camera, frame));
  return after ?? open.find((one) => one.camera !== camera || one.frame !== frame) ?? null;
}

onReload(() => (list.frames = null));
onChange((what) => {
  if (what === "all") tryBlindList();
});
tryBlindList();
