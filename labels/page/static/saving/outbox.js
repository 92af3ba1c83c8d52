// The outbox: actions that the server has not acknowledged yet, in order, and by frame. They are
// kept in the browser too, so that they outlive the page. Each page load writes under its own name
// and holds a lock of that name; a name whose lock is free belongs to a page that is gone, and
// what it left is taken over.
//
// And what was not written: actions the server refused, patches somebody changed meanwhile, and
// actions of other missions or people that wait in this browser. Nothing leaves it silently.

import { signal } from "../core/dom.js";
import { names, read, remove, write } from "../core/settings.js";
/** @import { Entry, NotedConflict, Refused, Signal, Unwritten } from "../types.js" */
/** @import { WaitingEntries } from "../types.js" */

const PREFIX = "tokt.action/";
const CONFLICT = "tokt.conflict/";
const ALIVE = "tokt.alive/";
const LOCK = "tokt.page/";
const BEAT_MS = 5000;
// Without the locks of a secure page: background tabs' timers run once a minute at worst.
const SILENT_MS = 150000;

/** @type {WaitingEntries} */
const outbox = { queue: [], byFrame: new Map(), page: uniqueKey(), count: 0 };

/** @type {Unwritten} */
const refused = { aside: [], foreign: [], conflicts: [] };

export function frameKey(/** @type {string} */ camera, /** @type {number} */ frame) {
  return `${camera}/${frame}`;
}

/** All entries that wait, first to be sent first. */
export function waiting() {
  return outbox.queue;
}

/** Add an entry at the end, or first. @param {Entry} entry @param {{first?: boolean}} [options] */
export function enqueue(entry, { first = false } = {}) {
  const add = (/** @type {Entry[]} */ list) => (first ? [entry, ...list] : [...list, entry]);
  outbox.queue = add(outbox.queue);
  for (const key of touched(entry)) outbox.byFrame.set(key, add(outbox.byFrame.get(key) ?? []));
}

export function dequeue(/** @type {Entry} */ entry) {
  outbox.queue = outbox.queue.filter((other) => other !== entry);
  for (const key of touched(entry)) {
    const rest = (outbox.byFrame.get(key) ?? []).filter((other) => other !== entry);
    if (rest.length) outbox.byFrame.set(key, rest);
    else outbox.byFrame.delete(key);
  }
}

/** The waiting entries that change a frame. */
export function waitingFor(/** @type {string} */ camera, /** @type {number} */ frame) {
  return outbox.byFrame.get(frameKey(camera, frame)) ?? [];
}

/** The frames that an entry changes, each once. */
export function framesOf(/** @type {Entry} */ entry) {
  /** @type {Map<string, [camera: string, frame: number]>} */
  const found = new Map();
  for (const { camera, frame } of entry.changes) {
    found.set(frameKey(camera, frame), [camera, frame]);
  }
  return [...found.values()];
}

function touched(/** @type {Entry} */ entry) {
  return framesOf(entry).map(([camera, frame]) => frameKey(camera, frame));
}

/** A name nobody else has; also where crypto.randomUUID is kept for secure pages. */
export function uniqueKey() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return [...bytes].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Say that this page is there, as long as it is. */
export function holdPage() {
  if (navigator.locks) {
    navigator.locks.request(LOCK + outbox.page, () => new Promise(() => {}));
    return;
  }
  const beat = () => write(ALIVE + outbox.page, Date.now());
  beat();
  setInterval(beat, BEAT_MS);
}

/** Keep an entry, whose `stored` becomes its name in the storage; whether that worked. */
export function keep(/** @type {Entry} */ entry) {
  entry.stored ??= `${PREFIX}${outbox.page}/${String(outbox.count++).padStart(9, "0")}`;
  return write(entry.stored, entry);
}

export function forget(/** @type {Entry} */ entry) {
  if (entry.stored) remove(entry.stored);
}

/** Whether an entry is still there: nobody sent it or threw it away. */
export function isKept(/** @type {Entry} */ entry) {
  return read(entry.stored ?? "") !== null;
}

/** The entries that pages left which are gone, in the order in which they were made. */
export async function leftovers() {
  const pages = new Set(names(PREFIX).map((name) => name.slice(PREFIX.length).split("/")[0]));
  pages.delete(outbox.page);
  /** @type {Entry[]} */
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

async function isGone(/** @type {string} */ other) {
  if (navigator.locks) {
    return navigator.locks.request(LOCK + other, { ifAvailable: true }, (lock) => lock !== null);
  }
  const last = read(ALIVE + other);
  if (last !== null && Date.now() - last < SILENT_MS) return false;
  remove(ALIVE + other);
  return true;
}

// ---- What was not written

/** @type {Signal<[]>} Be told that one of the lists changed. */
export const [onRefused, refusedChanged] = signal();

export function unwritten() {
  return refused;
}

/** Set an entry aside that the server will never take, and why, in its words. */
export function setAside(/** @type {Entry} */ entry, /** @type {?string} */ refusal) {
  entry.refusal = refusal;
  if (entry.stored) keep(entry);
  refused.aside.push(entry);
  refusedChanged();
}

/** Take a refused entry out of the list, to send it again. */
export function takeBack(/** @type {Entry} */ entry) {
  refused.aside.splice(refused.aside.indexOf(entry), 1);
  refusedChanged();
}

/** Throw a refused entry away; only when a person says so. */
export function discard(/** @type {Entry} */ entry) {
  forget(entry);
  takeBack(entry);
}

/** Name the entries that are not this page's to send. */
export function setForeign(/** @type {Entry[]} */ entries) {
  if (!entries.length && !refused.foreign.length) return;
  refused.foreign = entries;
  refusedChanged();
}

/** Note patches of an entry that were not written: somebody said something else meanwhile. */
export function noteConflicts(/** @type {Entry} */ entry, /** @type {Refused[]} */ refusedCells) {
  const { who, mission, source } = entry;
  for (const conflict of refusedCells) {
    /** @type {NotedConflict} */
    const noted = { ...conflict, who, mission, source, stored: CONFLICT + uniqueKey() };
    refused.conflicts.filter((other) => isOfOnePatch(other, noted)).forEach(drop);
    noted.kept = write(noted.stored, noted);
    refused.conflicts.push(noted);
  }
  refusedChanged();
}

/** Of two things said of a patch and not written only the newer one is still meant. */
function isOfOnePatch(/** @type {NotedConflict} */ one, /** @type {NotedConflict} */ other) {
  const parts = /** @type {const} */ (["camera", "frame", "cell", "who", "mission", "source"]);
  return parts.every((part) => one[part] === other[part]);
}

/** Forget conflicts that were decided. */
export function closeConflicts(/** @type {NotedConflict[]} */ decided) {
  decided.forEach(drop);
  refusedChanged();
}

function drop(/** @type {NotedConflict} */ conflict) {
  remove(conflict.stored);
  refused.conflicts = refused.conflicts.filter((other) => other !== conflict);
}

/** Read the conflicts that this person left open. */
export function readConflicts(/** @type {string} */ mission, /** @type {string} */ who) {
  const kept = names(CONFLICT).map((name) => ({ ...read(name), kept: true }));
  // Those that the browser could not keep are only here.
  refused.conflicts = [...refused.conflicts.filter((noted) => !noted.kept), ...kept].filter(
    (noted) => noted.mission === mission && noted.who === who,
  );
  refusedChanged();
}
