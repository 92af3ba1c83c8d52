// The bars of the overview: which frames are shown, and what one key does to all of them.

import { pager, sizeButtons } from "../core/bar_parts.js";
import { blindFrames } from "../sheets/blind_list.js";
import { classTag } from "../core/class_buttons.js";
import { backAfterMouse, button, el } from "../core/dom.js";
import { reachable } from "../core/keys.js";
import {
  blind,
  classes,
  clearClass,
  mission,
  selectedClass,
  setSetting,
  setting,
} from "../core/mission.js";
import { filterChoices, filterName } from "../frame/steps.js";
import { needsObstacleClass, obstacleClass } from "../frame/suggest.js";
import { suggesting } from "./thumb.js";

/** The two bars. */
export class OverviewBar {
  /**
   * @param {object} does What the buttons do: `accept(all)`, `rest()`, `turn(step)`,
   *   `resize(step)`, `otherCamera()`.
   */
  constructor(does) {
    this.range = el("span", { class: "overview-range" });
    this.words = el("span", { class: "overview-words", attrs: { role: "status" } });
    this.brush = el("span", { class: "overview-brush" });
    this.accept = button("", () => does.accept(false), { class: "main" });
    this.acceptAll = button("", () => does.accept(true));
    this.rest = button("", does.rest);
    this.filter = filterChoice();
    this.element = el(
      "div",
      { class: "overview-bars" },
      el(
        "div",
        { class: "bar" },
        cameraButton(does.otherCamera),
        this.filter,
        pager(does.turn, this.range),
        sizeButtons(does.resize),
        obstacleChoice(),
        this.words,
      ),
      el("div", { class: "bar" }, this.accept, this.acceptAll, this.rest, this.brush),
    );
  }

  /** Choose the next filter of the list. */
  nextFilter() {
    const { filter } = this;
    filter.selectedIndex = (filter.selectedIndex + 1) % filter.options.length;
    setSetting("filter", filter.value);
  }

  /**
   * Say what is shown and what the buttons would do.
   * @param {string} range Which frames.
   * @param {{strong: number, weak: number, open: number, waiting: number}} tally
   */
  show(range, { strong, weak, open, waiting }) {
    this.range.textContent = range;
    const from = setting("confidence").toFixed(1);
    label(this.accept, `Accept ${strong} confident`, "Enter");
    this.accept.title = `confident: from a value of ${from} on (keys < and > change that)`;
    label(this.acceptAll, `Accept all ${strong + weak} suggested`, "Shift+Enter");
    label(this.rest, `${open} without label are ${clearClass()}`, reachable("o"));
    this.brush.replaceChildren("Painting ", classTag(selectedClass()), " · right button: unsure");
    this.words.textContent = advice(waiting, from);
  }
}

function label(element, text, key) {
  element.replaceChildren(`${text} `, el("kbd", { text: key }));
}

function cameraButton(otherCamera) {
  if (Object.keys(mission.cameras).length < 2) return null;
  return button("other camera", otherCamera, { title: "the other camera (s)" });
}

function filterChoice() {
  const options = filterChoices().map(([name, words]) => option(name, words, name === filterName()));
  const choose = ({ target }) => setSetting("filter", target.value);
  const attrs = { class: "filter", "aria-label": "which frames are shown", title: "which frames are shown (/)" };
  return backAfterMouse(el("select", { attrs, on: { change: choose } }, ...options));
}

/** A model that only knows "obstacle": which class that is in these frames. */
function obstacleChoice() {
  if (!needsObstacleClass()) return null;
  const options = classes()
    .filter((known) => known.obstacle)
    .map(({ name }) => option(name, name, name === obstacleClass()));
  const choose = ({ target }) => setSetting("obstacleAs", target.value);
  return el(
    "label",
    { class: "person-choice" },
    "obstacle is ",
    backAfterMouse(el("select", { on: { change: choose } }, ...options)),
  );
}

function option(value, text, selected) {
  return el("option", { text, attrs: { value, selected } });
}

function advice(waiting, from) {
  if (blind()) {
    const listed = blindFrames().length > 0;
    const only = listed ? ` Only the frames that ${setting("blindOf")} labelled.` : "";
    return `Blind: no suggestions, and nothing of what others said.${only}`;
  }
  if (!mission.model) return "No model: start with --model to get suggestions.";
  if (!suggesting()) return "Suggestions are switched off.";
  if (waiting > 0) return `${waiting} frames are still being loaded.`;
  return `Dashed: confident, from ${from} on. Dotted with “?”: not.`;
}
