// Parts of views' bars: classes as people see them (colour, key and name together), buttons with
// their keys, choices, pages, sizes.

import { obstacleClass } from "../frame/suggest.js";
import { backAfterMouse, button, el } from "./dom.js";
import { classes, colourOf, setSetting, signOf } from "./mission.js";

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
 * A control with its key behind what it says.
 * @template {HTMLElement} T
 * @param {T} control
 * @param {string} key
 * @returns {T}
 */
export function withKey(control, key) {
  control.append(" ", el("kbd", { text: key }));
  return control;
}

/**
 * Buttons of commands, each with its key.
 * @param {Object<string, Function>} commands By name.
 * @param {(command: string) => string} keyFor
 * @returns {(text: string, name: string, options?: Object) => HTMLButtonElement} `options`: as
 *   `button` takes them.
 */
export function commandButtons(commands, keyFor) {
  return (text, name, options) => withKey(button(text, commands[name], options), keyFor(name));
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
  const obstacles = classes().filter((known) => known.obstacle);
  const change = ({ target }) => setSetting("obstacleAs", target.value);
  const names = obstacles.map(({ name }) => name);
  return backAfterMouse(choice(names, obstacleClass(), { on: { change } }));
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
