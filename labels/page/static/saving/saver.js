// Saving: each action is kept in the browser before it shows, sent in order, one at a time, and
// sent again until the server acknowledged it. The server counts an action's key once.

import { ApiError, get, onFailure, post } from "../core/api.js";
import { say, signal } from "../core/dom.js";
import {
  maskedCells, mission, onChange, onReload, sameMission, strangerWords, takeNews, who,
} from "../core/mission.js";
import { acknowledge, labelsChanged, labelsOf } from "./labels.js";
import {
  dequeue, enqueue, forget, framesOf, holdPage, isKept, keep, leftovers, noteConflicts,
  readConflicts, setAside, setForeign, takeBack, uniqueKey, unwritten, waiting,
} from "./outbox.js";
/** @import { ActOptions, ActionAnswer, Change, Entry, Head, Heads } from "../types.js" */
/** @import { KnownHistory, LabelledPatch, News, SaveState, SaverState } from "../types.js" */
/** @import { Signal, Wanted } from "../types.js" */

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

/** @type {SaverState} */
const saver = {
  idleWaiters: [],
  running: false,
  connected: true,
  trouble: null,
  stranger: "",
  tries: 0,
  retryTimer: 0,
  ownEvents: [],
  held: new Set(),
  starts: new Map(),
};

/** @type {KnownHistory} */
const history = { undoable: [], redoable: [], known: new Map(), steps: Promise.resolve(null) };

/** @type {Signal<[]>} Be told when `state()` or `pending()` may have changed. */
export const [onState, stateChanged] = signal();

/** "saved" only where all is acknowledged and the server takes more. @returns {SaveState} */
export function state() {
  if (saver.trouble) return saver.trouble.state;
  if (!saver.connected) return "offline";
  if (saver.stranger || mission.fault) return "refused";
  return waiting().length ? "saving" : "saved";
}

/** Whether actions cannot be sent in such a state. */
export function isAway(/** @type {SaveState | undefined} */ saved) {
  return saved === "offline" || saved === "refused";
}

/** Why the state is what it is, in one sentence; "" when all is well. */
export function stateReason() {
  if (saver.trouble) return saver.trouble.text;
  return saver.connected ? saver.stranger || mission.fault || "" : "the server does not answer";
}

/** How many actions wait for their acknowledgement. */
export function pending() {
  return waiting().length;
}

export function whenIdle() {
  if (!waiting().length) return Promise.resolve();
  const { promise, resolve } = Promise.withResolvers();
  saver.idleWaiters.push(() => resolve(undefined));
  return promise;
}

/** Do something to labels of patches in view; gives the action's key, null if it would change nothing or could not be
 * kept. Labels of the frames must be loaded where a change has no `base`.
 * @param {string} kind @param {Wanted[]} changes @param {ActOptions} [options]
 */
export function act(kind, changes, { source = "human", hold = false } = {}) {
  const based = changes.map((change) => withBase(change, source, kind === CONFIRM));
  const filled = based.filter(({ cells }) => cells.length);
  if (!filled.length) return null;
  const entry = newEntry({ path: "/api/actions", kind, source, changes: filled });
  if (hold) {
    saver.held.add(entry.key);
    setTimeout(release, HOLD_MS, entry.key);
  } else saver.held.clear();
  if (!take(entry)) return null;
  const [{ camera, frame }] = filled;
  const changed = filled.reduce((sum, change) => sum + change.cells.length, 0);
  const { length } = framesOf(entry);
  history.undoable.push({ key: entry.key, kind, camera, frame, changed, frames: length });
  history.redoable = [];
  history.known.set(entry.key, { changes: filled, source });
  return entry.key;
}

function release(/** @type {string} */ key) {
  if (saver.held.delete(key)) pump();
}

/** Take an action back that was meant otherwise: as if it had never been, if not sent yet. */
export function withdraw(/** @type {string} */ key) {
  const entry = waiting().find((one) => one.key === key);
  if (!entry || !saver.held.delete(key)) {
    if (history.undoable.at(-1)?.key === key) undo();
    return;
  }
  forget(entry);
  dequeue(entry);
  history.undoable = history.undoable.filter((head) => head.key !== key);
  showFrames(entry);
  pump();
  refreshHeads(); // what could be done again still can
}

/** "23 patches are", "1 patch is" */
export function patchesAre(/** @type {number} */ count) {
  return count === 1 ? "1 patch is" : `${count.toLocaleString("en")} patches are`;
}

/** `LabelledPatch`es as the changes that `act` takes: one for each frame and label. */
export function changesOf(/** @type {LabelledPatch[]} */ patches) {
  const groups = Map.groupBy(patches, ({ camera, frame, label, model }) =>
    JSON.stringify([camera, frame, label, model ?? null]),
  );
  return [...groups.values()].map((some) => {
    const [{ camera, frame, label, model }] = some;
    const cells = some.map(({ cell }) => cell);
    return { camera, frame, label, model, cells, base: some.map(({ base }) => base) };
  });
}

/** Give patches their labels, as one action that one undo takes back; how many change.
 * @param {string} kind @param {LabelledPatch[]} patches @param {ActOptions} [options]
 */
export function actOn(kind, patches, options = {}) {
  const again = kind === CONFIRM;
  const changing = patches.filter(({ label, base, model }) => again || model || label !== base);
  if (changing.length > 0) act(kind, changesOf(changing), options);
  return changing.length;
}

/** @param {Wanted} change @param {string} source @param {boolean} again @returns {Change} */
function withBase(change, source, again) {
  const { camera, frame, label, model = null, cells } = change;
  const field = source === "settled" ? "settled" : "mine";
  const shown = change.base ? null : labelsOf(camera, frame);
  if (!change.base && !shown) throw new Error(`labels of ${camera} ${frame} are not loaded`);
  const base = change.base ?? cells.map((cell) => shown?.[field][cell] ?? null);
  const masked = maskedCells(camera);
  const may = (/** @type {number} */ at) => !masked.has(cells[at]) && (again || base[at] !== label);
  const kept = [...cells.keys()].filter(may);
  const [changed, were] = [kept.map((at) => cells[at]), kept.map((at) => base[at])];
  return { camera, frame, label, model, cells: changed, base: were };
}

/** @param {Pick<Entry, "path" | "kind" | "changes"> & Partial<Entry>} parts @returns {Entry} */
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

/** Kept in the browser first, to outlast a crash; on its way before anything is drawn. */
function take(/** @type {Entry} */ entry) {
  if (!keep(entry)) {
    entry.stored = null;
    if (saver.trouble || !saver.connected) {
      say("Not done: the server is away and this browser cannot keep actions (its storage is " +
        "full or switched off).", { bad: true, stays: true });
      return false;
    }
  }
  saver.starts.set(entry.key, performance.now());
  enqueue(entry);
  pump();
  showFrames(entry);
  stateChanged();
  return true;
}

function showFrames(/** @type {Entry} */ entry) {
  for (const [camera, frame] of framesOf(entry)) labelsChanged(camera, frame);
}

// ---- Undo: the server's history, ahead of its acknowledgements

/** Held against what the server says; only while nothing waits to be sent. */
function takeHeads(/** @type {Heads} */ { undo: undoHead, redo: redoHead }) {
  if (history.undoable.at(-1)?.key !== undoHead?.key) history.undoable = undoHead ? [undoHead] : [];
  if (history.redoable.at(-1)?.key !== redoHead?.key) history.redoable = redoHead ? [redoHead] : [];
}

// An action was refused, or another person works here.
function forgetHistory() {
  history.undoable = [];
  history.redoable = [];
}

/** The changes that take an action back. @returns {Change[]} */
function opposite(/** @type {Change[]} */ changes) {
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

/** Take the newest action back; null: there is none, or it cannot be done now (that was said). */
export function undo() {
  return step("undo");
}

/** Do again what was undone last; gives what `undo` does. */
export function redo() {
  return step("redo");
}

/** What undo and redo would act on, null where there is nothing; {} where only the server knows,
 * which is told of an action now. @returns {[?Partial<Head>, ?Head]}
 */
export function nextSteps() {
  const rest = waiting().length ? {} : null;
  return [history.undoable.at(-1) ?? rest, history.redoable.at(-1) ?? null];
}

/** One after the other: what the second of two quick presses acts on depends on the first. */
function step(/** @type {"undo" | "redo"} */ kind) {
  return (history.steps = history.steps.then(() => oneStep(kind)));
}

async function oneStep(/** @type {"undo" | "redo"} */ kind) {
  const next = () => (kind === "undo" ? history.undoable : history.redoable).at(-1);
  if (!next() && state() === "saving") await whenIdle();
  const head = next();
  const away = "The server is away: only actions of this page can be undone until it is back.";
  if (!head) {
    say(waiting().length ? away : `Nothing to ${kind}.`);
    return null;
  }
  // One of an earlier page or another tab is not known here.
  const did = history.known.get(head.key);
  if (!did && (saver.trouble || !saver.connected)) {
    say(away);
    return null;
  }
  const { changes, source } = did ?? { changes: [], source: "human" };
  const turned = kind === "undo" ? opposite(changes) : changes;
  const path = /** @type {const} */ (`/api/${kind}`);
  saver.held.clear();
  if (!take(newEntry({ path, kind, source, target: head.key, changes: turned }))) return null;
  const { undoable, redoable } = history;
  if (kind === "undo") redoable.push(...undoable.splice(-1));
  else undoable.push(...redoable.splice(-1));
  return head;
}

export function sendAgain(/** @type {Entry} */ entry) {
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
  saver.tries = 0;
  pump();
}

async function pump() {
  clearTimeout(saver.retryTimer);
  if (saver.running) return;
  saver.running = true;
  try {
    while (waiting().length && !saver.held.has(waiting()[0].key) && (await send(waiting()[0])));
  } finally {
    // Also after a fault in what shows the answers: saving goes on.
    saver.running = false;
    if (waiting().length && !saver.trouble) saver.retryTimer = setTimeout(pump, RETRY_MS[0]);
  }
  stateChanged();
  if (!waiting().length) for (const tell of saver.idleWaiters.splice(0)) tell();
}

async function send(/** @type {Entry} */ entry) {
  /** @type {ActionAnswer} */
  let answer;
  try {
    if (saver.trouble) await checkServer();
    answer = await post(entry.path, wire(entry));
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    return failed(entry, error);
  }
  saver.trouble = null;
  saver.tries = 0;
  acknowledged(entry, answer);
  return true;
}

function wire(/** @type {Entry} */ entry) {
  const { key, who: annotator, blind, mission: name, grid, time } = entry;
  const common = { key, who: annotator, blind, mission: name, grid, time };
  if (entry.path !== "/api/actions") return { ...common, target: entry.target };
  return { ...common, kind: entry.kind, source: entry.source, changes: entry.changes };
}

// After a failure another server may have been started on this port, for another mission.
async function checkServer() {
  saver.stranger = strangerWords(await get("/api/mission"));
  if (saver.stranger) throw new ApiError(421, saver.stranger);
}

/** Note what the server shows instead of this page's mission; "" where it shows that. */
export function noteStranger(/** @type {string} */ words) {
  if (words === saver.stranger) return;
  saver.stranger = words;
  stateChanged();
}

function acknowledged(/** @type {Entry} */ entry, /** @type {ActionAnswer} */ answer) {
  const start = saver.starts.get(entry.key);
  if (start !== undefined) performance.measure("tokt:ack", { start, end: performance.now() });
  saver.starts.delete(entry.key);
  forget(entry);
  if (!answer.repeated && answer.changed && entry.who === who()) noteOwn(answer);
  acknowledge(entry, answer);
  dequeue(entry);
  if (entry.who === who() && entry.blind === mission.blind) takeNews(answer);
  if (answer.conflicts?.length) {
    history.known.delete(entry.target ?? entry.key); // not all of it was written
    noteConflicts(entry, answer.conflicts);
    // Of somebody who worked here before: theirs to decide.
    if (entry.who !== who()) readConflicts(mission.mission, who());
  }
  // By somebody else, and not heard of before.
  if (answer.masked) say(`${patchesAre(answer.masked)} masked as no view and took no label.`);
  if (answer.undo && !waiting().length && entry.who === who()) takeHeads(answer.undo);
  showFrames(entry);
  stateChanged();
}

function noteOwn(/** @type {ActionAnswer} */ { event, changed }) {
  saver.ownEvents.push({ before: event - changed, last: event });
  if (saver.ownEvents.length > KEPT_RANGES) saver.ownEvents.shift();
}

/** Whether all events after `since` up to `last` are of this page's own actions. */
export function allOwn(/** @type {number} */ since, /** @type {number} */ last) {
  let heard = since;
  for (const range of saver.ownEvents) {
    if (range.before <= heard) heard = Math.max(heard, range.last);
  }
  return heard >= last;
}

function failed(/** @type {Entry} */ entry, /** @type {ApiError} */ { status, message }) {
  const bad = status >= 400 && status < 500 && !KEEP_STATUS.has(status);
  if (bad || (status === 500 && saver.tries >= MAX_FAILURES)) {
    saver.trouble = null;
    saver.tries = 0;
    dequeue(entry);
    forgetHistory();
    setAside(entry, message);
    showFrames(entry);
    refreshHeads();
    return true;
  }
  const offline = status === 0 || (status >= 500 && status !== 507);
  saver.trouble = { state: offline ? "offline" : "refused", text: message };
  saver.retryTimer = setTimeout(pump, RETRY_MS[Math.min(saver.tries, RETRY_MS.length - 1)]);
  saver.tries += 1;
  return false;
}

async function refreshHeads() {
  const answer = await get("/api/mission").catch(onFailure());
  if (answer && sameMission(answer) && !waiting().length) takeHeads(answer.undo);
}

export function setConnected(/** @type {boolean} */ value) {
  if (value === saver.connected) return;
  saver.connected = value;
  if (value) tryNow();
  stateChanged();
}

/** Take in what an event says, unless actions of ours that it cannot know of wait. */
export function takeEventHeads(/** @type {News} */ { undo: heads }) {
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
      saver.ownEvents.length = 0; // the server may be another one now, whose events count anew
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

function isMine(/** @type {Entry} */ entry) {
  const { rows, cols, width } = mission.grid;
  const { grid } = entry;
  const sameGrid = grid.rows === rows && grid.cols === cols && grid.width === width;
  return entry.mission === mission.mission && entry.who === who() && sameGrid;
}
