// Parts of views' bars: classes as people see them (colour, key and name together), buttons with
// their keys, choices, pages, sizes.

import { asksObstacleClass, obstacleClass, obstacleClasses } from "../frame/suggest.js";
import { onFailure, post } from "./api.js";
import { backAfterMouse, button, el, say, setAttribute } from "./dom.js";
import { classes, colourOf, mission, signOf } from "./mission.js";

/** Patch of colour with the class's key in it, so that colour is never the only sign. */
export function swatch(name) {
  const mark = el("span", { class: "swatch", text: signOf(name), "aria-hidden": "true" });
  mark.style.backgroundColor = colourOf(name);
  return mark;
}

/** Swatch and name. */
export function classTag(name) {
  return el("span", { class: "class-tag" }, swatch(name), el("span", { text: name }));
}

/**
 * A button for each class that can be given: names only found in the store have no key.
 * @param {(name: string) => void} choose
 */
export function classButtons(choose) {
  const given = classes().filter((one) => one.key);
  return given.map(({ name, key, description }) => {
    const title = `${description || name} (key ${key})`;
    const made = button("", () => choose(name), { class: "class-button", title });
    made.append(classTag(name));
    return made;
  });
}

/**
 * What to say where there is nothing to show, and the button that leads on.
 * @returns {HTMLElement}
 */
export function nothingYet(text, words, href) {
  const onward = el("a", { class: "button main", text: words, href });
  return el("p", { class: "empty-state" }, `${text} `, onward);
}

/**
 * Buttons of commands, whose titles say what they do and by which key.
 * @param {Object<string, Function>} commands By name.
 * @param {(command: string) => string} keyFor
 * @returns {(text: string, name: string, does: string, options?: Object) => HTMLButtonElement}
 *   `options`: as `button` takes them.
 */
export function commandButtons(commands, keyFor) {
  return (text, name, does, options) => {
    const keys = { "data-key": keyFor(name), "aria-keyshortcuts": keyFor(name) };
    const made = button(text, commands[name], { "data-command": name, ...keys, ...options });
    allow(made, "", does);
    return made;
  };
}

/**
 * Let a button do what it does, or say why it cannot; it keeps the keyboard in any case.
 * @param {HTMLButtonElement} made By `commandButtons`.
 * @param {string} [why] It cannot; "" if it can.
 * @param {string} [does] What it does, where that changed.
 */
export function allow(made, why = "", does = made.dataset.does) {
  setAttribute(made, "data-does", does);
  setAttribute(made, "title", why || `${does} (${made.dataset.key})`);
  setAttribute(made, "aria-disabled", why ? "true" : null);
}

/**
 * A choice of one of several values.
 * @param {(string | [string, string])[]} values Each one, or with the words for it.
 * @param {string} chosen
 * @param {Object} options Of the element, as `el` takes them.
 * @returns {HTMLSelectElement}
 */
export function choice(values, chosen, options) {
  return el("select", options, ...optionsOf(values, chosen));
}

/**
 * The options of a `choice`.
 * @param {(string | [string, string])[]} values
 * @param {string} [chosen]
 * @returns {HTMLOptionElement[]}
 */
export function optionsOf(values, chosen) {
  return values
    .map((value) => [value].flat())
    .map(([value, text = value]) =>
      el("option", { text, value, selected: value === chosen }),
    );
}

/**
 * For a model that only knows "obstacle": which class that is in these frames.
 * @returns {HTMLSelectElement}
 */
export function obstacleChoice() {
  const change = ({ target }) => setObstacleClass(target.value);
  return backAfterMouse(choice(obstacleClasses(), obstacleClass(), { on: { change } }));
}

async function setObstacleClass(value) {
  const explain = ({ message }) => say(`Not kept: ${message}`, { bad: true, stays: true });
  // All pages hear of it as an event, this one too: events come in order, an answer may not.
  await post("/api/settings", { name: "obstacle_as", value }).catch(onFailure(explain));
}

/**
 * Ask which class the model's obstacles are, where it learnt several and nobody said it yet.
 * @returns {boolean} Whether it had to be asked.
 */
export function askObstacleClass() {
  const dialog = document.getElementById("question");
  if (!asksObstacleClass()) return false;
  if (dialog.open) return true;
  const { learnt, label } = mission.model;
  const choose = (name) => {
    dialog.close();
    setObstacleClass(name);
  };
  const answers = obstacleClasses().map((name) => {
    const count = learnt[name] ? `${learnt[name].toLocaleString("en")} patches learnt` : "not learnt";
    const made = button("", () => choose(name), { class: "class-button" });
    made.append(classTag(name), el("span", { class: "count", text: count }));
    return made;
  });
  dialog.replaceChildren(
    el("h2", { text: "What are the obstacles of this dive?" }),
    el("p", { text: `${label} tells obstacles from open water, not which ones they are.` }),
    el("div", { class: "answers" }, ...answers),
  );
  dialog.showModal();
  return true;
}

function group(name, ...children) {
  return el("span", { class: "pager", role: "group", "aria-label": name }, ...children);
}

function named(sign, name, key, run) {
  return button(sign, run, { title: `${name} (${key})`, "aria-label": name });
}

/**
 * Previous page, which it is, next page.
 * @param {(step: number) => void} turn -1 or 1.
 * @param {Node} range Says what the page shows.
 * @param {...Node} more Further buttons.
 * @returns {HTMLElement}
 */
export function pager(turn, range, ...more) {
  const back = named("‹", "previous page", "Page Up", () => turn(-1));
  const on = named("›", "next page", "Page Down", () => turn(1));
  return group("pages", back, range, on, ...more);
}

/**
 * Smaller and larger pictures.
 * @param {(step: number) => void} resize -1: smaller, 1: larger.
 * @param {...Node} more Further buttons.
 * @returns {HTMLElement}
 */
export function sizeButtons(resize, ...more) {
  const smaller = named("−", "smaller pictures", "-", () => resize(-1));
  const larger = named("+", "larger pictures", "+", () => resize(1));
  return group("size of the pictures", smaller, larger, ...more);
}
