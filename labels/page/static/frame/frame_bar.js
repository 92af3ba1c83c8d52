// The bar under the picture: which frame this is, where to go, filter, and the status line; the
// strip's legend; sentences about a frame and its patches, for the status line and screen readers.

import { commandButtons, optionsOf } from "../core/controls.js";
import { el, focusView, redraw, setAttribute } from "../core/dom.js";
import { frameIndex, frameOf, frames, inView, mission, setting, stateOf } from "../core/mission.js";
import { MASKED, disagree } from "../labelling/cell_drawing.js";
import { cellName } from "../core/patch_grid.js";
import { filterChoices, filterName, filterSelect, passingFrames } from "../labelling/filters.js";
import { STATES } from "../labelling/frame_states.js";
import { unseenOf, unseenWords } from "../labelling/sight.js";
import { asksObstacleClass, kindOf } from "../labelling/suggest.js";
import { isUnsaved, shownMask } from "./mask_draft.js";
/** @import { Commands, FrameInfo, Hint, KeyFor, ShownLabels } from "../types.js" */

/** Build the bar of commands and the status line.
 * @param {Commands} commands @param {(frame: number) => void} goTo @param {KeyFor} keyFor
 * @param {HTMLElement} status
 */
export function buildBar(commands, goTo, keyFor, status) {
  const command = commandButtons(commands, keyFor);
  const number = el("input", {
    type: "number", "aria-label": "Frame number", class: "frame-number",
    // Leaving it is what changes it.
    on: { keydown: ({ key }) => key === "Enter" && focusView() },
  });
  number.addEventListener("change", () => number.value && goTo(frameOf(number.value)));
  const player = el("span", { class: "player" });
  const place = el("span", { class: "place" });
  const camera = command("", "camera", "Left or right camera");
  const both = command("Both", "beside", "Left and right side by side");
  const filter = filterSelect("Filter", "Which frames are stepped to");
  const matches = el("span", { class: "matches" });
  const legend = el("div", { class: "legend", "aria-label": "States of frames" });
  const root = el("div", { class: "frame-bar" },
    command("◀", "previous", "Frame before", { "aria-label": "Frame before" }),
    number,
    command("▶", "next", "Next frame", { "aria-label": "Next frame" }),
    place,
    player,
    camera,
    both,
    filter,
    matches,
    status,
  );
  const show = (/** @type {string} */ where, /** @type {number} */ frame) => {
    const list = frames(where);
    if (document.activeElement !== number) number.value = String(frame);
    place.textContent = `${frameIndex(where, frame) + 1} of ${list.length}`;
    camera.hidden = both.hidden = Object.keys(mission.cameras).length < 2;
    setAttribute(both, "aria-pressed", String(setting("beside")));
    camera.textContent = where;
    camera.setAttribute("aria-label", `${where} camera: change`);
    // Classes come when somebody uses them first, and go with who works here.
    const filters = filterChoices();
    redraw(filter, filters, () => optionsOf(filters));
    filter.value = filterName();
    const all = filterName() === "all";
    matches.textContent = all ? "" : `${passingFrames(where).length} frames match`;
    showLegend(legend, where);
  };
  return { root, number, player, legend, show };
}

function showLegend(/** @type {HTMLElement} */ root, /** @type {string} */ camera) {
  /** @type {Record<string, number>} */
  const counts = {};
  for (const state of mission.states[camera]) counts[state] = (counts[state] ?? 0) + 1;
  const items = () =>
    Object.entries(STATES).map(([state, { words }]) =>
      el("span", { class: "legend-item" },
        el("i", { class: `legend-mark state-${state}`, "aria-hidden": "true" }),
        `${words} ${counts[state] ?? 0}`,
      ),
    );
  redraw(root, counts, items);
}

/** A frame in words; `labels` where they are loaded; `sight`: with what is not seen.
 * @param {string} camera @param {number} frame @param {?ShownLabels} labels
 */
export function describeFrame(camera, frame, labels, sight = true) {
  const words = [`${camera} frame ${frame}`];
  if (labels) {
    const cells = inView(camera, labels.mine.keys());
    const done = cells.filter((cell) => labels.mine[cell] !== null).length;
    const hidden = labels.hidden ? `, ${labels.hidden} hidden by the mask` : "";
    words.push(`${done} of ${cells.length} labelled${hidden}`);
  }
  const state = stateOf(camera, frame);
  if (state === "x" || state === "d") words.push(STATES[state].words);
  if (labels && sight) words.push(unseenWords(camera, frame));
  return words.filter(Boolean).join(" · ");
}

/** When and where a frame was taken, in words. */
export function describeInfo(/** @type {FrameInfo} */ said) {
  const time = said.time?.replace("T", " ").replace(/(\.\d+)?Z$/, " UTC");
  /** @type {[words: string | undefined, value: unknown][]} */
  const parts = [
    [time, said.time],
    [`depth ${said.depth_m} m`, said.depth_m],
    [`altitude ${said.above_ground_m} m`, said.above_ground_m],
    [`heading ${said.heading_deg}°`, said.heading_deg],
    [`${said.latitude}°, ${said.longitude}°`, said.latitude],
  ];
  const known = parts.filter(([, value]) => value !== null && value !== undefined);
  return known.map(([words]) => words).join(", ");
}

function surety(/** @type {Hint} */ { strong, percent, said }) {
  const kind = kindOf(said ?? "") ? "an obstacle" : "clear";
  return (strong ? "sure" : "not sure") + (percent === null ? "" : ` (${kind}: ${percent} %)`);
}

function suggestedWords(/** @type {string} */ label) {
  return kindOf(label) && asksObstacleClass() ? "an obstacle" : label;
}

/** A patch in words; `hint`: what is proposed for it, or null.
 * @param {number} cell @param {ShownLabels} labels @param {?Hint | undefined} hint
 */
export function describeCell(cell, labels, hint) {
  const { camera, frame } = labels;
  const unsaved = isUnsaved(camera, cell) ? ["the mask is not saved yet"] : [];
  if (shownMask(camera).has(cell)) return [`${cellName(cell)}: ${MASKED}`, ...unsaved].join(", ");
  const words = [`${cellName(cell)}: ${labels.mine[cell] ?? "no label"}`, ...unsaved];
  const cause = unseenOf(camera, frame).get(cell);
  if (cause) words.push(`not seen: ${cause}`);
  const version = labels.models[cell];
  if (version) words.push(`accepted from ${version}`);
  if (labels.pending.has(cell)) words.push("not saved yet");
  if (hint) {
    if (hint.text === "copy") words.push(`${hint.label}, copied`);
    else if (hint.kept) words.push(`${hint.label} kept from the frame before`);
    else words.push(`model suggests ${suggestedWords(hint.label)}, ${surety(hint)}`);
    if (hint.against) words.push(`the model says ${hint.said}`);
  }
  const others = Object.entries(labels.others);
  for (const [name, all] of others) if (all[cell] !== null) words.push(`${name}: ${all[cell]}`);
  if (labels.settled[cell] !== null) words.push(`settled: ${labels.settled[cell]}`);
  else if (disagree([labels.mine[cell], ...others.map(([, all]) => all[cell])])) {
    words.push("disagreement");
  }
  return words.join(", ");
}
