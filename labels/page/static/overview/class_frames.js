// Which frames have a label of mine of one class: asked of the server, for the filter.

import { get } from "../core/api.js";
import { onChange, onReload } from "../core/mission.js";

const ASK_AGAIN_MS = 300;

let wanted = ""; // the class
let found = null; // camera -> Set of frames; null while it is not known
let asked = 0;
let timer = 0;
const listeners = new Set();

/**
 * Be told that frames of the class asked for last are known.
 * @param {(first: boolean) => void} listener `first`: they were not known before.
 * @returns {Function} Stops it.
 */
export function onClassFrames(listener) {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

/**
 * Whether a frame has a label of mine of this class; false while that is not known.
 * @param {string} name
 * @param {string} camera
 * @param {number} frame
 * @returns {boolean}
 */
export function hasClass(name, camera, frame) {
  if (name !== wanted) {
    forget();
    wanted = name;
    ask();
  }
  return found?.[camera]?.has(frame) ?? false;
}

function forget() {
  clearTimeout(timer);
  asked += 1;
  wanted = "";
  found = null;
}

async function ask() {
  const mine = (asked += 1);
  let cameras;
  try {
    ({ cameras } = await get("/api/frames_with", { class: wanted }));
  } catch (error) {
    if (error.name !== "ApiError") throw error;
    return; // The page says that the server is away; it is asked again when it is back.
  }
  if (mine !== asked) return;
  const first = found === null;
  found = Object.fromEntries(
    Object.entries(cameras).map(([camera, frames]) => [camera, new Set(frames)]),
  );
  for (const listener of [...listeners]) listener(first);
}

onReload(forget);
onChange((what) => {
  if (!wanted || (what !== "states" && what !== "all")) return;
  clearTimeout(timer);
  timer = setTimeout(ask, ASK_AGAIN_MS);
});
