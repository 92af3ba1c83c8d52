// The filter: which frames a person steps to, by state, class or depth, or what the model learns
// most from.

import { get, onFailure } from "../core/api.js";
import { choice } from "../core/controls.js";
import { backAfterMouse, signal } from "../core/dom.js";
import {
  frames, mission, onChange, onReload, setSetting, setting, stateOf,
} from "../core/mission.js";
/** @import { ByCamera, Passes, QueueEntry, Signal, Words } from "../types.js" */

const CLASS = "class:";
const DEPTH = "depth:";
const NEXT = "next";
const NEXT_FRAMES = 5;
const ASK_AGAIN_MS = 300;

/** By state, in the words of the page; all but "all" and "open" are one state. @type {Words} */
const FILTERS = {
  all: "all frames",
  open: "not done",
  u: "unseen",
  s: "seen, no label",
  p: "part labelled",
  d: "done",
  x: "disagreement",
};

/** The values of the setting "filter". @returns {[value: string, words: string][]} */
export function filterChoices() {
  const states = Object.entries(FILTERS).filter(([name]) => name !== "x" || !mission.blind);
  /** @type {[string, string][]} */
  const next = mission.model ? [[NEXT, `${NEXT_FRAMES} that the model learns most from`]] : [];
  for (const { name } of mission.classes) next.push([CLASS + name, `with ${name} of mine`]);
  for (const [from, to] of mission.depths) {
    next.push([`${DEPTH}${from}:${to}`, `depth ${from} to ${to} m`]);
  }
  return [...states, ...next];
}

/** The value of the filter in force: one of `filterChoices`. */
export function filterName() {
  const chosen = setting("filter");
  return filterChoices().some(([name]) => name === chosen) ? chosen : "all";
}

export function filterWords() {
  const chosen = filterName();
  return filterChoices().find(([name]) => name === chosen)?.[1] ?? "";
}

/** Whether the filter in force lets a frame through, looked up once for many. @returns {Passes} */
export function passing() {
  const name = filterName();
  if (name === "all") return () => true;
  if (!FILTERS[name]) return (camera, frame) => listed(name, camera, frame);
  const states = name === "open" ? "usp" : name;
  return (camera, frame) => states.includes(stateOf(camera, frame));
}

export function passingFrames(/** @type {string} */ camera) {
  const pass = passing();
  return frames(camera).filter((frame) => pass(camera, frame));
}

export function filterSelect(/** @type {string} */ words, /** @type {string} */ title) {
  const options = { class: "filter", "aria-label": words, title };
  const select = choice(filterChoices(), filterName(), options);
  select.addEventListener("change", () => setSetting("filter", select.value));
  return backAfterMouse(select);
}

// ---- Frames with a label of mine of one class, of a depth, or to label next: asked of the server

/** @type {{filter: string, frames: ?Record<string, Set<number>>, asked: number, timer: number}} */
const list = { filter: "", frames: null, asked: 0, timer: 0 }; // `frames` null: not known yet

/** Be told that the frames asked for are known. @type {Signal<[first: boolean]>} */
export const [onClassFrames, classFramesKnown] = signal();

// False while that is not known.
/** @param {string} name @param {string} camera @param {number} frame */
function listed(name, camera, frame) {
  if (name !== list.filter) {
    forgetList();
    list.filter = name;
    askForList();
  }
  return list.frames?.[camera]?.has(frame) ?? false;
}

function forgetList() {
  clearTimeout(list.timer);
  list.asked += 1;
  list.filter = "";
  list.frames = null;
}

/** @param {string} name @returns {Promise<{frames?: QueueEntry[], cameras?: ByCamera}>} */
function askFor(name) {
  if (name === NEXT) return get("/api/queue", { n: NEXT_FRAMES });
  const [, above, below] = name.split(":");
  if (name.startsWith(DEPTH)) return get("/api/frames_at", { above, below });
  return get("/api/frames_with", { class: name.slice(CLASS.length) });
}

async function askForList() {
  const mine = (list.asked += 1);
  // Where the server is away the page says so; it is asked again when it is back.
  const answer = await askFor(list.filter).catch(onFailure());
  if (!answer || mine !== list.asked) return;
  const first = list.frames === null;
  list.frames = {};
  for (const { camera, frame } of answer.frames ?? []) {
    (list.frames[camera] ??= new Set()).add(frame);
  }
  for (const [camera, some] of Object.entries(answer.cameras ?? {})) {
    list.frames[camera] = new Set(some);
  }
  classFramesKnown(first);
}

// What comes next stays until all of it is done: the queue changes with every label.
function changes() {
  if (list.filter !== NEXT || !list.frames) return true;
  const each = Object.entries(list.frames);
  return each.every(([camera, some]) => [...some].every((frame) => stateOf(camera, frame) === "d"));
}

onReload(forgetList);
onChange((what) => {
  if (!list.filter || what === "status" || !changes()) return;
  clearTimeout(list.timer);
  list.timer = setTimeout(askForList, ASK_AGAIN_MS);
});
