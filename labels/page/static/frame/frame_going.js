// Which frame the view goes to: by number, by step, to the next of a kind, to the other camera.

import { onFailure } from "../core/api.js";
import { complain } from "../core/controls.js";
import { byId, endToast, say } from "../core/dom.js";
import { frames, mission } from "../core/mission.js";
import { showProgress } from "../core/progress.js";
import { noteAddress } from "../core/router.js";
import { nextBlindFrame } from "../labelling/blind_list.js";
import { filterName } from "../labelling/filters.js";
import { nextIn, nextUncertain, stepFrom } from "../labelling/steps.js";
import { askInfo, readOut, showLabels } from "./frame_display.js";
import { page, view } from "./frame_state.js";

const ADDRESS_MS = 150; // browsers refuse hundreds of address changes in a row
const READ_OUT_MS = 500; // a frame that was only passed is not read out

/** Show another frame of this camera; nothing where there is none. */
export function goTo(/** @type {?number | undefined} */ frame) {
  if (frame === null || frame === undefined || Number.isNaN(frame)) return;
  view.why = "";
  show(page().show.camera, frame);
}

/** Show a frame; `playing`: one of many that pass. */
export function show(/** @type {string} */ camera, /** @type {number} */ frame, playing = false) {
  if (!playing) page().player.stop();
  // A stroke that is not ended is of the frame on which it began.
  page().pointer.complete();
  endToast();
  showProgress(camera);
  view.cursor.collapse();
  page().show.go(camera, frame);
  page().timeline.set(camera, frame);
  noteAddressSoon(`#/label/${camera}/${frame}`);
  clearTimeout(page().timers.announce);
  page().info = "";
  const announced = byId("announcer").textContent;
  page().timers.announce = setTimeout(() => {
    // What the person did on the frame meanwhile is not read over.
    if (byId("announcer").textContent === announced) readOut();
    askInfo();
  }, READ_OUT_MS);
  showLabels();
}

function noteAddressSoon(/** @type {string} */ hash) {
  clearTimeout(page().timers.address);
  const from = location.hash;
  const note = () => {
    if (location.hash !== from) return; // a link was followed meanwhile
    page().noted = performance.now();
    noteAddress(hash);
  };
  if (performance.now() - (page().noted ?? -ADDRESS_MS) >= ADDRESS_MS) note();
  else page().timers.address = setTimeout(note, ADDRESS_MS);
}

/** Go some frames of the filter on, or back. */
export function step(/** @type {number} */ count) {
  const { camera, frame } = page().show;
  const next = stepFrom(camera, frame, count);
  if (next === null) say(count > 0 ? "No further frame (of this filter)." : "No frame before.");
  goTo(next);
}

/** Go to the next frame in one of some states; `words`: what such a frame is. */
export function jump(/** @type {string} */ states, /** @type {string} */ words, direction = 1) {
  const { camera, frame } = page().show;
  const next = nextIn(camera, frame, states, direction);
  if (next === null) say(`There is no other frame ${words}.`);
  goTo(next);
}

/** Go to the next frame without a label, or back to one. */
export function unlabelled(/** @type {number} */ direction) {
  const { camera, frame } = page().show;
  const listed = mission.blind && direction > 0 ? nextBlindFrame(camera, frame) : null;
  if (listed) {
    view.why = "";
    show(listed.camera, listed.frame);
  } else jump("us", "without a label of yours", direction);
}

export async function uncertain() {
  const { camera, frame } = page().show;
  const explain = complain("No uncertain frame is known:");
  const next = await nextUncertain(camera, frame).catch(onFailure(explain));
  if (!view.page || !next) return;
  if (next.camera === undefined || next.frame === undefined) return say(next.why);
  view.why = `Why this frame: ${next.why}`;
  show(next.camera, next.frame);
}

export function switchCamera() {
  const cameras = Object.keys(mission.cameras);
  const { camera, frame } = page().show;
  const other = cameras[(cameras.indexOf(camera) + 1) % cameras.length];
  if (other === camera) say("This mission has one camera.");
  else if (frames(other).includes(frame)) show(other, frame);
  else say(`The ${other} camera has no frame ${frame}.`);
}

/** Go to the next frame that is not done; accepting may have made this one done: it is passed. */
export function jumpToOpen() {
  const { camera, frame } = page().show;
  const filtered = filterName() !== "all";
  const next = filtered ? stepFrom(camera, frame, 1) : nextIn(camera, frame, "usp");
  if (next === null) say("All other frames are done.");
  goTo(next);
}
