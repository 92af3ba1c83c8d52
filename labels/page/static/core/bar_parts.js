// Groups of buttons that several views have in their bars.

import { button, el } from "./dom.js";

function group(name, ...children) {
  return el("span", { class: "pager", attrs: { role: "group", "aria-label": name } }, ...children);
}

function named(sign, name, key, run) {
  return button(sign, run, { title: `${name} (${key})`, attrs: { "aria-label": name } });
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
