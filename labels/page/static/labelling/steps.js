// Which frame comes next: in order, by filter, the next unlabelled one, the model's queue, the list
// of a blind second labelling.

import { get, onFailure } from "../core/api.js";
import { signal } from "../core/dom.js";
import {
  frameIndex, frames, mission, onChange, onReload, setting, stateOf,
} from "../core/mission.js";

const CLASS = "class:";
const DEPTH = "depth:";
const NEXT = "next";
const NEXT_FRAMES = 5;
const ASK_AGAIN_MS = 300;

/** The filters by state in the words of the page; all but "all" and "open" are one state. */
const FILTERS = {
  all: "all frames",
  open: "not done",
  u: "unseen",
  s: "seen, no label",
  p: "part labelled",
  d: "done",
  x: "disagreement",
};

/** The filters to choose from: each value of the setting "filter", and its words. */
export function filterChoices() {
  const states = Object.entries(FILTERS).filter(([name]) => name !== "x" || !mission.blind);
  const next = mission.model ? [[NEXT, `${NEXT_FRAMES} that the model learns most from`]] : [];
  const byDepth = mission.depths.map(([from, to]) => [
    `${DEPTH}${from}:${to}`, `depth ${from} to ${to} m`,
  ]);
  const byClass = mission.classes.map(({ name }) => [CLASS + name, `with ${name} of mine`]);
  return [...states, ...next, ...byClass, ...byDepth];
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

/** (camera, frame) => whether the filter in force lets it through, looked up once for many. */
export function passing() {
  const name = filterName();
  if (name === "all") return () => true;
  if (!FILTERS[name]) return (camera, frame) => listed(name, camera, frame);
  const states = name === "open" ? "usp" : name;
  return (camera, frame) => states.includes(stateOf(camera, frame));
}

/** The frames of a camera that pass the filter. */
export function passingFrames(camera) {
  const pass = passing();
  return frames(camera).filter((frame) => pass(camera, frame));
}

/**
 * The frame some steps away (negative: backwards) among those that pass the filter; null if there
 * is none in that direction.
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

/** The next frame in one of some states, round the end of the mission; null if there is none. */
export function nextIn(camera, frame, states, direction = 1) {
  const list = frames(camera);
  const from = frameIndex(camera, frame);
  for (let step = 1; step <= list.length; step += 1) {
    const at = (from + direction * step + list.length * 2) % list.length;
    if (list[at] !== frame && states.includes(mission.states[camera][at])) return list[at];
  }
  return null;
}

/** Camera and frame where a person goes on: the one labelled last, else the first not done. */
export function whereStopped() {
  const last = mission.undo.undo;
  if (last && frameIndex(last.camera, last.frame) >= 0) return [last.camera, last.frame];
  const cameras = Object.keys(mission.cameras);
  const all = cameras.flatMap((one) => frames(one).map((number) => [one, number]));
  return all.find((place) => "usp".includes(stateOf(...place))) ?? all[0];
}

const QUEUE_LENGTH = 30;
const shown = new Set();

/**
 * The frame that the model is least sure about and that is unlike what is labelled, asked for
 * while a frame of a camera is shown.
 * @returns {Promise<{camera?: string, frame?: number, why: string}>} Without a frame: `why` says
 *   why there is none.
 * @throws {ApiError}
 */
export async function nextUncertain(camera, frame) {
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
  shown.clear();
  return { why: "These were all uncertain frames; the next press begins again." };
}

// ---- Frames with a label of mine of one class, of a depth, or to label next: asked of the server

let wanted = ""; // the filter
let framesListed = null; // camera -> Set of frames; null while it is not known
let asked = 0;
let timer = 0;

/**
 * Be told that the frames asked for last are known: `onClassFrames((first) => ...)` returns what
 * stops it; `first`: they were not known before.
 */
const [onClassFrames, classFramesKnown] = signal();
export { onClassFrames };

// False while that is not known.
function listed(name, camera, frame) {
  if (name !== wanted) {
    forgetList();
    wanted = name;
    askForList();
  }
  return framesListed?.[camera]?.has(frame) ?? false;
}

function forgetList() {
  clearTimeout(timer);
  asked += 1;
  wanted = "";
  framesListed = null;
}

function askFor(name) {
  if (name === NEXT) return get("/api/queue", { n: NEXT_FRAMES });
  const [, above, below] = name.split(":");
  if (name.startsWith(DEPTH)) return get("/api/frames_at", { above, below });
  return get("/api/frames_with", { class: name.slice(CLASS.length) });
}

async function askForList() {
  const mine = (asked += 1);
  // Where the server is away the page says so; it is asked again when it is back.
  const answer = await askFor(wanted).catch(onFailure());
  if (!answer || mine !== asked) return;
  const first = framesListed === null;
  framesListed = {};
  for (const { camera, frame } of answer.frames ?? []) {
    (framesListed[camera] ??= new Set()).add(frame);
  }
  for (const [camera, list] of Object.entries(answer.cameras ?? {})) {
    framesListed[camera] = new Set(list);
  }
  classFramesKnown(first);
}

// What comes next stays until all of it is done: the queue changes with every label.
function changes() {
  if (wanted !== NEXT || !framesListed) return true;
  const each = Object.entries(framesListed);
  return each.every(([camera, list]) => [...list].every((frame) => stateOf(camera, frame) === "d"));
}

onReload(forgetList);
onChange((what) => {
  if (!wanted || what === "status" || !changes()) return;
  clearTimeout(timer);
  timer = setTimeout(askForList, ASK_AGAIN_MS);
});

// ---- The frames of a blind second labelling: those that the first annotator labelled, not how

let blindList = null; // [{camera, frame}] in the mission's order
let blindListed = new Set(); // "camera/frame"
let ofWhom = "";
let asking = null;

/** Fetch the list, if somebody labels blind after somebody else here. Throws ApiError. */
export async function loadBlindList() {
  const of = setting("blindOf");
  if (!mission.blind || !of || (blindList && ofWhom === of)) return;
  asking ??= get("/api/labelled", { of }).finally(() => (asking = null));
  const { cameras } = await asking;
  ofWhom = of;
  blindList = Object.entries(cameras).flatMap(([camera, list]) =>
    list.filter((frame) => frameIndex(camera, frame) >= 0).map((frame) => ({ camera, frame })),
  );
  blindListed = new Set(blindList.map(({ camera, frame }) => `${camera}/${frame}`));
}

/** Fetch the list if it can be had; the agreement view asks again, and says why there is none. */
export function tryBlindList() {
  return loadBlindList().catch(onFailure());
}

/** Whether a frame is on the list, or there is none. */
export function passesBlindList(camera, frame) {
  return blindFrames().length === 0 || blindListed.has(`${camera}/${frame}`);
}

/** All frames to be labelled blind, as {camera, frame}; empty while there is no such list. */
export function blindFrames() {
  return mission.blind && ofWhom === setting("blindOf") ? (blindList ?? []) : [];
}

/**
 * The next {camera, frame} to label blind that is not done, after this one, if one is named, and
 * then from the beginning; null when all are done or there is no list.
 */
export function nextBlindFrame(camera, frame) {
  const open = blindFrames().filter((one) => stateOf(one.camera, one.frame) !== "d");
  const after = open.find((one) => one.camera === camera && one.frame > frame);
  return after ?? open.find((one) => one.camera !== camera || one.frame !== frame) ?? null;
}

onReload(() => (blindList = null));
onChange((what) => {
  if (what === "all") tryBlindList();
});
tryBlindList();
