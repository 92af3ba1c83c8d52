// The bars of the overview: which frames are shown, and what one key does to all of them.

import { choice, classTag, obstacleChoice, pager, sizeButtons, withKey } from "../core/controls.js";
import { backAfterMouse, button, el } from "../core/dom.js";
import { reachable } from "../core/keys.js";
import { blind, chosenClass, clearClass, mission, setSetting, setting } from "../core/mission.js";
import { blindFrames, filterChoices, filterName } from "../frame/steps.js";
import { needsObstacleClass } from "../frame/suggest.js";
import { suggesting } from "./thumb.js";

/** The two bars. */
export class OverviewBar {
  /**
   * @param {object} does What the buttons do: `accept(all)`, `rest()`, `turn(step)`,
   *   `resize(step)`, `otherCamera()`.
   */
  constructor(does) {
    this.range = el("span", { class: "overview-range" });
    this.words = el("span", { class: "overview-words", role: "status" });
    this.brush = el("span", { class: "overview-brush" });
    this.accept = button("", () => does.accept(false), { class: "main" });
    this.acceptAll = button("", () => does.accept(true));
    this.rest = button("", does.rest);
    this.filter = filterChoice();
    this.element = el("div", { class: "overview-bars" },
      el("div", { class: "bar" },
        cameraButton(does.otherCamera),
        this.filter,
        pager(does.turn, this.range),
        sizeButtons(does.resize),
        needsObstacleClass()
          ? el("label", { class: "person-choice" }, "obstacle is ", obstacleChoice())
          : null,
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
    const brush = chosenClass() ? classTag(chosenClass()) : "nothing: press the key of a class";
    this.brush.replaceChildren("Painting ", brush, " · right button: unsure");
    this.words.textContent = advice(waiting, from);
  }
}

function label(element, text, key) {
  element.textContent = text;
  withKey(element, key);
}

function cameraButton(otherCamera) {
  if (Object.keys(mission.cameras).length < 2) return null;
  return button("other camera", otherCamera, { title: "the other camera (s)" });
}

function filterChoice() {
  const change = ({ target }) => setSetting("filter", target.value);
  const words = "which frames are shown";
  const options = { class: "filter", "aria-label": words, title: `${words} (/)`, on: { change } };
  return backAfterMouse(choice(filterChoices(), filterName(), options));
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
