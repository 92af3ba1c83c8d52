// The column of tools: classes with their keys and counts, what to do with the frame, the
// picture, the model.

import { commandButtons, obstacleChoice } from "../core/controls.js";
import { backAfterMouse, button, el, setAttribute } from "../core/dom.js";
import {
  classes, colourOf, mission, selectedClass, setSetting, setting, signOf,
} from "../core/mission.js";
import { needsObstacleClass, obstacleClass } from "./suggest.js";

/**
 * @typedef {Object} Tools
 * @property {HTMLElement} root
 * @property {(tool: string) => void} show  Bring everything up to date; the tool in use.
 */

/**
 * Build the column.
 * @param {Object<string, Function>} commands The frame view's, by name.
 * @param {(command: string) => string} keyFor
 * @returns {Tools}
 */
export function buildTools(commands, keyFor) {
  const painters = el("div", {
    class: "painters",
    role: "group", "aria-label": "What painting puts on patches",
  });
  const command = commandButtons(commands, keyFor);
  const model = el("div", { class: "model" });
  const root = el("aside", { class: "tools", "aria-label": "Tools" },
    painters,
    frameCommands(command),
    pictureTools(command),
    model,
  );
  const show = (tool, summary) => {
    showPainters(painters, commands, keyFor, tool);
    showModel(model, summary);
  };
  return { root, show };
}

function showPainters(root, commands, keyFor, tool) {
  const rows = classes().map((known) => ({
    name: known.name,
    key: known.key,
    on: tool === "paint" && selectedClass() === known.name,
    colour: colourOf(known.name),
    title: known.description || (known.name === "unsure" ? "Looked at, cannot be told." : ""),
    count: mission.counts[known.name] ?? 0,
    run: () => commands.choose(known.name),
    // A name that labels carry and the taxonomy does not have: shown, not given.
    disabled: known.obstacle === null && known.name !== "unsure",
  }));
  rows.push(
    { name: "take back", key: keyFor("erase"), on: tool === "erase", run: commands.erase,
      title: "Painting takes your labels back." },
    { name: "confirm", key: keyFor("confirm"), on: tool === "confirm", run: commands.confirm,
      title: "Painting accepts single suggestions and copies; Alt+click does at any time." },
  );
  const text = JSON.stringify(rows);
  if (root.dataset.shown === text) return;
  root.dataset.shown = text;
  const focused = [...root.children].indexOf(document.activeElement);
  root.replaceChildren(...rows.map(painterButton));
  root.children[focused]?.focus();
}

function painterButton({ name, key, on, colour, title, count, run, disabled }) {
  const label = count === undefined ? name : `${name}, ${count} patches`;
  const attributes = {
    class: "painter", title, "aria-pressed": String(on), disabled, "aria-label": label,
  };
  const row = button("", run, attributes);
  const swatch = el("span", { class: "sign", text: colour ? signOf(name) : "" });
  if (colour) swatch.style.borderColor = colour;
  row.append(
    el("kbd", { text: key ?? "" }),
    swatch,
    el("span", { class: "name", text: name }),
    el("span", { class: "count", text: count === undefined ? "" : String(count) }),
  );
  return row;
}

function frameCommands(command) {
  const make = (text, name, title) => command(text, name, { title });
  return el("div", { class: "commands" },
    make("Rest is clear", "rest", "Patches without a label get the class that is no obstacle."),
    make("Copy previous", "copy", "Labels of the frame before, to be accepted."),
    make("Accept", "accept", "Accept the copies and the confident suggestions."),
    make("Accept, next", "acceptNext", "Accept them and go to the next frame that is not done."),
    make("Note", "note", "Write a note on the patch at the cursor, or on the frame."),
  );
}

function pictureTools(command) {
  const toggle = (text, name) => command(text, name, { "data-toggle": name });
  const toggles = [
    toggle("Raw", "raw"),
    toggle("Blink", "blink"),
    toggle("Grid", "grid"),
    toggle("Labels", "outlines"),
  ];
  return el("div", { class: "picture-tools" },
    slider("enhance", "Contrast", 0, 100, 5, (value) => `${value}`),
    slider("tint", "Tint of labels", 0, 60, 5, (value) => `${value}`),
    el("div", { class: "toggles" }, ...toggles),
  );
}

/** A slider of a setting, with its value. */
function slider(name, label, min, max, step, words) {
  const output = el("output", { text: words(setting(name)) });
  const input = el("input", {
    type: "range", min, max, step, value: setting(name), "data-setting": name,
    on: {
      input: () => {
        setSetting(name, Number(input.value));
        output.textContent = words(setting(name));
      },
    },
  });
  const named = el("span", { text: label });
  return el("label", { class: "slider" }, named, backAfterMouse(input), output);
}

/**
 * Bring sliders and toggles up to date with settings that keys changed.
 * @param {HTMLElement} root
 * @param {Object<string, boolean>} toggles
 */
export function showSettings(root, toggles) {
  for (const input of root.querySelectorAll("[data-setting]")) {
    const value = String(setting(input.dataset.setting));
    if (input.value === value) continue;
    input.value = value;
    input.parentElement.querySelector("output").textContent = value;
  }
  for (const [name, on] of Object.entries(toggles)) {
    setAttribute(root.querySelector(`[data-toggle="${name}"]`), "aria-pressed", String(on));
  }
}

function showModel(root, { confident, proposed, fault }) {
  const { model } = mission;
  root.hidden = !model;
  if (!model) return;
  if (!root.children.length) root.append(...modelParts());
  const progress = model.done < model.total ? ` · ${model.done}/${model.total} frames` : "";
  root.querySelector(".model-name").textContent = `${model.label}${progress}`;
  const counted = proposed
    ? `${confident} of ${proposed} open patches confident`
    : "nothing proposed here";
  root.querySelector(".model-said").textContent = fault || counted;
  const select = root.querySelector("select");
  select.parentElement.hidden = !needsObstacleClass();
  if (select.value !== obstacleClass()) select.value = obstacleClass();
}

function modelParts() {
  const select = obstacleChoice();
  const shown = el("input", {
    type: "checkbox", checked: setting("suggestions"),
    on: { change: () => setSetting("suggestions", shown.checked) },
  });
  return [
    el("label", { class: "check" },
      backAfterMouse(shown), " Suggestions of ", el("b", { class: "model-name" }),
    ),
    slider("confidence", "Confident from", 0, 3, 0.05, (value) => value.toFixed(2)),
    slider("follow", "Keep from before", 0, 5, 0.25, (value) => (value ? value.toFixed(2) : "off")),
    el("label", { class: "pick" }, el("span", { text: "Obstacle is" }), select),
    el("p", { class: "model-said" }),
  ];
}
