// The shape of a mission's frames, learnt from the first picture that was seen.

import { address } from "./api.js";
import { frames, mission, setting } from "./mission.js";
import { patchSize } from "../frame/patch_grid.js";

const USUAL = 0.75;
const known = new Map();

/**
 * Height of a camera's frames over their width.
 * @param {string} camera
 * @returns {number}
 */
export function frameAspect(camera) {
  return known.get(camera) ?? USUAL;
}

/**
 * Height of a camera's patches over their width.
 * @param {string} camera
 * @returns {number}
 */
export function patchAspect(camera) {
  const { width, height } = patchSize(1000, 1000 * frameAspect(camera));
  return height / width;
}

/**
 * Learn the shape from a picture that was loaded.
 * @param {string} camera
 * @param {HTMLImageElement} image
 * @returns {boolean} Whether it differs from what was believed.
 */
export function learnShape(camera, image) {
  const before = frameAspect(camera);
  known.set(camera, image.naturalHeight / image.naturalWidth);
  return Math.abs(frameAspect(camera) - before) > 0.01;
}

/**
 * Address of a small picture of a frame, enhanced as the person set it.
 * @param {string} camera
 * @param {number} frame
 * @param {number} width In CSS pixels; asked for in steps, so that pictures are found again.
 * @returns {string}
 */
export function thumbAddress(camera, frame, width) {
  const pixels = Math.ceil((width * Math.min(2, window.devicePixelRatio || 1)) / 40) * 40;
  const params = { width: pixels, enhance: setting("enhance"), v: mission.pictures };
  return address(`/api/thumb/${camera}/${frame}`, { ...params, who: null, blind: null });
}

/**
 * Look at the first frames' shape of each camera that is not known yet.
 * @returns {Promise<void>} Done when looked at, readable or not.
 */
export async function lookAtShapes() {
  const cameras = Object.keys(mission.cameras).filter((camera) => !known.has(camera));
  await Promise.all(cameras.map(lookAt));
}

async function lookAt(camera) {
  const image = new Image();
  image.src = thumbAddress(camera, frames(camera)[0], 240);
  try {
    await image.decode();
  } catch {
    return; // Unreadable: the usual shape will do.
  }
  learnShape(camera, image);
}
