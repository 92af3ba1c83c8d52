// Parts of views' bars: classes as people see them (colour, key and name together), buttons with
// their keys, choices, pages, sizes.

import { button, el, say, setAttribute } from "./dom.js";
import { colourOf, mission, signOf } from "./mission.js";
/** @import { ApiError, Child, Choice, CommandButton, Commands, KeyFor } from "./types.js" */
/** @import { Options, SayOptions, Turn } from "./types.js" */

/** Patch of colour with the class's key in it, so that colour is never the only sign. */
export function swatch(/** @type {string} */ name) {
  const mark = el("span", { class: "swatch", text: signOf(name), "aria-hidden": "true" });
  mark.style.backgroundColor = colourOf(name);
  return mark;
}

export function classTag(/** @type {string} */ name) {
  return el("span", { class: "class-tag" }, swatch(name), el("span", { text: name }));
}

/** A button for each class that can be given: names only found in the store have no key. */
export function classButtons(/** @type {(name: string) => unknown} */ choose) {
  const given = mission.classes.filter((one) => one.key);
  return given.map(({ name, key, description }) => {
    const title = `${description || name} (key ${key})`;
    return button("", () => choose(name), { title }, classTag(name));
  });
}

/** What to do where a request fails: say why, after some words. @param {SayOptions} [options] */
export function complain(words = "", options) {
  return (/** @type {ApiError} */ { message }) =>
    say(`${words} ${message}`.trim(), { bad: true, ...options });
}

/** What to say where there is nothing to show, and the button that leads on.
 * @param {string} text @param {string} words @param {string} href
 */
export function nothingYet(text, words, href) {
  const onward = el("a", { class: "button main", text: words, href });
  return el("p", { class: "empty-state" }, `${text} `, onward);
}

/** Buttons of commands, whose titles say what they do and by which key. */
export function commandButtons(/** @type {Commands} */ commands, /** @type {KeyFor} */ keyFor) {
  /** @type {CommandButton} */
  return (text, name, does, options) => {
    const keys = { "data-key": keyFor(name), "aria-keyshortcuts": keyFor(name) };
    const made = button(text, commands[name], { "data-command": name, ...keys, ...options });
    allow(made, "", does);
    return made;
  };
}

/** Let a button of `commandButtons` do what it does, or say `why` it cannot ("": it can); it keeps
 * the keyboard in any case. `does`: what it does, where that changed.
 * @param {HTMLButtonElement} made @param {string | undefined} [does]
 */
export function allow(made, why = "", does = made.dataset.does) {
  setAttribute(made, "data-does", does);
  setAttribute(made, "title", why || `${does} (${made.dataset.key})`);
  setAttribute(made, "aria-disabled", why ? "true" : null);
}

/** A choice of one of several values; `options`: of the element, as `el` takes them.
 * @param {Choice[]} values @param {string} chosen @param {Options<"select">} [options]
 */
export function choice(values, chosen, options) {
  return el("select", options, ...optionsOf(values, chosen));
}

/** The options of a `choice`. @param {Choice[]} values @param {string} [chosen] */
export function optionsOf(values, chosen) {
  return values.map((one) => {
    const [value, text = value] = [one].flat();
    return el("option", { text, value, selected: value === chosen });
  });
}

function group(/** @type {string} */ name, /** @type {Child[]} */ ...children) {
  return el("span", { class: "pager", role: "group", "aria-label": name }, ...children);
}

/** @param {string} sign @param {string} name @param {string} key @param {() => unknown} run */
function named(sign, name, key, run) {
  return button(sign, run, { title: `${name} (${key})`, "aria-label": name });
}

/** Previous page (`turn(-1)`), what the page shows, next page (`turn(1)`), further buttons.
 * @param {(step: number) => unknown} turn @param {HTMLElement} range @param {...Child} more
 */
export function pager(turn, range, ...more) {
  const back = named("‹", "previous page", "Page Up", () => turn(-1));
  const on = named("›", "next page", "Page Down", () => turn(1));
  return group("pages", back, range, on, ...more);
}

/** Smaller pictures (`resize(-1)`), larger ones (`resize(1)`), further buttons. */
export function sizeButtons(/** @type {Turn} */ resize, /** @type {Child[]} */ ...more) {
  const smaller = named("−", "smaller pictures", "-", () => resize(-1));
  const larger = named("+", "larger pictures", "+", () => resize(1));
  return group("size of the pictures", smaller, larger, ...more);
}
