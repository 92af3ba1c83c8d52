// Pictures of frames: decoded ones, near ones fetched ahead, so that the next frame is there at
// once; and small ones, from which the shape of a mission's frames is learnt.

import { ApiError, address, fetchOk } from "./api.js";
import { frames, mission, setting } from "./mission.js";
import { patchSize } from "./patch_grid.js";
/** @import { OfPicture, PictureJob, PictureName, PictureStore } from "./types.js" */

const KEPT = 14;
const SIDE_BY_SIDE = 3;

/** @type {PictureStore} */
const fetched = { jobs: new Map(), waits: [], running: 0 };

/** `v` keeps missions on the same port apart in caches. @type {OfPicture<string>} */
function pictureAddress(camera, frame, enhance) {
  return `/api/picture/${camera}/${frame}?enhance=${enhance}&v=${mission.pictures ?? ""}`;
}

/** A picture that is decoded already, or null. @type {OfPicture<?ImageBitmap>} */
export function pictureNow(camera, frame, enhance) {
  return fetched.jobs.get(pictureAddress(camera, frame, enhance))?.bitmap ?? null;
}

/** Throws ApiError, also for an unreadable frame (422). @type {OfPicture<Promise<ImageBitmap>>} */
export function picture(camera, frame, enhance) {
  const job = jobFor(pictureAddress(camera, frame, enhance));
  if (!job.started) run(job);
  return job.promise;
}

/** Fetch what will be wanted soon, nearest first, and give up on all others that are not `kept`.
 * @param {PictureName[]} list @param {PictureName[]} kept
 */
export function prefetchPictures(list, kept) {
  const addressOf = (/** @type {PictureName} */ { camera, frame, enhance }) =>
    pictureAddress(camera, frame, enhance);
  const wanted = new Set([...kept, ...list].map(addressOf));
  for (const [url, job] of fetched.jobs) {
    if (!job.bitmap && !job.error && !wanted.has(url)) {
      job.controller.abort();
      fetched.jobs.delete(url);
    }
  }
  fetched.waits = list.map((one) => jobFor(addressOf(one))).filter((job) => !job.started);
  next();
  forgetOld(wanted);
}

/** Forget pictures that could not be had: the server is back, or the file may be mended. */
export function forgetFailed() {
  for (const [url, job] of fetched.jobs) if (job.error) fetched.jobs.delete(url);
}

function jobFor(/** @type {string} */ url) {
  const job = fetched.jobs.get(url) ?? newJob(url);
  fetched.jobs.delete(url);
  fetched.jobs.set(url, job);
  return job;
}

/** @param {string} url @returns {PictureJob} */
function newJob(url) {
  const resolvers = Promise.withResolvers();
  // Nobody may be waiting for a prefetched one; who shows it gets the error from `promise`.
  resolvers.promise.catch(() => {});
  const controller = new AbortController();
  return { url, bitmap: null, error: null, controller, started: false, ...resolvers };
}

function next() {
  while (fetched.running < SIDE_BY_SIDE && fetched.waits.length) run(fetched.waits[0]);
}

async function run(/** @type {PictureJob} */ job) {
  fetched.waits = fetched.waits.filter((other) => other !== job);
  job.started = true;
  fetched.running += 1;
  try {
    const response = await fetchOk(job.url, { signal: job.controller.signal });
    job.bitmap = await createImageBitmap(await response.blob());
    job.resolve(job.bitmap);
  } catch (error) {
    job.error = error;
    const passing = !(error instanceof ApiError) || error.status === 0;
    if (passing && fetched.jobs.get(job.url) === job) fetched.jobs.delete(job.url);
    job.reject(error);
  } finally {
    fetched.running -= 1;
    next();
  }
}

function forgetOld(/** @type {Set<string>} */ wanted) {
  for (const [url, job] of fetched.jobs) {
    if (fetched.jobs.size <= KEPT) return;
    if (wanted.has(url)) continue;
    job.bitmap?.close();
    fetched.jobs.delete(url);
  }
}

const USUAL_ASPECT = 0.75;
/** @type {Map<string, number>} By camera. */
const aspects = new Map();

/** Height of a camera's frames over their width. */
export function frameAspect(/** @type {string} */ camera) {
  return aspects.get(camera) ?? USUAL_ASPECT;
}

/** Height of a camera's patches over their width. */
export function patchAspect(/** @type {string} */ camera) {
  const { width, height } = patchSize(1000, 1000 * frameAspect(camera));
  return height / width;
}

/** Learn the shape from a picture that was loaded; whether it differs from what was believed. */
export function learnShape(/** @type {string} */ camera, /** @type {HTMLImageElement} */ image) {
  const before = frameAspect(camera);
  aspects.set(camera, image.naturalHeight / image.naturalWidth);
  return Math.abs(frameAspect(camera) - before) > 0.01;
}

/** A small picture, enhanced as the person set it; widths in steps, so that it is found again.
 * @param {string} camera @param {number} frame @param {number} width In CSS pixels.
 */
export function thumbAddress(camera, frame, width) {
  const pixels = Math.ceil((width * Math.min(2, window.devicePixelRatio || 1)) / 40) * 40;
  const params = { width: pixels, enhance: setting("enhance"), v: mission.pictures };
  return address(`/api/thumb/${camera}/${frame}`, { ...params, who: null });
}

/** Look at the first frames' shape of each camera that is not known yet, readable or not. */
export async function lookAtShapes() {
  const cameras = Object.keys(mission.cameras).filter((camera) => !aspects.has(camera));
  await Promise.all(cameras.map(lookAt));
}

async function lookAt(/** @type {string} */ camera) {
  const image = new Image();
  image.src = thumbAddress(camera, frames(camera)[0], 240);
  try {
    await image.decode();
  } catch {
    return; // Unreadable: the usual shape will do.
  }
  learnShape(camera, image);
}
