// The view in which one frame is labelled: it joins the canvas, tools, bar and timeline.

import { get, onFailure } from "../core/api.js";
import { allow, commandButtons } from "../core/controls.js";
import { announce, el, endToast, focusView, say, setAttribute } from "../core/dom.js";
import { showProgress } from "../core/progress.js";
import {
  frameIndex, frames, mission, onChange, onSetting, selectClass, selectedClass, setSetting, setting,
  who,
} from "../core/mission.js";
import { addView, noteAddress } from "../core/router.js";
import { nextBlindFrame } from "../labelling/blind_list.js";
import { buildDrawer } from "../labelling/drawer.js";
import { filterName, onClassFrames, passingFrames } from "../labelling/filters.js";
import { buildToolbar } from "../labelling/toolbar.js";
import { labelsOf, onLabels, prefetch } from "../saving/labels.js";
import { onState, pending, state, whenIdle } from "../saving/saver.js";
import { Beside } from "./beside.js";
import { buildBar, describeCell, describeFrame, describeInfo } from "./frame_bar.js";
import { FrameCanvas } from "./frame_canvas.js";
import { frameKeys, keyForCommand } from "./frame_keys.js";
import { FrameShow } from "./frame_show.js";
import { listenToPointer } from "./gestures.js";
import { noteWords, writeNote } from "./notes.js";
import {
  accept, dropAllCopies, hintsOf, paint, paintRest, propose, restOf,
} from "../labelling/painting.js";
import { ARROWS, PatchCursor, cellName, cellsOfRow, rowCol } from "../core/patch_grid.js";
import { Player } from "./play.js";
import { nextIn, nextUncertain, stepFrom, whereStopped } from "../labelling/steps.js";
import { suggestionFault } from "../labelling/suggest.js";
import { Timeline } from "./timeline.js";

const ADDRESS_MS = 150; // browsers refuse hundreds of address changes in a row
const PICTURE_SETTING_MS = 120;
const READ_OUT_MS = 500; // a frame that was only passed is not read out
const PAN_STEP = 60;
const PENDING_MS = 300;
const AWAY = new Set(["offline", "refused"]);
const BEGIN = "Choose a class, then click or drag over patches.";
const TOOLS = [
  ["erase", "Take back", "Painting takes your labels back"],
  ["confirm", "Confirm", "Painting accepts single suggestions; Alt+click does at any time"],
];
const ACTIONS = [
  ["acceptNext", "Accept and next",
    "Accept the sure suggestions; go to the next frame that is not done"],
  ["rest", "", "Label all patches that have no label, but for obstacles"],
  ["copy", "Same as previous frame", "Suggest the labels of the frame before, to be accepted"],
  ["carry", "Same as left camera", "Suggest the left camera's obstacles where they are found here"],
  ["unlabelled", "Next unlabelled", "Go to the next frame without a label of yours"],
  ["uncertain", "Next uncertain", "Go where the model is least sure and has seen least"],
  ["note", "Note", "Write a note on the patch at the cursor, or on the frame"],
];
const TOGGLES = [
  ["raw", "Raw", "The picture as the camera gave it"],
  ["blink", "Blink", "Compare with the frame before"],
  ["grid", "Grid", "Lines between the patches"],
  ["outlines", "Labels", "Labels and suggestions on the picture"],
];

/** What is on the page while the view is shown; null otherwise. */
let page = null;
/** "paint", "erase" or "confirm": what the chosen tool does. */
let tool = "paint";
let why = "";
let space = null; // while the space bar is down: {panned}
const cursor = new PatchCursor();

function build(root) {
  const element = el("canvas", {
    class: "frame-canvas",
    tabindex: 0, role: "application", "data-home": true, "aria-describedby": "status",
  });
  const status = el("div", { class: "status", id: "status" });
  const strip = el("canvas", {
    class: "timeline",
    tabindex: 0, role: "slider", "aria-label": "Frame of the mission",
  });
  const second = el("canvas", { class: "other-canvas", role: "img", hidden: true });
  const pairs = Object.keys(mission.cameras).length > 1;
  const actions = ACTIONS.filter(([name]) => name !== "carry" || pairs);
  const tools = buildToolbar(commands, keyForCommand, TOOLS, actions);
  const bar = buildBar(commands, keyForCommand, status);
  const command = commandButtons(commands, keyForCommand);
  const toggles = TOGGLES.map(([name, text, does]) => command(text, name, does));
  const drawer = buildDrawer(el("div", { class: "toggles" }, ...toggles), bar.legend);
  root.replaceChildren(
    el("div", { class: "frame-view" },
      tools.root,
      el("div", { class: "stage" }, el("div", { class: "cameras" }, element, second)),
      drawer.root,
      bar.root,
      strip,
    ),
  );
  const canvas = new FrameCanvas(element);
  page = { canvas, element, status, tools, toggles, drawer, bar, hovered: -1, timers: {} };
  Object.assign(page, { root, hints: [], info: "" });
  page.show = new FrameShow(canvas, showAll);
  page.beside = new Beside(page.show, second);
  page.timeline = new Timeline(strip, goTo);
  const toggle = command("Play", "play", "One frame after the other");
  page.player = new Player(page.show, (camera, frame) => show(camera, frame, true), toggle);
  bar.root.querySelector(".player").append(page.player.root);
  page.pointer = listenToPointer(canvas, pointerHost);
  // Who comes by Tab works by keyboard: show where the cursor is.
  element.addEventListener("keyup", ({ key }) => key === "Tab" && moveCursor(0, 0, false));
  page.stops = [
    onLabels(labelsArrived),
    onChange(showChanged),
    onSetting(showSetting),
    onClassFrames(() => showSetting("filter")),
    onState(showSaving),
  ];
}

function isHere(camera, frame) {
  return camera === null || (camera === page.show.camera && frame === page.show.frame);
}

function labelsArrived(camera, frame) {
  if (isHere(camera, frame)) showLabels();
  else if (camera === page.show.beside && frame === page.show.frame) page.beside.update();
  else if (camera === page.show.camera && frame < page.show.frame) showFollowed();
}

// Suggestions follow from frames before: a whole chain of them arrives at once.
function showFollowed() {
  clearTimeout(page.timers.followed);
  page.timers.followed = setTimeout(() => page && showLabels());
}

const pointerHost = {
  canPaint: () => mayPaint(),
  panning: () => space !== null,
  panned: () => space && (space.panned = true),
  labelOf: (how) => {
    if (how === "unsure") return "unsure";
    return tool === "paint" && how === "chosen" ? selectedClass() : null;
  },
  finish: (cells, how, kind) => {
    if (cells.length === 1) cursor.put(cells[0], false);
    else cursor.collapse();
    apply(cells, how === "chosen" ? tool : how, kind);
  },
  hover: (cell) => {
    if (cell === page.hovered) return;
    if (cell >= 0) why = "";
    page.hovered = cell;
    showStatus();
  },
};

function mayPaint() {
  // It was meant for a frame that may be gone already.
  if (page.player.stop()) {
    say("Stopped at this frame; nothing was labelled.");
    return false;
  }
  if (page.show.paintable) return true;
  if (page.show.fault) say("There is no picture to label here; step on.", { bad: true });
  else if (page.show.showsBefore) say("This is the frame before: end the blinking first.");
  else say("The frame is not loaded yet.");
  return false;
}

function apply(cells, how, kind = "paint") {
  const { camera, frame } = page.show;
  if (how === "confirm") {
    if (accept(camera, frame, { cells }) === 0) say("Nothing is suggested there.");
  } else if (how === "unsure") paint(camera, frame, cells, "unsure", kind);
  else paint(camera, frame, cells, how === "erase" ? null : selectedClass(), kind);
  showLabels();
  if (!cursor.visible) return; // painted with the mouse
  const label = page.canvas.content.labels?.mine[cells[0]] ?? "no label";
  const more = cells.length > 1 ? ` and ${cells.length - 1} more` : "";
  announce(`${label}: ${cellName(cells[0])}${more}`);
}

function goTo(frame) {
  if (Number.isNaN(frame ?? NaN)) return;
  why = "";
  show(page.show.camera, frame);
}

function show(camera, frame, playing = false) {
  if (!playing) page.player.stop();
  // A stroke that is not ended is of the frame on which it began.
  page.pointer.complete();
  endToast();
  showProgress(camera);
  cursor.collapse();
  page.show.go(camera, frame);
  page.timeline.set(camera, frame);
  noteAddressSoon(`#/label/${camera}/${frame}`);
  clearTimeout(page.timers.announce);
  page.info = "";
  page.timers.announce = setTimeout(() => {
    readOut();
    askInfo();
  }, READ_OUT_MS);
  showLabels();
}

function noteAddressSoon(hash) {
  clearTimeout(page.timers.address);
  const from = location.hash;
  const note = () => {
    if (location.hash !== from) return; // a link was followed meanwhile
    page.noted = performance.now();
    noteAddress(hash);
  };
  if (performance.now() - (page.noted ?? -ADDRESS_MS) >= ADDRESS_MS) note();
  else page.timers.address = setTimeout(note, ADDRESS_MS);
}

// When and where the frame was taken, where the mission says so.
async function askInfo() {
  const { camera, frame } = page.show;
  if (!mission.described || frameIndex(camera, frame) < 0) return;
  const request = get("/api/frame_info", { camera, frame });
  const said = await request.catch(onFailure(({ message }) => ({ fault: message })));
  if (!page || !isHere(camera, frame)) return;
  page.info = said.fault ?? describeInfo(said);
  showStatus();
}

function readOut() {
  const { camera, frame, fault } = page.show;
  announce(why || fault || describeFrame(camera, frame, page.canvas.content.labels));
}

/** Another frame or picture is shown. */
function showAll() {
  page.timeline.set(page.show.camera, page.show.frame);
  showLabels();
}

function showLabels() {
  const { camera, frame, fault, ready } = page.show;
  const labels = ready && !fault ? labelsOf(camera, frame) : null;
  page.hints = labels ? hintsOf(camera, frame) : [];
  page.canvas.set({ labels, hints: page.hints });
  page.beside.update();
  if (!labels && ready && !fault) prefetch(camera, [frame]);
  showCursor();
  showSaving();
  showTools();
}

function showCursor() {
  page.canvas.set({
    cursor: cursor.visible ? cursor.cell : null,
    selection: cursor.spans ? cursor.cells : [],
  });
  showStatus();
}

// A mark on each patch would flash with every stroke: only what takes longer is marked.
function showSaving() {
  const cells = page.canvas.content.labels?.pending ?? [];
  clearTimeout(page.timers.pending);
  if (!pending() || state() !== "saving") page.canvas.set({ pending: cells });
  else {
    page.timers.pending = setTimeout(() => page?.canvas.set({ pending: cells }), PENDING_MS);
  }
  if (AWAY.has(page.savedState) && !AWAY.has(state())) page.show.retry();
  page.savedState = state();
}

/** The patch under the pointer, or else under the cursor; null where there is none. */
function cellAtHand() {
  if (page.hovered >= 0) return page.hovered;
  return cursor.visible ? cursor.cell : null;
}

function showStatus() {
  const { camera, frame, fault } = page.show;
  const cell = cellAtHand();
  const labels = page.canvas.content.labels;
  const first = fault || describeFrame(camera, frame, labels);
  const parts = labels && cell !== null ? [describeCell(cell, labels, page.hints[cell])] : [];
  if (labels) parts.push(...noteWords(labels.notes, cell));
  if (!parts.length && page.info) parts.push(page.info);
  else if (!parts.length && !Object.values(mission.counts).some(Boolean)) parts.push(BEGIN);
  const said = parts.join(", ");
  const hint = page.hints[cell];
  const value = hint?.model ? ` (decision value ${hint.text})` : "";
  const words = why
    ? [el("span", { class: "why", text: why })]
    : [el("span", { text: said, title: said + value })];
  page.status.replaceChildren(el("b", { text: first }), ...words);
  page.element.setAttribute(
    "aria-label",
    `Patches of ${camera} frame ${frame}. Arrow keys move, Space paints ${selectedClass()}.`,
  );
}

function showTools() {
  const { camera, frame, raw, showsBefore, blinking } = page.show;
  const proposed = page.hints.filter(Boolean);
  const strong = proposed.filter((hint) => hint.strong).length;
  page.tools.show(tool === "paint" ? selectedClass() : tool);
  const counted = `${strong} of ${proposed.length} suggested patches sure`;
  const nothing = "Nothing is suggested here.";
  page.drawer.show(suggestionFault(camera, frame) || (proposed.length ? counted : nothing));
  page.bar.show(camera, frame);
  const blink = Boolean(blinking || showsBefore);
  const on = { raw, blink, grid: setting("grid"), outlines: setting("outlines") };
  for (const made of page.toggles) {
    setAttribute(made, "aria-pressed", String(on[made.dataset.command]));
  }
  const cannot = cannotDo(strong);
  for (const made of page.root.querySelectorAll("[data-command]")) {
    if (made.dataset.command in cannot) allow(made, cannot[made.dataset.command]);
  }
}

/** Why commands would do nothing here; "" for those that would. */
function cannotDo(strong) {
  const { camera, frame, before, fault } = page.show;
  const labels = page.canvas.content.labels;
  const none = (states) => nextIn(camera, frame, states) === null;
  const no = (holds, why) => (holds ? why : "");
  const done = labels && !restOf(camera, frame, page.hints).cells.length;
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

function showChanged(what) {
  if (what === "all") page.show.retry();
  page.timeline.set(page.show.camera, page.show.frame);
  showStatus();
  showTools();
}

function showSetting(name) {
  if (name === "enhance") {
    clearTimeout(page.timers.picture);
    page.timers.picture = setTimeout(() => page?.show.loadPicture(), PICTURE_SETTING_MS);
  }
  if (name === "filter") page.timeline.invalidate();
  showLabels();
}

function step(count) {
  const { camera, frame } = page.show;
  const next = stepFrom(camera, frame, count);
  if (next === null) say(count > 0 ? "No further frame (of this filter)." : "No frame before.");
  goTo(next);
}

function jump(states, words, direction = 1) {
  const { camera, frame } = page.show;
  const next = nextIn(camera, frame, states, direction);
  if (next === null) say(`There is no other frame ${words}.`);
  goTo(next);
}

function unlabelled(direction) {
  const { camera, frame } = page.show;
  const listed = mission.blind && direction > 0 ? nextBlindFrame(camera, frame) : null;
  if (listed) {
    why = "";
    show(listed.camera, listed.frame);
  } else jump("us", "without a label of yours", direction);
}

async function uncertain() {
  const { camera, frame } = page.show;
  const explain = ({ message }) => say(`No uncertain frame is known: ${message}`, { bad: true });
  const next = await nextUncertain(camera, frame).catch(onFailure(explain));
  if (!page || !next) return;
  if (next.frame === undefined) return say(next.why);
  why = `Why this frame: ${next.why}`;
  show(next.camera, next.frame);
}

function switchCamera() {
  const cameras = Object.keys(mission.cameras);
  const { camera, frame } = page.show;
  const other = cameras[(cameras.indexOf(camera) + 1) % cameras.length];
  if (other === camera) say("This mission has one camera.");
  else if (frames(other).includes(frame)) show(other, frame);
  else say(`The ${other} camera has no frame ${frame}.`);
}

function acceptHere(options) {
  if (!mayPaint()) return 0;
  const { camera, frame } = page.show;
  return accept(camera, frame, options);
}

function acceptOr(words, options) {
  if (acceptHere(options) === 0) say(words);
}

function moveCursor(rows, cols, extend) {
  why = "";
  cursor.move(rows, cols, extend);
  page.canvas.reveal(cursor.cell);
  showCursor();
  const labels = page.canvas.content.labels;
  if (labels) announce(describeCell(cursor.cell, labels, page.hints[cursor.cell]));
}

function chooseTool(next) {
  tool = next;
  announce(next === "erase" ? "Painting takes labels back." : "Painting accepts proposals.");
  showTools();
}

/** A class key: chooses the class, and paints the rectangle if there is one. */
function choose(name) {
  tool = "paint";
  selectClass(name);
  if (cursor.spans && mayPaint()) apply(cursor.cells, "paint", "rectangle");
  else announce(`Painting ${name}`);
  showTools();
}

function toggle(name) {
  setSetting(name, !setting(name));
}

function arrows(act) {
  return (event) => act(...ARROWS[event.key]);
}

function escape() {
  if (page.pointer.busy()) page.pointer.cancel();
  else if (cursor.collapse()) showCursor();
  else if (!dropAllCopies(page.show.camera, page.show.frame)) {
    cursor.visible = false;
    showCursor();
  }
  focusView();
}

// The space bar paints when it comes up, unless the picture was dragged with it meanwhile.
function pressSpace(event) {
  if (!event.repeat) space = { panned: false };
}

function releaseSpace(event) {
  const paints = space && !space.panned && event.type === "keyup";
  space = null;
  if (!paints || !page) return;
  if (!cursor.visible) moveCursor(0, 0, false);
  else if (mayPaint()) apply(cursor.cells, tool, cursor.spans ? "rectangle" : "paint");
}

// From a button there is no key to come up: a press with a mouse is a tap.
function tapped(press, release) {
  const up = () => {
    release();
    showTools();
  };
  const down = (event) => {
    if (event?.repeat) return;
    press();
    if (event?.type === "click") release();
    showTools();
  };
  return Object.assign(down, { release: up });
}

const commands = {
  choose,
  goTo,
  next: () => step(1),
  previous: () => step(-1),
  next10: () => step(10),
  previous10: () => step(-10),
  first: () => goTo(passingFrames(page.show.camera)[0]),
  last: () => goTo(passingFrames(page.show.camera).at(-1)),
  unlabelled: () => unlabelled(1),
  unlabelledBack: () => unlabelled(-1),
  uncertain,
  disagreement: () => jump("x", "with a disagreement"),
  type: () => page.bar.root.querySelector(".frame-number").select(),
  camera: switchCamera,
  play: () => page.player.stop() || page.player.start(),
  paint: Object.assign(pressSpace, { release: releaseSpace }),
  move: arrows((rows, cols) => moveCursor(rows, cols, false)),
  extend: arrows((rows, cols) => moveCursor(rows, cols, true)),
  row: () => mayPaint() && apply(cellsOfRow(rowCol(cursor.cell)[0]), tool, "row"),
  rest: () => mayPaint() && paintRest(page.show.camera, page.show.frame),
  copy: copyPrevious,
  carry: carryLeft,
  accept: () => acceptOr("Nothing sure is suggested here."),
  acceptAll: () => acceptOr("No suggestions to accept here.", { all: true }),
  acceptNext: (event) => {
    if (event?.repeat || page.player.stop()) return;
    if (page.show.paintable && acceptHere() === null) return;
    jumpToOpen();
  },
  confirm: () => chooseTool("confirm"),
  erase: () => chooseTool("erase"),
  takeBack: () => mayPaint() && apply(cursor.cells, "erase"),
  note: () => {
    page.player.stop();
    const { camera, frame } = page.show;
    const labels = page.canvas.content.labels;
    if (labels) writeNote(camera, frame, cellAtHand(), labels.notes);
  },
  escape,
  raw: tapped(() => page.show.pressRaw(), () => page?.show.releaseRaw()),
  blink: tapped(() => page.show.pressBlink(), () => page?.show.releaseBlink()),
  beside: () => toggle("beside"),
  grid: () => toggle("grid"),
  outlines: () => toggle("outlines"),
  suggestions: () => toggle("suggestions"),
  zoomIn: () => look((viewport) => viewport.zoomMiddle(1.25)),
  zoomOut: () => look((viewport) => viewport.zoomMiddle(0.8)),
  fit: () => look((viewport) => viewport.fit()),
  pan: arrows((rows, cols) => look((viewport) => viewport.pan(-cols * PAN_STEP, -rows * PAN_STEP))),
};

function look(change) {
  change(page.canvas.viewport);
  page.canvas.invalidate();
}

async function copyPrevious() {
  if (!mayPaint()) return;
  const { camera, frame, before } = page.show;
  if (before === null) return say("This is the first frame.");
  await prefetch(camera, [before]);
  if (!page || !isHere(camera, frame)) return;
  const labels = labelsOf(camera, before);
  if (!labels) return say(`Frame ${before} is not loaded yet.`, { bad: true });
  propose(camera, frame, labels.mine, `frame ${before}`, `You have no labels on frame ${before}.`);
}

async function carryLeft() {
  const { camera, frame } = page.show;
  const asked = who();
  const away = AWAY.has(state()) && "The server is away: try again when it is back.";
  const refusal = away || cannotDo(0).carry;
  if (refusal) return void say(refusal);
  if (!mayPaint()) return;
  await whenIdle();
  const explain = ({ message }) => say(`Not carried: ${message}`, { bad: true });
  const answer = await get("/api/carried", { frame }).catch(onFailure(explain));
  if (!answer || !page || !isHere(camera, frame) || asked !== who()) return;
  const none = "No obstacle that you labelled in the left picture can be found in this one.";
  propose(camera, frame, answer.labels, "the left camera", none);
}

// Accepting may have made this frame done already: it is passed in any case.
function jumpToOpen() {
  const { camera, frame } = page.show;
  const filtered = filterName() !== "all";
  const next = filtered ? stepFrom(camera, frame, 1) : nextIn(camera, frame, "usp");
  if (next === null) say("All other frames are done.");
  goTo(next);
}

addView("label", {
  title: "Label",
  keys: frameKeys(commands),
  classKeys: choose,
  link: () => {
    const place = page?.show ?? last;
    return `#/label/${place ? `${place.camera}/${place.frame}` : whereStopped().join("/")}`;
  },
  show(root, [camera = "", number = "", cell]) {
    const cameras = Object.keys(mission.cameras);
    if (page) page.player.stop();
    else build(root);
    if (!camera) [camera, number] = whereStopped().map(String);
    const frame = /^\d+$/.test(number) ? Number(number) : number;
    if (!isHere(camera, frame) || page.show.frame === null) {
      why = "";
      const known = cameras.includes(camera);
      show(known ? camera : cameras[0], frame);
      if (!known) say(`This mission has no camera “${camera}”.`, { bad: true });
    }
    if (cell !== undefined && Number(cell) < mission.grid.rows * mission.grid.cols) {
      cursor.put(Number(cell), true);
      page.canvas.reveal(cursor.cell);
      announce(cellName(cursor.cell));
    }
    showCursor();
    focusView();
  },
  hide() {
    page.player.stop();
    page.pointer.complete();
    last = { camera: page.show.camera, frame: page.show.frame };
    for (const stop of page.stops) stop();
    Object.values(page.timers).forEach(clearTimeout);
    page.show.close();
    page.beside.canvas.close();
    page.timeline.close();
    page = null;
  },
});

let last = null; // {camera, frame}: where the person was, to come back to
