// The labels of frames: what the server said last, with the actions that still wait on top.

import { get, onFailure } from "../core/api.js";
import { signal } from "../core/dom.js";
import { framesOf, frameKey, waitingFor } from "./outbox.js";
import { maskedCells, mission, onChange, onReload, who } from "../core/mission.js";
/** @import { ActionAnswer, Change, Entry, FrameLabels, Holds, KnownLabels } from "../types.js" */
/** @import { OwnLabels, Place, ShownLabels, Signal } from "../types.js" */

const MAX_A_REQUEST = 60;
const KEPT = 400;

/** What is known of frames, each by its key. @type {KnownLabels} */
const known = {
  truths: new Map(),
  stale: new Map(),
  loading: new Map(),
  wanted: new Map(),
  generation: 0,
  modelDone: 0,
};

/** Frames whose labels changed; nulls: all. @type {Signal<[camera: ?string, frame: ?number]>} */
export const [onLabels, labelsChanged] = signal();

/** The labels of a frame as they shall be shown; null: not loaded. */
export function labelsOf(/** @type {string} */ camera, /** @type {number} */ frame) {
  const key = frameKey(camera, frame);
  const truth = known.truths.get(key);
  if (!truth) return null;
  known.truths.delete(key);
  known.truths.set(key, truth);
  const waits = waitingFor(camera, frame);
  /** @type {ShownLabels} */
  const shown = { ...truth, pending: new Set() };
  if (!waits.length) return shown;
  Object.assign(shown, copied(truth));
  for (const entry of waits) {
    for (const change of entry.changes) {
      if (change.camera !== camera || change.frame !== frame) continue;
      applyChange(shown, entry, change, () => true);
      if (entry.who === who()) for (const cell of change.cells) shown.pending.add(cell);
    }
  }
  return shown;
}

/** What `applyChange` may change of labels. */
function copied(/** @type {FrameLabels} */ { mine, settled, models }) {
  return { mine: [...mine], settled: [...settled], models: { ...models } };
}

/** @param {OwnLabels} labels @param {Entry} entry @param {Change} change @param {Holds} holds */
function applyChange(labels, entry, change, holds) {
  if (entry.who !== who()) return;
  const masked = maskedCells(change.camera);
  for (const cell of change.cells) {
    if (!holds(cell) || masked.has(cell)) continue;
    if (entry.source === "settled") {
      labels.settled[cell] = change.label;
      continue;
    }
    labels.mine[cell] = change.label;
    if (change.model) labels.models[cell] = change.model;
    else delete labels.models[cell];
  }
}

/** Load the labels of frames that are not there yet; done when they are (or could not be had). */
export function prefetch(/** @type {string} */ camera, /** @type {number[]} */ frames) {
  const waits = frames.map((frame) => {
    const key = frameKey(camera, frame);
    if (known.truths.has(key) && !known.stale.has(key)) return null;
    return known.loading.get(key) ?? want(key, camera, frame);
  });
  return Promise.all(waits);
}

/** Load the labels of the frames in which patches lie. */
export function prefetchOf(/** @type {Place[]} */ patches) {
  for (const [camera, some] of Map.groupBy(patches, (patch) => patch.camera)) {
    prefetch(camera, [...new Set(some.map((patch) => patch.frame))]);
  }
}

// Frames asked for in one turn of the event loop travel in one request.
/** @param {string} key @param {string} camera @param {number} frame */
function want(key, camera, frame) {
  if (!known.wanted.size) queueMicrotask(fetchWanted);
  const batch = known.wanted.get(camera) ?? { frames: [], ...Promise.withResolvers() };
  batch.frames.push(frame);
  known.wanted.set(camera, batch);
  known.loading.set(key, batch.promise);
  return batch.promise;
}

function fetchWanted() {
  const batches = known.wanted;
  known.wanted = new Map();
  for (const [camera, batch] of batches) {
    const parts = [];
    while (batch.frames.length) {
      parts.push(fetchFrames(camera, batch.frames.splice(0, MAX_A_REQUEST)));
    }
    Promise.all(parts).then(batch.resolve);
  }
}

async function fetchFrames(/** @type {string} */ camera, /** @type {number[]} */ frames) {
  const asked = known.generation;
  const request = get("/api/labels", {
    camera,
    frames: frames.join(","),
    v: mission.pictures,
    suggest: mission.model && !mission.blind ? 1 : null,
  });
  // Before they are taken in: one that is out of date already is asked for again.
  const forget = () => frames.forEach((frame) => known.loading.delete(frameKey(camera, frame)));
  // Not loaded: the frame says so, and it is asked for again when the server is back.
  const answer = await request.catch(onFailure()).finally(forget);
  if (!answer || asked !== known.generation) return;
  for (const labels of answer.frames) takeTruth(answer.event, labels);
}

function takeTruth(/** @type {number} */ event, /** @type {FrameLabels} */ labels) {
  const { camera, frame } = labels;
  const key = frameKey(camera, frame);
  const truth = known.truths.get(key);
  const needed = Math.max(truth?.event ?? 0, known.stale.get(key) ?? 0);
  if (needed > event) {
    // Read before our last action, or what we heard of, was written: ask again.
    labelsAreStale([[camera, frame]], needed);
    return;
  }
  known.truths.delete(key);
  known.truths.set(key, { ...labels, event });
  known.stale.delete(key);
  for (const oldest of known.truths.keys()) {
    if (known.truths.size <= KEPT) break;
    known.truths.delete(oldest);
  }
  labelsChanged(camera, frame);
}

/** Take an acknowledged action into what the server said. */
export function acknowledge(/** @type {Entry} */ entry, /** @type {ActionAnswer} */ answer) {
  const refused = new Map(
    (answer.conflicts ?? []).map((c) => [`${frameKey(c.camera, c.frame)}/${c.cell}`, c.theirs]),
  );
  for (const change of entry.changes) {
    const key = frameKey(change.camera, change.frame);
    const truth = known.truths.get(key);
    if (!truth) continue;
    const next = { ...truth, ...copied(truth), event: Math.max(truth.event, answer.event) };
    applyChange(next, entry, change, (cell) => !refused.has(`${key}/${cell}`));
    known.truths.set(key, next);
  }
  // Written by an earlier try: somebody may have said more since.
  const reread = refused.size || answer.repeated ? framesOf(entry) : [];
  if (entry.path !== "/api/actions") reread.push(...(answer.frames ?? []));
  labelsAreStale(reread, answer.event);
}

/** Ask anew for frames, [camera, frame], that somebody else changed; those not in memory are asked
 * for when shown. Answers from before `event` do not do.
 */
export function labelsAreStale(/** @type {[string, number][]} */ frames, event = 0) {
  const here = frames.filter(([camera, frame]) => {
    const key = frameKey(camera, frame);
    // What is on its way may have been read before.
    if (!known.truths.has(key) && !known.loading.has(key)) return false;
    known.stale.set(key, Math.max(event, known.stale.get(key) ?? 0));
    return true;
  });
  prefetchOf(here.map(([camera, frame]) => ({ camera, frame })));
}

// Another person works here: nothing that was read is for their eyes or counts for them.
function forgetLabels() {
  known.generation += 1;
  known.truths.clear();
  known.stale.clear();
  known.loading.clear();
  known.wanted = new Map();
  labelsChanged(null, null);
}

onReload(forgetLabels);

onChange((what) => {
  // The server was away: what happened meanwhile is not known, and its events may count anew.
  if (what === "all") {
    known.stale.clear();
    for (const [key, truth] of known.truths) {
      truth.event = 0;
      known.stale.set(key, 0);
    }
  }
  // Suggestions that were not there when a frame was read are there at the end.
  const done = mission.model?.done ?? 0;
  if (what === "status" && done !== known.modelDone && done === mission.model?.total) {
    const without = [...known.truths.values()].filter(({ suggestions }) => !suggestions);
    labelsAreStale(without.map(({ camera, frame }) => [camera, frame]));
  }
  known.modelDone = done;
});
