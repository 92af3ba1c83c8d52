// The store's events that this page's own actions made: what they say is known here already.

const KEPT = 500;

const ranges = [];

/**
 * Note the events of an action that was answered.
 * @param {number} before The number of the event before its first.
 * @param {number} last
 */
export function noteOwn(before, last) {
  ranges.push({ before, last });
  if (ranges.length > KEPT) ranges.shift();
}

/** The server may be another one now, whose events count anew. */
export function forgetOwn() {
  ranges.length = 0;
}

/**
 * Whether all events after `since` up to `last` are of this page's own actions.
 * @param {number} since
 * @param {number} last
 * @returns {boolean}
 */
export function allOwn(since, last) {
  let known = since;
  for (const range of ranges) if (range.before <= known) known = Math.max(known, range.last);
  return known >= last;
}
