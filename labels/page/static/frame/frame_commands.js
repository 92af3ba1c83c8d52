// The commands of the view of one frame, by name: keys and buttons run them.

import { say } from "../core/dom.js";
import { mission, setSetting, setting } from "../core/mission.js";
import { ARROWS, cellsOfRow, rowCol } from "../core/patch_grid.js";
import { paintRest } from "../labelling/painting.js";
import { passingFrames } from "../labelling/filters.js";
import { cellAtHand, look, showTools } from "./frame_display.js";
import { goTo, jump, jumpToOpen, step, switchCamera, uncertain, unlabelled } from "./frame_going.js";
import {
  acceptHere, acceptOr, apply, carryLeft, chooseTool, copyPrevious, escape, mayPaint, moveCursor,
  pressSpace, releaseSpace,
} from "./frame_painting.js";
import { page, view } from "./frame_state.js";
import { saveMask } from "./mask_bar.js";
import { writeNote } from "./notes.js";
/** @import { Command, HeldCommands } from "../types.js" */

const PAN_STEP = 60;

function toggle(/** @type {"beside" | "grid" | "outlines" | "suggestions"} */ name) {
  setSetting(name, !setting(name));
}

/** @param {(rows: number, cols: number) => unknown} act @returns {Command} */
function arrows(act) {
  return (event) => event instanceof KeyboardEvent && act(...ARROWS[event.key]);
}

/** Whether a key is held and comes again. @param {Event} [event] */
function isRepeat(event) {
  return event instanceof KeyboardEvent && event.repeat;
}

/** A command of a key that is held and comes up again. */
function held(/** @type {Command} */ press, /** @type {(event: Event) => unknown} */ release) {
  return Object.assign(press, { release });
}

/** From a button there is no key to come up: a press with a mouse is a tap. */
function tapped(/** @type {() => void} */ press, /** @type {() => void} */ release) {
  const up = () => {
    release();
    showTools();
  };
  /** @type {Command} */
  const down = (event) => {
    if (isRepeat(event)) return;
    press();
    if (event?.type === "click") release();
    showTools();
  };
  return held(down, up);
}

/** What keys and buttons do, by name. @type {HeldCommands} */
export const commands = {
  next: () => step(1),
  previous: () => step(-1),
  next10: () => step(10),
  previous10: () => step(-10),
  first: () => goTo(passingFrames(page().show.camera)[0]),
  last: () => goTo(passingFrames(page().show.camera).at(-1)),
  unlabelled: () => unlabelled(1),
  unlabelledBack: () => unlabelled(-1),
  uncertain,
  disagreement: () => jump("x", "with a disagreement"),
  type: () => page().bar.number.select(),
  camera: switchCamera,
  play: () => page().player.stop() || page().player.start(),
  paint: held((event) => isRepeat(event) || pressSpace(), releaseSpace),
  move: arrows((rows, cols) => moveCursor(rows, cols, false)),
  extend: arrows((rows, cols) => moveCursor(rows, cols, true)),
  row: () => mayPaint() && apply(cellsOfRow(rowCol(view.cursor.cell)[0]), view.tool, "row"),
  rest: () => mayPaint() && paintRest(page().show.camera, page().show.frame),
  copy: copyPrevious,
  carry: carryLeft,
  accept: () => {
    if (view.tool === "mask") saveMask();
    else acceptOr("Nothing sure is suggested here.");
  },
  acceptAll: () => acceptOr("No suggestions to accept here.", { all: true }),
  acceptNext: (event) => {
    if (isRepeat(event) || page().player.stop()) return;
    if (page().show.paintable && acceptHere() === null) return;
    jumpToOpen();
  },
  confirm: () => chooseTool("confirm"),
  erase: () => chooseTool("erase"),
  mask: () => chooseTool(view.tool === "mask" ? "paint" : "mask"),
  takeBack: () => mayPaint() && apply(view.cursor.cells, "erase"),
  note: () => {
    page().player.stop();
    const { camera, frame } = page().show;
    const labels = page().canvas.content.labels;
    if (labels) writeNote(camera, frame, cellAtHand(), labels.notes);
  },
  escape,
  raw: tapped(() => page().show.pressRaw(), () => view.page?.show.releaseRaw()),
  blink: tapped(() => page().show.pressBlink(), () => view.page?.show.releaseBlink()),
  beside: () => toggle("beside"),
  grid: () => toggle("grid"),
  outlines: () => toggle("outlines"),
  suggestions: () =>
    mission.model ? toggle("suggestions") : say("There is no model yet, whose suggestions to hide."),
  zoomIn: () => look((viewport) => viewport.zoomMiddle(1.25)),
  zoomOut: () => look((viewport) => viewport.zoomMiddle(0.8)),
  fit: () => look((viewport) => viewport.fit()),
  pan: arrows((rows, cols) => look((viewport) => viewport.pan(-cols * PAN_STEP, -rows * PAN_STEP))),
};
