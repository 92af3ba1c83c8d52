// The actions that the server has not acknowledged yet, in order, and what they do to each frame.

/**
 * An action of the page: what is kept in the browser and sent.
 * @typedef {Object} Entry
 * @property {string} key      Unique; the server counts it once.
 * @property {string} path     /api/actions, /api/undo or /api/redo.
 * @property {string} who
 * @property {boolean} blind
 * @property {string} mission
 * @property {number[]} grid   Rows and columns.
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
const queue = [];
const byFrame = new Map();

/** The key of a frame in maps. */
export function frameKey(camera, frame) {
  return `${camera}/${frame}`;
}

/** All entries that wait, first to be sent first. */
export function waiting() {
  return queue;
}

/**
 * Add an entry at the end, or before all others.
 * @param {Entry} entry
 * @param {{first?: boolean}} [options]
 */
export function enqueue(entry, { first = false } = {}) {
  if (first) queue.unshift(entry);
  else queue.push(entry);
  for (const key of touched(entry)) {
    const list = byFrame.get(key) ?? [];
    if (first) list.unshift(entry);
    else list.push(entry);
    byFrame.set(key, list);
  }
}

/**
 * Take an entry out.
 * @param {Entry} entry
 */
export function dequeue(entry) {
  const at = queue.indexOf(entry);
  if (at >= 0) queue.splice(at, 1);
  for (const key of touched(entry)) {
    const rest = (byFrame.get(key) ?? []).filter((other) => other !== entry);
    if (rest.length) byFrame.set(key, rest);
    else byFrame.delete(key);
  }
}

/**
 * The waiting entries that change a frame.
 * @param {string} camera
 * @param {number} frame
 * @returns {Entry[]}
 */
export function waitingFor(camera, frame) {
  return byFrame.get(frameKey(camera, frame)) ?? [];
}

/**
 * The frames that an entry changes.
 * @param {Entry} entry
 * @returns {[string, number][]} Each once.
 */
export function framesOf(entry) {
  const seen = new Map();
  for (const { camera, frame } of entry.changes) {
    seen.set(frameKey(camera, frame), [camera, frame]);
  }
  return [...seen.values()];
}

function touched(entry) {
  return framesOf(entry).map(([camera, frame]) => frameKey(camera, frame));
}
