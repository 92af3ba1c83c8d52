// Actions on their way to the server, kept in the browser until they are acknowledged.
// Each page load writes under its own name and holds a lock of that name; a name whose lock is
// free belongs to a page that is gone, and what it left is taken over.

import { names, read, remove, write } from "./storage.js";

const PREFIX = "tokt.action/";
const ALIVE = "tokt.alive/";
const LOCK = "tokt.page/";
const BEAT_MS = 5000;
// Without the locks of a secure page: background tabs' timers run once a minute at worst.
const SILENT_MS = 150000;

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

/**
 * Keep an entry.
 * @param {Entry} entry `stored` is set to its name in the storage.
 * @returns {boolean} Whether it is kept.
 */
export function keep(entry) {
  entry.stored ??= `${PREFIX}${page}/${String(count++).padStart(9, "0")}`;
  return write(entry.stored, entry);
}

/**
 * Forget an entry.
 * @param {Entry} entry
 */
export function forget(entry) {
  if (entry.stored) remove(entry.stored);
}

/**
 * Whether an entry is still there: nobody sent it or threw it away.
 * @param {Entry} entry
 * @returns {boolean}
 */
export function isKept(entry) {
  return read(entry.stored) !== null;
}

/**
 * The entries that pages left which are gone, in the order in which they were made.
 * @returns {Promise<Entry[]>}
 */
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
