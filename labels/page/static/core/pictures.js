// Decoded pictures of frames, near ones fetched ahead, so that the next frame is there at once.

import { fetchOk } from "./api.js";
import { mission } from "./mission.js";

const KEPT = 14;
const SIDE_BY_SIDE = 3;

// address -> {promise, bitmap, error, controller, started}
const pictures = new Map();
let waits = [];
let running = 0;

// `v` keeps missions on the same port apart in caches.
function pictureAddress(camera, frame, enhance) {
  return `/api/picture/${camera}/${frame}?enhance=${enhance}&v=${mission.pictures ?? ""}`;
}

/**
 * A picture that is decoded already.
 * @returns {?ImageBitmap}
 */
export function pictureNow(camera, frame, enhance) {
  return pictures.get(pictureAddress(camera, frame, enhance))?.bitmap ?? null;
}

/**
 * The picture of a frame.
 * @param {string} camera
 * @param {number} frame
 * @param {number} enhance 0..100; 0 is the frame as the camera gave it.
 * @returns {Promise<ImageBitmap>}
 * @throws {ApiError} Also for a frame that cannot be read (status 422, its sentence).
 */
export function picture(camera, frame, enhance) {
  const job = jobFor(pictureAddress(camera, frame, enhance));
  if (!job.started) {
    waits = waits.filter((other) => other !== job);
    run(job);
  }
  return job.promise;
}

/**
 * Fetch pictures that will be wanted soon, nearest first, and give up on all others that are
 * neither shown nor in the list.
 * @param {{camera: string, frame: number, enhance: number}[]} list
 * @param {{camera: string, frame: number, enhance: number}[]} kept Those to leave alone.
 */
export function prefetchPictures(list, kept) {
  const wanted = new Set(
    [...kept, ...list].map(({ camera, frame, enhance }) => pictureAddress(camera, frame, enhance)),
  );
  for (const [url, job] of pictures) {
    if (!job.bitmap && !job.error && !wanted.has(url)) {
      job.controller.abort();
      pictures.delete(url);
    }
  }
  waits = list.map(({ camera, frame, enhance }) =>
    jobFor(pictureAddress(camera, frame, enhance)),
  );
  waits = waits.filter((job) => !job.started);
  next();
  forgetOld(wanted);
}

/** Forget pictures that could not be had: the server is back, or the file may be mended. */
export function forgetFailed() {
  for (const [url, job] of pictures) if (job.error) pictures.delete(url);
}

function jobFor(url) {
  let job = pictures.get(url);
  if (job) {
    pictures.delete(url);
  } else {
    job = { url, bitmap: null, error: null, controller: new AbortController(), started: false };
    job.promise = new Promise((resolve, reject) => Object.assign(job, { resolve, reject }));
    // Nobody may be waiting for a prefetched one; who shows it gets the error from `promise`.
    job.promise.catch(() => {});
  }
  pictures.set(url, job);
  return job;
}

function next() {
  while (running < SIDE_BY_SIDE && waits.length) run(waits.shift());
}

async function run(job) {
  job.started = true;
  running += 1;
  try {
    const response = await fetchOk(job.url, { signal: job.controller.signal });
    job.bitmap = await createImageBitmap(await response.blob());
    job.resolve(job.bitmap);
  } catch (error) {
    job.error = error;
    const passing = error.status === 0 || error.name !== "ApiError";
    if (passing && pictures.get(job.url) === job) pictures.delete(job.url);
    job.reject(error);
  } finally {
    running -= 1;
    next();
  }
}

function forgetOld(wanted) {
  for (const [url, job] of pictures) {
    if (pictures.size <= KEPT) return;
    if (wanted.has(url)) continue;
    job.bitmap?.close();
    pictures.delete(url);
  }
}
