// What a person does to the labels of the frame that is shown: strokes, keys, the cursor, copies.

import { get, onFailure } from "../core/api.js";
import { complain } from "../core/controls.js";
import { announce, focusView, say } from "../core/dom.js";
import { inView, selectClass, selectedClass, who } from "../core/mission.js";
import { cellName } from "../core/patch_grid.js";
import { MASKED } from "../labelling/cell_drawing.js";
import { putOffWords } from "../labelling/obstacle_class.js";
import { accept, dropAllCopies, paint, propose } from "../labelling/painting.js";
import { labelsOf, prefetch } from "../saving/labels.js";
import { isAway, state, whenIdle } from "../saving/saver.js";
import { describeCell } from "./frame_bar.js";
import { cannotDo, showCursor, showLabels, showStatus } from "./frame_display.js";
import { isHere, page, view } from "./frame_state.js";
import { drawMask, unsaved } from "./mask_draft.js";
/** @import { AcceptOptions, CursorMove, FrameTool, Host, How } from "../types.js" */

/** @type {Host} What the pointer's gestures do here. */
export const pointerHost = {
  canPaint: mayPaint,
  panning: () => view.space !== null,
  panned: () => void (view.space && (view.space.panned = true)),
  labelOf: (how) => {
    if (how === "unsure" && view.tool !== "mask") return "unsure";
    return view.tool === "paint" && how === "chosen" ? selectedClass() : null;
  },
  finish: (cells, how, kind) => {
    if (cells.length === 1) view.cursor.put(cells[0], false);
    else view.cursor.collapse();
    apply(cells, how === "chosen" ? view.tool : how, kind);
  },
  hover: (cell) => {
    if (cell === page().hovered) return;
    if (cell >= 0) view.why = "";
    page().hovered = cell;
    showStatus();
  },
};

/** Whether labels can be given now; where not, it is said why. */
export function mayPaint() {
  // It was meant for a frame that may be gone already.
  if (page().player.stop()) {
    say("Stopped at this frame; nothing was labelled.");
    return false;
  }
  if (page().show.paintable) return true;
  if (page().show.fault) say("There is no picture to label here; step on.", { bad: true });
  else if (page().show.showsBefore) say("This is the frame before: end the blinking first.");
  else say("The frame is not loaded yet.");
  return false;
}

/** Paint, take back, or accept what is proposed for patches; in Mask mode, mask them. */
export function apply(/** @type {number[]} */ cells, /** @type {How} */ how, kind = "paint") {
  const { camera, frame } = page().show;
  if (view.tool === "mask") drawMask(camera, cells);
  else if (!inView(camera, cells).length) say("Masked: no view. A masked patch takes no label.");
  else if (how === "confirm") {
    if (accept(camera, frame, { cells }) === 0) say(putOffWords() || "Nothing is suggested there.");
  } else if (how === "unsure") paint(camera, frame, cells, "unsure", kind);
  else paint(camera, frame, cells, how === "erase" ? null : selectedClass(), kind);
  showLabels();
  if (!view.cursor.visible) return; // painted with the mouse
  const { labels, masked } = page().canvas.content;
  const label = masked.has(cells[0]) ? MASKED : (labels?.mine[cells[0]] ?? "no label");
  const more = cells.length > 1 ? ` and ${cells.length - 1} more` : "";
  announce(`${label}: ${cellName(cells[0])}${more}`);
}

/** Accept proposals; how many, null where something is asked. @param {AcceptOptions} [options] */
export function acceptHere(options) {
  if (!mayPaint()) return 0;
  const { camera, frame } = page().show;
  return accept(camera, frame, options);
}

/** The same; `words`: if there are none. @param {string} words @param {AcceptOptions} [options] */
export function acceptOr(words, options) {
  if (acceptHere(options) === 0) say(putOffWords() || words);
}

/** Move the cursor, and read out what is there. @type {CursorMove} */
export function moveCursor(rows, cols, extend) {
  view.why = "";
  view.cursor.move(rows, cols, extend);
  page().canvas.reveal(view.cursor.cell);
  showCursor();
  const labels = page().canvas.content.labels;
  if (labels) announce(describeCell(view.cursor.cell, labels, page().hints[view.cursor.cell]));
}

/** @type {Record<FrameTool, string>} */
const TOOL_WORDS = {
  paint: "Painting gives labels.",
  erase: "Painting takes labels back.",
  confirm: "Painting accepts proposals.",
  mask: "Painting masks what is no view.",
};

export function chooseTool(/** @type {FrameTool} */ next) {
  takeTool(next);
  announce(TOOL_WORDS[next]);
}

/** What is not saved of the mask stays while something else is painted. */
function takeTool(/** @type {FrameTool} */ next) {
  const left = view.tool === "mask" && next !== "mask" && unsaved(page().show.camera).length;
  if ((view.tool === "mask") !== (next === "mask")) view.cursor.collapse();
  view.tool = next;
  if (left) say("The mask is not saved yet: the button Mask goes back to it.");
  showLabels();
}

/** A class key: chooses the class, and paints the rectangle if there is one. */
export function choose(/** @type {string} */ name) {
  takeTool("paint");
  selectClass(name);
  if (view.cursor.spans && mayPaint()) apply(view.cursor.cells, "paint", "rectangle");
  else announce(`Painting ${name}`);
  showLabels();
}

/** Give up: the stroke, else the rectangle, else Mask mode, else the copies. */
export function escape() {
  if (page().pointer.busy()) page().pointer.cancel();
  else if (view.cursor.collapse()) showCursor();
  else if (view.tool === "mask") chooseTool("paint");
  else if (!dropAllCopies(page().show.camera, page().show.frame)) {
    view.cursor.visible = false;
    showCursor();
  }
  focusView();
}

/** The space bar goes down: it paints when it comes up, unless the picture is dragged with it. */
export function pressSpace() {
  view.space = { panned: false };
}

export function releaseSpace(/** @type {Event} */ event) {
  const paints = view.space && !view.space.panned && event.type === "keyup";
  view.space = null;
  if (!paints || !view.page) return;
  if (!view.cursor.visible) moveCursor(0, 0, false);
  else if (mayPaint()) {
    apply(view.cursor.cells, view.tool, view.cursor.spans ? "rectangle" : "paint");
  }
}

export async function copyPrevious() {
  if (!mayPaint()) return;
  const { camera, frame, before } = page().show;
  if (before === null) return say("This is the first frame.");
  await prefetch(camera, [before]);
  if (!view.page || !isHere(camera, frame)) return;
  const labels = labelsOf(camera, before);
  if (!labels) return say(`Frame ${before} is not loaded yet.`, { bad: true });
  propose(camera, frame, labels.mine, `frame ${before}`, `You have no labels on frame ${before}.`);
}

/** Propose the left camera's obstacles. */
export async function carryLeft() {
  const { camera, frame } = page().show;
  const asked = who();
  const away = isAway(state()) && "The server is away: try again when it is back.";
  const refusal = away || cannotDo(0).carry;
  if (refusal) return void say(refusal);
  if (!mayPaint()) return;
  await whenIdle();
  const explain = complain("Not carried:");
  const answer = await get("/api/carried", { frame }).catch(onFailure(explain));
  if (!answer || !view.page || !isHere(camera, frame) || asked !== who()) return;
  const none = "No obstacle that you labelled in the left picture can be found in this one.";
  propose(camera, frame, answer.labels, "the left camera", none);
}
