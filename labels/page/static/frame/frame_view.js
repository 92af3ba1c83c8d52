// The view in which one frame is labelled: it joins the canvas, tools, bar and timeline.

import { commandButtons } from "../core/controls.js";
import { announce, el, focusView, say } from "../core/dom.js";
import { frameOf, mission, onChange, onSetting } from "../core/mission.js";
import { cellName } from "../core/patch_grid.js";
import { addView } from "../core/router.js";
import { buildDrawer } from "../labelling/drawer.js";
import { onClassFrames } from "../labelling/filters.js";
import { whereStopped } from "../labelling/steps.js";
import { buildToolbar } from "../labelling/toolbar.js";
import { onLabels } from "../saving/labels.js";
import { onState } from "../saving/saver.js";
import { Beside } from "./beside.js";
import { buildBar } from "./frame_bar.js";
import { FrameCanvas } from "./frame_canvas.js";
import { commands } from "./frame_commands.js";
import {
  labelsArrived, showAll, showChanged, showCursor, showLabels, showSaving, showSetting,
} from "./frame_display.js";
import { goTo, show } from "./frame_going.js";
import { frameKeys, keyForCommand } from "./frame_keys.js";
import { choose, moveCursor, pointerHost } from "./frame_painting.js";
import { FrameShow } from "./frame_show.js";
import { isHere, page, view } from "./frame_state.js";
import { listenToPointer } from "./gestures.js";
import { buildMaskBar } from "./mask_bar.js";
import { Player } from "./play.js";
import { Timeline } from "./timeline.js";
/** @import { Tool } from "../types.js" */

/** @type {Tool[]} */
const TOOLS = [
  ["erase", "Take back", "Painting takes your labels back"],
  ["confirm", "Confirm", "Painting accepts single suggestions; Alt+click does at any time"],
  ["mask", "Mask", "Painting masks what is no view, such as a clock, in all frames of this camera"],
];
/** @type {Tool[]} */
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

function build(/** @type {HTMLElement} */ root) {
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
  const tools = buildToolbar(commands, choose, keyForCommand, TOOLS, actions);
  const bar = buildBar(commands, goTo, keyForCommand, status);
  const mask = buildMaskBar(showLabels);
  const command = commandButtons(commands, keyForCommand);
  const toggles = TOGGLES.map(([name, text, does]) => command(text, name, does));
  const drawer = buildDrawer(el("div", { class: "toggles" }, ...toggles), bar.legend);
  root.replaceChildren(
    el("div", { class: "frame-view" },
      tools.root,
      el("div", { class: "stage" }, mask.root, el("div", { class: "cameras" }, element, second)),
      drawer.root,
      bar.root,
      strip,
    ),
  );
  const canvas = new FrameCanvas(element);
  const shown = new FrameShow(canvas, showAll);
  const toggle = command("Play", "play", "One frame after the other");
  const player = new Player(shown, (camera, frame) => show(camera, frame, true), toggle);
  bar.player.append(player.root);
  // Who comes by Tab works by keyboard: show where the cursor is.
  element.addEventListener("keyup", ({ key }) => key === "Tab" && moveCursor(0, 0, false));
  view.page = {
    root, canvas, element, status, tools, mask, toggles, drawer, bar, player, show: shown,
    beside: new Beside(shown, second),
    timeline: new Timeline(strip, goTo),
    pointer: listenToPointer(canvas, pointerHost),
    hints: [], hovered: -1, info: "", timers: {},
    stops: [
      onLabels(labelsArrived),
      onChange(showChanged),
      onSetting(showSetting),
      onClassFrames(() => showSetting("filter")),
      onState(showSaving),
    ],
  };
}

addView("label", {
  title: "Label",
  keys: frameKeys(commands),
  classKeys: choose,
  link: () => {
    const place = view.page?.show ?? view.last;
    return `#/label/${place ? `${place.camera}/${place.frame}` : whereStopped().join("/")}`;
  },
  show(/** @type {HTMLElement} */ root, [camera = "", number = "", cell]) {
    const cameras = Object.keys(mission.cameras);
    if (view.page) view.page.player.stop();
    else build(root);
    if (!camera) [camera, number] = whereStopped().map(String);
    // An address may name anything: what is not there is told of by its name.
    const frame = frameOf(number);
    if (!isHere(camera, frame)) {
      view.why = "";
      const known = cameras.includes(camera);
      show(known ? camera : cameras[0], frame);
      if (!known) say(`This mission has no camera “${camera}”.`, { bad: true });
    }
    if (cell !== undefined && Number(cell) < mission.grid.rows * mission.grid.cols) {
      view.cursor.put(Number(cell), true);
      page().canvas.reveal(view.cursor.cell);
      announce(cellName(view.cursor.cell));
    }
    showCursor();
    focusView();
  },
  hide() {
    page().player.stop();
    page().pointer.complete();
    view.last = { camera: page().show.camera, frame: page().show.frame };
    for (const stop of page().stops) stop();
    for (const timer of Object.values(page().timers)) clearTimeout(timer);
    page().show.close();
    page().beside.canvas.close();
    page().timeline.close();
    view.page = null;
  },
});
