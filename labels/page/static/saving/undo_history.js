// What the next undo and redo will act on: the server's history, ahead of its acknowledgements.

// Heads {key, kind, camera, frame, changed}; only the ends that this page knows, newest last.
let undoable = [];
let redoable = [];
const known = new Map();

/**
 * Note an action of this page.
 * @param {Object} head
 * @param {Change[]} changes
 * @param {string} source "human" or "settled"
 */
export function noteAction(head, changes, source) {
  undoable.push(head);
  redoable = [];
  known.set(head.key, { changes, source });
}

/** Note that the newest action is being undone. */
export function noteUndo() {
  redoable.push(undoable.pop());
}

/** Note that the action undone last is being done again. */
export function noteRedo() {
  undoable.push(redoable.pop());
}

/** The action that undo acts on; undefined if none is known. */
export function nextUndo() {
  return undoable.at(-1);
}

/** The action that redo acts on; undefined if none is known. */
export function nextRedo() {
  return redoable.at(-1);
}

/**
 * Hold what is known against what the server says; only while nothing waits to be sent.
 * @param {{undo: ?Object, redo: ?Object}} heads
 */
export function takeHeads({ undo, redo }) {
  if (undoable.at(-1)?.key !== undo?.key) undoable = undo ? [undo] : [];
  if (redoable.at(-1)?.key !== redo?.key) redoable = redo ? [redo] : [];
}

/** Forget everything: an action was refused, or another person works here. */
export function forgetHistory() {
  undoable = [];
  redoable = [];
}

/**
 * What an action of this page did; null for one of an earlier page or another tab.
 * @param {string} key
 * @returns {?{changes: Change[], source: string}}
 */
export function didOf(key) {
  return known.get(key) ?? null;
}

/**
 * Forget what an action of this page did: not all of it was written.
 * @param {string} key
 */
export function forgetChanges(key) {
  known.delete(key);
}

/**
 * The changes that take an action back.
 * @param {Change[]} changes
 * @returns {Change[]}
 */
export function opposite(changes) {
  return changes.flatMap((change) => {
    const groups = new Map();
    change.cells.forEach((cell, at) => {
      const label = change.base[at];
      const group = groups.get(label) ?? { ...change, label, model: null, cells: [], base: [] };
      group.cells.push(cell);
      group.base.push(change.label);
      groups.set(label, group);
    });
    return [...groups.values()];
  });
}
