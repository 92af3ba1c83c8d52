// What was not written: actions the server refused, patches somebody changed meanwhile, and
// actions of other missions or people that wait in this browser. Nothing leaves it silently.

import { forget, keep, uniqueKey } from "./outbox.js";
import { names, read, remove, write } from "../core/storage.js";

const CONFLICT = "tokt.conflict/";

const aside = [];
let foreign = [];
let conflicts = [];
const listeners = new Set();

/** Be told that one of the lists changed. */
export function onRefused(listener) {
  listeners.add(listener);
}

function changed() {
  for (const listener of listeners) listener();
}

/** Entries that the server refused, each with its `refusal`. */
export function setAsideEntries() {
  return aside;
}

/** Entries in this browser that are another mission's or another person's. */
export function foreignEntries() {
  return foreign;
}

/** Conflicts {stored, camera, frame, cell, theirs, yours, source} to decide. */
export function openConflicts() {
  return conflicts;
}

/**
 * Set an entry aside that the server will never take.
 * @param {Entry} entry
 * @param {string} refusal Why, in the server's words.
 */
export function setAside(entry, refusal) {
  entry.refusal = refusal;
  if (entry.stored) keep(entry);
  aside.push(entry);
  changed();
}

/**
 * Throw a refused entry away; only when a person says so.
 * @param {Entry} entry
 */
export function discard(entry) {
  forget(entry);
  aside.splice(aside.indexOf(entry), 1);
  changed();
}

/**
 * Take a refused entry out of the list, to send it again.
 * @param {Entry} entry
 */
export function takeBack(entry) {
  aside.splice(aside.indexOf(entry), 1);
  changed();
}

/**
 * Name the entries that are not this page's to send.
 * @param {Entry[]} entries
 */
export function setForeign(entries) {
  if (!entries.length && !foreign.length) return;
  foreign = entries;
  changed();
}

/**
 * Note patches that were not written because somebody said something else meanwhile.
 * @param {Entry} entry
 * @param {Object[]} refusedCells From the server: {camera, frame, cell, theirs, yours}.
 */
export function noteConflicts(entry, refusedCells) {
  if (!refusedCells.length) return;
  for (const conflict of refusedCells) {
    for (const older of conflicts.filter((noted) => isSame(noted, conflict, entry))) {
      remove(older.stored);
      conflicts = conflicts.filter((noted) => noted !== older);
    }
    const { who, mission, source } = entry;
    const noted = { ...conflict, who, mission, source, stored: CONFLICT + uniqueKey() };
    noted.kept = write(noted.stored, noted);
    conflicts.push(noted);
  }
  changed();
}

// Of two things said of a patch and not written only the newer one is still meant.
function isSame(noted, { camera, frame, cell }, { who, mission, source }) {
  return (
    noted.camera === camera &&
    noted.frame === frame &&
    noted.cell === cell &&
    noted.who === who &&
    noted.mission === mission &&
    noted.source === source
  );
}

/**
 * Forget a conflict that was decided.
 * @param {Object} conflict
 */
export function closeConflict(conflict) {
  remove(conflict.stored);
  conflicts = conflicts.filter((other) => other !== conflict);
  changed();
}

/**
 * Read the conflicts that this person left open.
 * @param {string} mission
 * @param {string} who
 */
export function readConflicts(mission, who) {
  const kept = names(CONFLICT).map((name) => ({ ...read(name), kept: true }));
  // Those that the browser could not keep are only here.
  conflicts = [...conflicts.filter((noted) => !noted.kept), ...kept].filter(
    (noted) => noted.mission === mission && noted.who === who,
  );
  changed();
}
