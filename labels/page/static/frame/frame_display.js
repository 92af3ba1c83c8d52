// What the view of one frame shows of its state: labels, the cursor, the status line, the buttons.

import { get, onFailure } from "../core/api.js";
import { allow } from "../core/controls.js";
import { announce, el, setAttribute } from "../core/dom.js";
import { frameIndex, mission, selectedClass, setting } from "../core/mission.js";
import { hintsOf, restOf } from "../labelling/painting.js";
import { askSight, unseenOf } from "../labelling/sight.js";
import { nextIn, stepFrom } from "../labelling/steps.js";
import { suggestionFault, whyNoSuggestions } from "../labelling/suggest.js";
import { labelsOf, prefetch } from "../saving/labels.js";
import { isAway, pending, state } from "../saving/saver.js";
import { describeCell, describeFrame, describeInfo } from "./frame_bar.js";
import { isHere, page, view } from "./frame_state.js";
import { shownMask, unsaved } from "./mask_draft.js";
import { noteWords } from "./notes.js";
/** @import { SettingName, Viewport } from "../types.js" */

const PICTURE_SETTING_MS = 120;
const PENDING_MS = 300;
const SIGHT_MS = 150; // a frame that only passes is not asked about
const BEGIN = "Choose a class, then click or drag over patches.";

/** Labels of a frame are there, or changed; nulls: of all frames. */
export function labelsArrived(/** @type {?string} */ camera, /** @type {?number} */ frame) {
  if (isHere(camera, frame)) showLabels();
  else if (camera === page().show.beside && frame === page().show.frame) page().beside.update();
  else if (camera === page().show.camera && isBefore(camera, frame)) showFollowed();
}

function isBefore(/** @type {string} */ camera, /** @type {?number} */ frame) {
  return frameIndex(camera, frame ?? -1) < frameIndex(camera, page().show.frame);
}

// Suggestions follow from frames before: a whole chain of them arrives at once.
function showFollowed() {
  clearTimeout(page().timers.followed);
  page().timers.followed = setTimeout(() => view.page && showLabels());
}

export function readOut() {
  const { camera, frame, fault } = page().show;
  announce(view.why || fault || describeFrame(camera, frame, page().canvas.content.labels));
}

/** Ask when and where the frame was taken, where the mission says so. */
export async function askInfo() {
  const { camera, frame } = page().show;
  if (!mission.described || frameIndex(camera, frame) < 0) return;
  const request = get("/api/frame_info", { camera, frame });
  const said = await request.catch(onFailure(({ message }) => message));
  if (!view.page || !said || !isHere(camera, frame)) return;
  page().info = typeof said === "string" ? said : describeInfo(said);
  showStatus();
}

/** Another frame or picture is shown. */
export function showAll() {
  page().timeline.set(page().show.camera, page().show.frame);
  showLabels();
}

export function showLabels() {
  const { camera, frame, fault, ready } = page().show;
  const labels = ready && !fault ? labelsOf(camera, frame) : null;
  page().hints = labels ? hintsOf(camera, frame) : [];
  const unseen = [...unseenOf(camera, frame).keys()];
  page().canvas.set({ labels, hints: page().hints, masked: shownMask(camera), unseen });
  clearTimeout(page().timers.sight);
  if (labels) page().timers.sight = setTimeout(() => askSight(camera, frame), SIGHT_MS);
  page().beside.update();
  if (!labels && ready && !fault) prefetch(camera, [frame]);
  showCursor();
  showSaving();
  showTools();
}

export function showCursor() {
  page().canvas.set({
    cursor: view.cursor.visible ? view.cursor.cell : null,
    selection: view.cursor.spans ? view.cursor.cells : [],
  });
  showStatus();
}

/** Mark what takes long to be saved: a mark on each patch would flash with every stroke. */
export function showSaving() {
  const waits = page().canvas.content.labels?.pending ?? [];
  const cells = view.tool === "mask" ? unsaved(page().show.camera) : waits;
  clearTimeout(page().timers.pending);
  if (!pending() || state() !== "saving") page().canvas.set({ pending: cells });
  else {
    page().timers.pending = setTimeout(() => view.page?.canvas.set({ pending: cells }), PENDING_MS);
  }
  if (isAway(page().savedState) && !isAway(state())) page().show.retry();
  page().savedState = state();
}

/** The patch under the pointer, or else under the cursor; null where there is none. */
export function cellAtHand() {
  if (page().hovered >= 0) return page().hovered;
  return view.cursor.visible ? view.cursor.cell : null;
}

export function showStatus() {
  const { camera, frame, fault } = page().show;
  const cell = cellAtHand();
  const labels = page().canvas.content.labels;
  const hinted = cell !== null || fault || page().hints.some(Boolean);
  const nothing = hinted ? "" : whyNoSuggestions(camera, frame);
  const sight = cell === null && !suggestionFault(camera, frame); // the line is short
  const first = fault || describeFrame(camera, frame, labels, sight);
  const parts = labels && cell !== null ? [describeCell(cell, labels, page().hints[cell])] : [];
  if (labels) parts.push(...noteWords(labels.notes, cell));
  const begin = Object.values(mission.counts).some(Boolean) ? "" : BEGIN;
  if (!parts.length) parts.push((mission.model && nothing) || page().info || begin || nothing);
  const said = parts.join(", ");
  const hint = cell === null ? null : page().hints[cell];
  const value = hint?.model ? ` (${hint.text} from the threshold)` : "";
  const words = view.why
    ? [el("span", { class: "why", text: view.why })]
    : [el("span", { text: said, title: said + value })];
  page().status.replaceChildren(el("b", { text: first }), ...words);
  const paints = view.tool === "mask" ? "the mask" : selectedClass();
  page().element.setAttribute(
    "aria-label",
    `Patches of ${camera} frame ${frame}. Arrow keys move, Space paints ${paints}.`,
  );
}

export function showTools() {
  const { camera, frame, raw, showsBefore, blinking } = page().show;
  const proposed = page().hints.filter((hint) => hint !== null);
  const strong = proposed.filter((hint) => hint.strong).length;
  page().tools.show(view.tool === "paint" ? selectedClass() : view.tool);
  const counted = `${strong} of ${proposed.length} suggested patches sure`;
  const nothing = whyNoSuggestions(camera, frame) || "Nothing is suggested here.";
  page().mask.show();
  page().drawer.show(proposed.length ? counted : nothing);
  page().bar.show(camera, frame);
  const blink = Boolean(blinking || showsBefore);
  /** @type {Record<string, boolean>} */
  const on = { raw, blink, grid: setting("grid"), outlines: setting("outlines") };
  for (const made of page().toggles) {
    setAttribute(made, "aria-pressed", String(on[made.dataset.command ?? ""]));
  }
  const cannot = cannotDo(strong);
  for (const made of page().root.getElementsByTagName("button")) {
    const why = cannot[made.dataset.command ?? ""];
    if (why !== undefined) allow(made, why);
  }
}

/** Why commands would do nothing here; "": they would. @returns {Record<string, string>} */
export function cannotDo(/** @type {number} */ strong) {
  const { camera, frame, before, fault } = page().show;
  const labels = page().canvas.content.labels;
  const none = (/** @type {string} */ states) => nextIn(camera, frame, states) === null;
  const no = (/** @type {unknown} */ holds, /** @type {string} */ why) => (holds ? why : "");
  const done = labels && !restOf(camera, frame, page().hints).cells.length;
  const lost = no(fault, "There is no picture to label here.");
  const { blind: isBlind } = mission;
  return {
    acceptNext: lost || no(labels && !strong, "Nothing sure is suggested here."),
    rest: lost || no(done, "No patch is left for it."),
    copy: lost || no(before === null, "This is the first frame."),
    carry: lost || no(camera !== "right", "Labels go from the left camera to the right one.") ||
      no(!mission.carries, "No calibration was given: start tokt label with --calibration."),
    blink: no(before === null, "This is the first frame."),
    previous: no(stepFrom(camera, frame, -1) === null, "No frame before (of this filter)."),
    next: no(stepFrom(camera, frame, 1) === null, "No further frame (of this filter)."),
    unlabelled: no(!isBlind && none("us"), "There is no other frame without a label of yours."),
    uncertain: no(!mission.model, isBlind ? "Not while blind." : "There is no model to ask."),
  };
}

export function showChanged(/** @type {string} */ what) {
  if (what === "all") {
    page().show.retry();
    showLabels();
  }
  page().timeline.set(page().show.camera, page().show.frame);
  showStatus();
  showTools();
}

export function showSetting(/** @type {SettingName} */ name) {
  if (name === "enhance") {
    clearTimeout(page().timers.picture);
    page().timers.picture = setTimeout(() => view.page?.show.loadPicture(), PICTURE_SETTING_MS);
  }
  if (name === "filter") page().timeline.invalidate();
  showLabels();
}

/** Change what part of the frame is seen. */
export function look(/** @type {(viewport: Viewport) => void} */ change) {
  change(page().canvas.viewport);
  page().canvas.invalidate();
}
