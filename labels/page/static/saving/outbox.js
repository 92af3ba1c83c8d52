// The outbox: actions that the server has not acknowledged yet, in order, and by frame. They are
// kept in the browser too, so that they outlive the page. Each page load writes under its own name
// and holds a lock of that name; a name whose lock is free belongs to a page that is gone, and
// what it left is taken over.
//
// And what was not written: actions the server refused, patches somebody changed meanwhile, and
// actions of other missions or people that wait in this browser. Nothing leaves it silently.

import { signal } from "../core/dom.js";
import { names, read, remove, write } from "../core/settings.js";

const PREFIX = "tokt.action/";
const CONFLICT = "tokt.conflict/";
const ALIVE = "tokt.alive/";
const LOCK = "tokt.page/";
const BEAT_MS = 5000;
// Without the locks of a secure page: background tabs' timers run once a minute at worst.
const SILENT_MS = 150000;

/**
 * An action of the page: what is kept in the browser and sent.
 * @typedef {Object} Entry
 * @property {string} key      Unique; the server counts it once.
 * @property {string} path     /api/actions, /api/undo or /api/redo.
 * @property {string} who
 * @property {boolean} blind
 * @property {string} mission
 * @property {Object} grid     As the server names it.
 * @property {string} kind     What the person did, for messages.
 * @property {string} source   "human" or "settled".
 * @property {string} time     UTC.
 * @property {?string} target  Key of the action that an undo or redo is meant for.
 * @property {Change[]} changes  Of an undo: the opposite ones, where this page knows them.
 * @property {?string} refusal Why the server refused it; null while it waits.
 */

/**
 * @typedef {Object} Change
 * @property {string} camera
 * @property {number} frame
 * @property {?string} label
 * @property {?string} model   Version of the model whose suggestion was confirmed.
 * @property {number[]} cells
 * @property {(?string)[]} base  What the page believed each cell's label was.
 */

/** @type {Entry[]} */
let queue = [];
const byFrame = new Map();

/** The key of a frame in maps. */
export function frameKey(camera, frame) {
  return `${camera}/${frame}`;
}

/** All entries that wait, first to be sent first. */
export function waiting() {
  return queue;
}

/** Add an entry at the end, or before all others. */
export function enqueue(entry, { first = false } = {}) {
  const add = (list) => (first ? [entry, ...list] : [...list, entry]);
  queue = add(queue);
  for (const key of touched(entry)) byFrame.set(key, add(byFrame.get(key) ?? []));
}

/** Take an entry out. */
export function dequeue(entry) {
  queue = queue.filter((other) => other !== entry);
  for (const key of touched(entry)) {
    const rest = (byFrame.get(key) ?? []).filter((other) => other !== entry);
    if (rest.length) byFrame.set(key, rest);
    else byFrame.delete(key);
  }
}

/** The waiting entries that change a frame. */
export function waitingFor(camera, frame) {
  return byFrame.get(frameKey(camera, frame)) ?? [];
}

/** The frames that an entry changes, [camera, frame], each once. */
export function framesOf(entry) {
  const all = entry.changes.map(({ camera, frame }) => [frameKey(camera, frame), [camera, frame]]);
  return [...new Map(all).values()];
}

function touched(entry) {
  return framesOf(entry).map(([camera, frame]) => frameKey(camera, frame));
}

/** A name nobody else has; also where crypto.randomUUID is kept for secure pages. */
export function uniqueKey() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return [...bytes].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

const page = uniqueKey();
let count = 0;

/** Say that this page is there, as long as it is. */
export function holdPage() {
  if (navigator.locks) {
    navigator.locks.request(LOCK + page, () => new Promise(() => {}));
    return;
  }
  const beat = () => write(ALIVE + page, Date.now());
  beat();
  setInterval(beat, BEAT_MS);
}

/** Keep an entry, whose `stored` becomes its name in the storage; whether that worked. */
export function keep(entry) {
  entry.stored ??= `${PREFIX}${page}/${String(count++).padStart(9, "0")}`;
  return write(entry.stored, entry);
}

/** Forget an entry. */
export function forget(entry) {
  if (entry.stored) remove(entry.stored);
}

/** Whether an entry is still there: nobody sent it or threw it away. */
export function isKept(entry) {
  return read(entry.stored) !== null;
}

/** The entries that pages left which are gone, in the order in which they were made. */
export async function leftovers() {
  const pages = new Set(names(PREFIX).map((name) => name.slice(PREFIX.length).split("/")[0]));
  pages.delete(page);
  const found = [];
  for (const other of pages) {
    if (!(await isGone(other))) continue;
    for (const name of names(`${PREFIX}${other}/`)) {
      const entry = read(name);
      if (entry?.key) found.push({ ...entry, stored: name });
    }
  }
  // Stable: actions of one page stay in their order also within a millisecond.
  return found.sort((a, b) => a.time.localeCompare(b.time));
}

async function isGone(other) {
  if (navigator.locks) {
    return navigator.locks.request(LOCK + other, { ifAvailable: true }, (lock) => lock !== null);
  }
  const last = read(ALIVE + other);
  if (last !== null && Date.now() - last < SILENT_MS) return false;
  remove(ALIVE + other);
  return true;
}

// ---- What was not written

const aside = [];
let foreign = [];
let conflicts = [];

/** Be told that one of the lists changed. */
const [onRefused, refusedChanged] = signal();
export { onRefused };

/**
 * What was not written: `aside`, entries that the server refused, each with its `refusal`;
 * `foreign`, entries in this browser that are another mission's or another person's; `conflicts`
 * {stored, camera, frame, cell, theirs, yours, source}, to decide.
 */
export function unwritten() {
  return { aside, foreign, conflicts };
}

/** Set an entry aside that the server will never take, and why, in its words. */
export function setAside(entry, refusal) {
  entry.refusal = refusal;
  if (entry.stored) keep(entry);
  aside.push(entry);
  refusedChanged();
}

/** Take a refused entry out of the list, to send it again. */
export function takeBack(entry) {
  aside.splice(aside.indexOf(entry), 1);
  refusedChanged();
}

/** Throw a refused entry away; only when a person says so. */
export function discard(entry) {
  forget(entry);
  takeBack(entry);
}

/** Name the entries that are not this page's to send. */
export function setForeign(entries) {
  if (!entries.length && !foreign.length) return;
  foreign = entries;
  refusedChanged();
}

/**
 * Note patches of an entry, {camera, frame, cell, theirs, yours} as the server names them, that
 * were not written because somebody said something else meanwhile.
 */
export function noteConflicts(entry, refusedCells) {
  const { who, mission, source } = entry;
  for (const conflict of refusedCells) {
    const noted = { ...conflict, who, mission, source, stored: CONFLICT + uniqueKey() };
    conflicts.filter((other) => isOfOnePatch(other, noted)).forEach(drop);
    noted.kept = write(noted.stored, noted);
    conflicts.push(noted);
  }
  refusedChanged();
}

// Of two things said of a patch and not written only the newer one is still meant.
function isOfOnePatch(one, other) {
  const parts = ["camera", "frame", "cell", "who", "mission", "source"];
  return parts.every((part) => one[part] === other[part]);
}

/** Forget conflicts that were decided. */
export function closeConflicts(decided) {
  decided.forEach(drop);
  refusedChanged();
}

function drop(conflict) {
  remove(conflict.stored);
  conflicts = conflicts.filter((other) => other !== conflict);
}

/** Read the conflicts that this person left open. */
export function readConflicts(mission, who) {
  const kept = names(CONFLICT).map((name) => ({ ...read(name), kept: true }));
  // Those that the browser could not keep are only here.
  conflicts = [...conflicts.filter((noted) => !noted.kept), ...kept].filter(
    (noted) => noted.mission === mission && noted.who === who,
  );
  refusedChanged();
}
