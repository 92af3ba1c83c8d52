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

/** @import { Entry, NotedConflict, Refused, Signal } from "../types.js" */
/** @import { Unwritten, WaitingEntries } from "../types.js" */

/** @type {WaitingEntries} */
const outbox = { queue: [], byFrame: new Map(), page: uniqueKey(), count: 0 };

/** @type {Unwritten} */
const refused = { aside: [], foreign: [], conflicts: [] };

/** The key of a frame in maps. @param {string} camera @param {number} frame */
export function frameKey(camera, frame) {
  return `${camera}/${frame}`;
}

/** All entries that wait, first to be sent first. @returns {Entry[]} */
export function waiting() {
  return outbox.queue;
}

/** Add an entry at the end, or first. @param {Entry} entry @param {{first?: boolean}} [options] */
export function enqueue(entry, { first = false } = {}) {
  /** @param {Entry[]} list */
  const add = (list) => (first ? [entry, ...list] : [...list, entry]);
  outbox.queue = add(outbox.queue);
  for (const key of touched(entry)) outbox.byFrame.set(key, add(outbox.byFrame.get(key) ?? []));
}

/** Take an entry out. @param {Entry} entry */
export function dequeue(entry) {
  outbox.queue = outbox.queue.filter((other) => other !== entry);
  for (const key of touched(entry)) {
    const rest = (outbox.byFrame.get(key) ?? []).filter((other) => other !== entry);
    if (rest.length) outbox.byFrame.set(key, rest);
    else outbox.byFrame.delete(key);
  }
}

/** The waiting entries that change a frame. @param {string} camera @param {number} frame */
export function waitingFor(camera, frame) {
  return outbox.byFrame.get(frameKey(camera, frame)) ?? [];
}

/** The frames that an entry changes, [camera, frame], each once.
 * @param {Entry} entry @returns {[camera: string, frame: number][]}
 */
export function framesOf(entry) {
  /** @type {Map<string, [camera: string, frame: number]>} */
  const found = new Map();
  for (const { camera, frame } of entry.changes) {
    found.set(frameKey(camera, frame), [camera, frame]);
  }
  return [...found.values()];
}

/** @param {Entry} entry */
function touched(entry) {
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

/** Keep an entry, whose `stored` becomes its name in the storage; whether that worked.
 * @param {Entry} entry
 */
export function keep(entry) {
  entry.stored ??= `${PREFIX}${outbox.page}/${String(outbox.count++).padStart(9, "0")}`;
  return write(entry.stored, entry);
}

/** Forget an entry. @param {Entry} entry */
export function forget(entry) {
  if (entry.stored) remove(entry.stored);
}

/** Whether an entry is still there: nobody sent it or threw it away. @param {Entry} entry */
export function isKept(entry) {
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

/** @param {string} other */
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

/** @type {Signal<[]>} Be told that one of the lists changed. */
export const [onRefused, refusedChanged] = signal();

/** The lists of what was not written. */
export function unwritten() {
  return refused;
}

/** Set an entry refused.aside that the server will never take, and why, in its words.
 * @param {Entry} entry @param {?string} refusal
 */
export function setAside(entry, refusal) {
  entry.refusal = refusal;
  if (entry.stored) keep(entry);
  refused.aside.push(entry);
  refusedChanged();
}

/** Take a refused entry out of the list, to send it again. @param {Entry} entry */
export function takeBack(entry) {
  refused.aside.splice(refused.aside.indexOf(entry), 1);
  refusedChanged();
}

/** Throw a refused entry away; only when a person says so. @param {Entry} entry */
export function discard(entry) {
  forget(entry);
  takeBack(entry);
}

/** Name the entries that are not this page's to send. @param {Entry[]} entries */
export function setForeign(entries) {
  if (!entries.length && !refused.foreign.length) return;
  refused.foreign = entries;
  refusedChanged();
}

/** Note patches of an entry that were not written: somebody said something else meanwhile.
 * @param {Entry} entry @param {Refused[]} refusedCells
 */
export function noteConflicts(entry, refusedCells) {
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

/** Of two things said of a patch and not written only the newer one is still meant.
 * @param {NotedConflict} one @param {NotedConflict} other
 */
function isOfOnePatch(one, other) {
  const parts = /** @type {const} */ (["camera", "frame", "cell", "who", "mission", "source"]);
  return parts.every((part) => one[part] === other[part]);
}

/** Forget refused.conflicts that were decided. @param {NotedConflict[]} decided */
export function closeConflicts(decided) {
  decided.forEach(drop);
  refusedChanged();
}

/** @param {NotedConflict} conflict */
function drop(conflict) {
  remove(conflict.stored);
  refused.conflicts = refused.conflicts.filter((other) => other !== conflict);
}

/** Read the conflicts that this person left open. @param {string} mission @param {string} who */
export function readConflicts(mission, who) {
  const kept = names(CONFLICT).map((name) => ({ ...read(name), kept: true }));
  // Those that the browser could not keep are only here.
  refused.conflicts = [...refused.conflicts.filter((noted) => !noted.kept), ...kept].filter(
    (noted) => noted.mission === mission && noted.who === who,
  );
  refusedChanged();
}
