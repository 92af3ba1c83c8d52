// Saving: each action is kept in the browser before it shows, sent in order, one at a time, and
// sent again until the server acknowledged it. The server counts an action's key once.

import { ApiError, get, onFailure, post } from "../core/api.js";
import { say, signal } from "../core/dom.js";
import {
  mission, onChange, onReload, sameMission, strangerWords, takeNews, who,
} from "../core/mission.js";
import { acknowledge, labelsChanged, labelsOf } from "./labels.js";
import {
  dequeue, enqueue, forget, framesOf, holdPage, isKept, keep, leftovers, noteConflicts,
  readConflicts, setAside, setForeign, takeBack, uniqueKey, unwritten, waiting,
} from "./outbox.js";

const RETRY_MS = [250, 500, 1000, 2000, 4000];
const LOOK_FOR_LEFTOVERS_MS = 5000;
// The server or the disk is in trouble, not the action: it stays in the queue.
const KEEP_STATUS = new Set([401, 403, 408, 421, 429, 507]);
// A server that fails this often on one action fails because of it: later ones must go on.
const MAX_FAILURES = 5;
const KEPT_RANGES = 500;
/** Kind of an action that counts also where its label holds already: somebody looked. */
export const CONFIRM = "confirm";
const HOLD_MS = 600; // longer than the second click of a double click takes

const idleWaiters = [];
let running = false;
let connected = true;
let trouble = null; // {state: "offline"|"refused", text}
let stranger = ""; // what the server shows instead of this page's mission
let tries = 0;
let retryTimer = 0;
// The store's events that this page's own actions made: what they say is known here already.
const ownEvents = [];

/** Be told when `state()` or `pending()` may have changed; returns what stops it. */
const [onState, stateChanged] = signal();
export { onState };

/**
 * @returns {"saved"|"saving"|"offline"|"refused"} "saved" only when the server acknowledged all
 *   actions of this page and can take further ones.
 */
export function state() {
  if (trouble) return trouble.state;
  if (!connected) return "offline";
  if (stranger || mission.fault) return "refused";
  return waiting().length ? "saving" : "saved";
}

/** Why the state is what it is, in one sentence; "" when all is well. */
export function stateReason() {
  if (trouble) return trouble.text;
  return connected ? stranger || mission.fault || "" : "the server does not answer";
}

/** How many actions wait for their acknowledgement. */
export function pending() {
  return waiting().length;
}

/** Wait until nothing waits any more. */
export function whenIdle() {
  if (!waiting().length) return Promise.resolve();
  return new Promise((resolve) => idleWaiters.push(resolve));
}

/**
 * Do something to labels.
 * @param {string} kind What the person did, for messages.
 * @param {{camera: string, frame: number, label: ?string, model?: string, cells: number[],
 *   base?: (?string)[]}[]} changes Labels of the frames must be loaded where `base` is missing.
 * @param {{source?: string, hold?: boolean}} [options] `hold`: not sent for a moment, for
 *   `withdraw`. The kind "confirm" also says what holds already.
 * @returns {?string} The action's key; null if it would change nothing or could not be kept.
 */
export function act(kind, changes, { source = "human", hold = false } = {}) {
  const based = changes.map((change) => withBase(change, source, kind === CONFIRM));
  const filled = based.filter(({ cells }) => cells.length);
  if (!filled.length) return null;
  const entry = newEntry({ path: "/api/actions", kind, source, changes: filled });
  if (hold) {
    held.add(entry.key);
    setTimeout(release, HOLD_MS, entry.key);
  } else held.clear();
  if (!take(entry)) return null;
  const [{ camera, frame }] = filled;
  const changed = filled.reduce((sum, change) => sum + change.cells.length, 0);
  const { length } = framesOf(entry);
  undoable.push({ key: entry.key, kind, camera, frame, changed, frames: length });
  redoable = [];
  known.set(entry.key, { changes: filled, source });
  return entry.key;
}

const held = new Set(); // keys of actions that may still be withdrawn

function release(key) {
  if (held.delete(key)) pump();
}

/** Take an action back that was meant otherwise: as if it had never been, if not sent yet. */
export function withdraw(key) {
  const entry = waiting().find((one) => one.key === key);
  if (!entry || !held.delete(key)) {
    if (undoable.at(-1)?.key === key) undo();
    return;
  }
  forget(entry);
  dequeue(entry);
  undoable = undoable.filter((head) => head.key !== key);
  showFrames(entry);
  pump();
  refreshHeads(); // what could be done again still can
}

/** "23 patches are", "1 patch is" */
export function patchesAre(count) {
  return count === 1 ? "1 patch is" : `${count.toLocaleString("en")} patches are`;
}

/**
 * @typedef {{camera: string, frame: number, cell: number, label: ?string, base: ?string,
 *   model?: ?string}} LabelledPatch A patch, the label it shall have, and the one it is shown with.
 */

/** `LabelledPatch`es as the changes that `act` takes: one for each frame and label. */
export function changesOf(patches) {
  const groups = Map.groupBy(patches, ({ camera, frame, label, model }) =>
    JSON.stringify([camera, frame, label, model ?? null]),
  );
  return [...groups.values()].map((some) => {
    const [{ camera, frame, label, model }] = some;
    const cells = some.map(({ cell }) => cell);
    return { camera, frame, label, model, cells, base: some.map(({ base }) => base) };
  });
}

/** Give `LabelledPatch`es their labels, as one action that one undo takes back; how many change. */
export function actOn(kind, patches, options = {}) {
  const again = kind === CONFIRM;
  const changing = patches.filter(({ label, base, model }) => again || model || label !== base);
  if (changing.length > 0) act(kind, changesOf(changing), options);
  return changing.length;
}

function withBase(change, source, again) {
  const { camera, frame, label, model = null, cells } = change;
  const labels = change.base ? null : labelsOf(camera, frame);
  if (!change.base && !labels) throw new Error(`labels of ${camera} ${frame} are not loaded`);
  const field = source === "settled" ? "settled" : "mine";
  const base = change.base ?? cells.map((cell) => labels[field][cell]);
  const kept = cells.map((_, at) => at).filter((at) => again || base[at] !== label);
  const [changed, were] = [cells, base].map((all) => kept.map((at) => all[at]));
  return { camera, frame, label, model, cells: changed, base: were };
}

function newEntry(parts) {
  return {
    key: uniqueKey(),
    who: who(),
    blind: mission.blind,
    mission: mission.mission,
    grid: { ...mission.grid },
    source: "human",
    time: new Date().toISOString(),
    target: null,
    refusal: null,
    ...parts,
  };
}

// Kept in the browser first, so that what is shown survives a crash of the page; then on its way,
// before the page is busy with drawing.
function take(entry) {
  if (!keep(entry)) {
    entry.stored = null;
    if (trouble || !connected) {
      say("Not done: the server is away and this browser cannot keep actions (its storage is " +
        "full or switched off).", { bad: true, stays: true });
      return false;
    }
  }
  starts.set(entry.key, performance.now());
  enqueue(entry);
  pump();
  showFrames(entry);
  stateChanged();
  return true;
}

const starts = new Map();

function showFrames(entry) {
  for (const [camera, frame] of framesOf(entry)) labelsChanged(camera, frame);
}

// ---- Undo: the server's history, ahead of its acknowledgements

// Heads {key, kind, camera, frame, changed, frames}; only the ends that this page knows, the
// newest last.
let undoable = [];
let redoable = [];
const known = new Map(); // key of an action of this page -> {changes, source}

// Held against what the server says; only while nothing waits to be sent.
function takeHeads({ undo: undoHead, redo: redoHead }) {
  if (undoable.at(-1)?.key !== undoHead?.key) undoable = undoHead ? [undoHead] : [];
  if (redoable.at(-1)?.key !== redoHead?.key) redoable = redoHead ? [redoHead] : [];
}

// An action was refused, or another person works here.
function forgetHistory() {
  undoable = [];
  redoable = [];
}

// The changes that take an action back.
function opposite(changes) {
  return changes.flatMap((change) => {
    const groups = Map.groupBy(change.cells.keys(), (at) => change.base[at]);
    return [...groups].map(([label, places]) => ({
      ...change,
      label,
      model: null,
      cells: places.map((at) => change.cells[at]),
      base: places.map(() => change.label),
    }));
  });
}

/**
 * Take the newest action back: the head {kind, camera, frame, changed, frames} of what is undone;
 * null if there is nothing, or it cannot be done now (that was said).
 */
export function undo() {
  return step("undo");
}

/** Do again what was undone last; gives what `undo` does. */
export function redo() {
  return step("redo");
}

/**
 * What undo and redo would act on: two heads as `undo` gives them, null where there is nothing; {}
 * where only the server knows, which is told of an action now.
 */
export function nextSteps() {
  const rest = waiting().length ? {} : null;
  return [undoable.at(-1) ?? rest, redoable.at(-1) ?? null];
}

let steps = Promise.resolve();

// One after the other: what the second of two quick presses acts on depends on the first.
function step(kind) {
  return (steps = steps.then(() => oneStep(kind)));
}

async function oneStep(kind) {
  const next = () => (kind === "undo" ? undoable : redoable).at(-1);
  if (!next() && state() === "saving") await whenIdle();
  const head = next();
  const away = "The server is away: only actions of this page can be undone until it is back.";
  if (!head) {
    say(waiting().length ? away : `Nothing to ${kind}.`);
    return null;
  }
  // One of an earlier page or another tab is not known here.
  const did = known.get(head.key);
  if (!did && (trouble || !connected)) {
    say(away);
    return null;
  }
  const { changes, source } = did ?? { changes: [], source: "human" };
  const turned = kind === "undo" ? opposite(changes) : changes;
  const path = `/api/${kind}`;
  held.clear();
  if (!take(newEntry({ path, kind, source, target: head.key, changes: turned }))) return null;
  if (kind === "undo") redoable.push(undoable.pop());
  else undoable.push(redoable.pop());
  return head;
}

/** Send an action again that the server refused. */
export function sendAgain(entry) {
  takeBack(entry);
  entry.refusal = null;
  if (entry.stored) keep(entry);
  enqueue(entry);
  showFrames(entry);
  stateChanged();
  pump();
}

/** Send what waits now, without waiting for the next try. */
export function tryNow() {
  tries = 0;
  pump();
}

async function pump() {
  clearTimeout(retryTimer);
  if (running) return;
  running = true;
  try {
    while (waiting().length && !held.has(waiting()[0].key) && (await send(waiting()[0])));
  } finally {
    // Also after a fault in what shows the answers: saving goes on.
    running = false;
    if (waiting().length && !trouble) retryTimer = setTimeout(pump, RETRY_MS[0]);
  }
  stateChanged();
  if (!waiting().length) for (const resolve of idleWaiters.splice(0)) resolve();
}

async function send(entry) {
  let answer;
  try {
    if (trouble) await checkServer();
    answer = await post(entry.path, wire(entry));
  } catch (error) {
    if (error.name !== "ApiError") throw error;
    return failed(entry, error);
  }
  trouble = null;
  tries = 0;
  acknowledged(entry, answer);
  return true;
}

function wire({ path, key, who: annotator, blind: isBlind, mission: name, grid, ...rest }) {
  const { kind, source, time, target, changes } = rest;
  const common = { key, who: annotator, blind: isBlind, mission: name, grid, time };
  if (path !== "/api/actions") return { ...common, target };
  return { ...common, kind, source, changes };
}

// After a failure another server may have been started on this port, for another mission.
async function checkServer() {
  stranger = strangerWords(await get("/api/mission"));
  if (stranger) throw new ApiError(421, stranger);
}

/** Note what the server shows instead of this page's mission; "" where it shows that. */
export function noteStranger(words) {
  if (words === stranger) return;
  stranger = words;
  stateChanged();
}

function acknowledged(entry, answer) {
  const start = starts.get(entry.key);
  if (start !== undefined) performance.measure("tokt:ack", { start, end: performance.now() });
  starts.delete(entry.key);
  forget(entry);
  if (!answer.repeated && answer.changed && entry.who === who()) noteOwn(answer);
  acknowledge(entry, answer);
  dequeue(entry);
  if (entry.who === who() && entry.blind === mission.blind) takeNews(answer);
  if (answer.conflicts?.length) {
    known.delete(entry.target ?? entry.key); // not all of it was written
    noteConflicts(entry, answer.conflicts);
    // Of somebody who worked here before: theirs to decide.
    if (entry.who !== who()) readConflicts(mission.mission, who());
  }
  if (answer.undo && !waiting().length && entry.who === who()) takeHeads(answer.undo);
  showFrames(entry);
  stateChanged();
}

function noteOwn({ event, changed }) {
  ownEvents.push({ before: event - changed, last: event });
  if (ownEvents.length > KEPT_RANGES) ownEvents.shift();
}

/** Whether all events after `since` up to `last` are of this page's own actions. */
export function allOwn(since, last) {
  let heard = since;
  for (const range of ownEvents) if (range.before <= heard) heard = Math.max(heard, range.last);
  return heard >= last;
}

function failed(entry, { status, message }) {
  const bad = status >= 400 && status < 500 && !KEEP_STATUS.has(status);
  if (bad || (status === 500 && tries >= MAX_FAILURES)) {
    trouble = null;
    tries = 0;
    dequeue(entry);
    forgetHistory();
    setAside(entry, message);
    showFrames(entry);
    refreshHeads();
    return true;
  }
  const offline = status === 0 || (status >= 500 && status !== 507);
  trouble = { state: offline ? "offline" : "refused", text: message };
  retryTimer = setTimeout(pump, RETRY_MS[Math.min(tries, RETRY_MS.length - 1)]);
  tries += 1;
  return false;
}

async function refreshHeads() {
  const answer = await get("/api/mission").catch(onFailure());
  if (answer && sameMission(answer) && !waiting().length) takeHeads(answer.undo);
}

/** Note whether the server is heard. */
export function setConnected(value) {
  if (value === connected) return;
  connected = value;
  if (value) tryNow();
  stateChanged();
}

/** Take in what an event says, unless actions of ours that it cannot know of wait. */
export function takeEventHeads({ undo: heads }) {
  if (heads && !waiting().length) takeHeads(heads);
}

/** Begin: take over what earlier pages left, and go on doing so. The mission must be loaded. */
export function startSaving() {
  holdPage();
  begin();
  onReload(() => {
    forgetHistory();
    readConflicts(mission.mission, who());
  });
  onChange((what) => {
    if (what === "all") {
      ownEvents.length = 0; // the server may be another one now, whose events count anew
      begin();
    }
    if (what === "status") stateChanged();
  });
  window.addEventListener("online", tryNow);
  window.addEventListener("beforeunload", (event) => {
    // Only this page's memory holds it.
    if (waiting().some((entry) => !entry.stored)) event.preventDefault();
  });
  setInterval(takeLeftovers, LOOK_FOR_LEFTOVERS_MS);
}

function begin() {
  if (!waiting().length) takeHeads(mission.undo);
  readConflicts(mission.mission, who());
  takeLeftovers();
  stateChanged();
}

async function takeLeftovers() {
  const found = await leftovers();
  // Only now: the same ones may have been taken over, or sent, meanwhile.
  const here = new Set([...waiting(), ...unwritten().aside].map((entry) => entry.key));
  const left = found.filter((entry) => !here.has(entry.key) && isKept(entry));
  const mine = left.filter(isMine);
  setForeign(left.filter((entry) => !isMine(entry)));
  for (const entry of mine.filter(({ refusal }) => refusal)) setAside(entry, entry.refusal);
  const unsent = mine.filter(({ refusal }) => !refusal);
  if (!unsent.length) return;
  for (const entry of [...unsent].reverse()) enqueue(entry, { first: true });
  forgetHistory();
  unsent.forEach(showFrames);
  const were = unsent.length === 1 ? "action" : "actions";
  const words = "of an earlier page were not saved yet and are sent now.";
  say(`${unsent.length} ${were} ${words}`, { stays: true });
  stateChanged();
  pump();
}

function isMine(entry) {
  const sameGrid = Object.entries(mission.grid).every(([name, n]) => entry.grid[name] === n);
  return entry.mission === mission.mission && entry.who === who() && sameGrid;
}
