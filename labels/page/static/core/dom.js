// Making elements without markup in strings, drawing once, telling those who listen, and saying
// things to screen readers.

/** @import { Child, Options, SayOptions, Signal, Tag } from "./types.js" */

/** Make an element.
 * @template {Tag} T @param {T} tag @param {Options<T>} [options] @param {...Child} children
 */
export function el(tag, options = {}, ...children) {
  const { text, on, ...attributes } = options;
  const node = document.createElement(tag);
  if (text !== undefined) node.textContent = text;
  for (const [name, value] of Object.entries(attributes)) setAttribute(node, name, value);
  for (const [type, listener] of Object.entries(on ?? {})) {
    node.addEventListener(type, /** @type {EventListener} */ (listener));
  }
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

/** Set, or with false, null or undefined remove, an attribute.
 * @param {?Element} node @param {string} name @param {unknown} value
 */
export function setAttribute(node, name, value) {
  if (value === false || value === null || value === undefined) return node?.removeAttribute(name);
  const text = value === true ? "" : String(value);
  // Also the same one makes the browser look at the page's style again.
  if (node?.getAttribute(name) !== text) node?.setAttribute(name, text);
}

/** Fill an element with what `draw` gives, if it shall show something else than it does.
 * @param {HTMLElement} root @param {unknown} what @param {() => Node[]} draw
 */
export function redraw(root, what, draw) {
  const text = JSON.stringify(what);
  if (root.dataset.shown === text) return;
  root.dataset.shown = text;
  root.replaceChildren(...draw());
}

/** Set an element's words, if they are others. */
export function setText(/** @type {?Element} */ node, /** @type {string} */ text) {
  if (node && node.textContent !== text) node.textContent = text;
}

/** A button that gives the keyboard back to the view after a click with the mouse, so that the next
 * Enter or Space is the view's and does not press the button again.
 * @param {string} text @param {(event: MouseEvent) => unknown} run
 * @param {Options<"button">} [attributes] @param {...Child} children
 */
export function button(text, run, attributes, ...children) {
  const made = el("button", { text, type: "button", ...attributes }, ...children);
  made.addEventListener("click", (event) => {
    if (made.ariaDisabled !== "true") run(event);
    if (event.detail > 0) focusView();
  });
  return made;
}

/** Give the keyboard back to the view when the mouse changed a control, which is returned.
 * @template {HTMLElement} C
 */
export function backAfterMouse(/** @type {C} */ control) {
  let byMouse = false;
  control.addEventListener("pointerdown", () => (byMouse = true));
  control.addEventListener("keydown", () => (byMouse = false));
  control.addEventListener("change", () => byMouse && focusView());
  return control;
}

/** Put the keyboard where the view wants it: its element with `data-home`. */
export function focusView() {
  const home = document.querySelector("#view [data-home]");
  if (home instanceof HTMLElement) home.focus({ preventScroll: true });
}

/** An element of the page that is always there. */
export function byId(/** @type {string} */ id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no element ${id}`);
  return found;
}

/** The first element of a tag inside another one, which is there. @template {Tag} T */
export function part(/** @type {Element} */ root, /** @type {T} */ tag) {
  return root.getElementsByTagName(tag)[0];
}

export function dialogById(/** @type {string} */ id) {
  return /** @type {HTMLDialogElement} */ (byId(id));
}

/** What draws onto a canvas. */
export function contextOf(/** @type {HTMLCanvasElement} */ canvas, alpha = true) {
  return /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { alpha }));
}

/** What an event happened on. */
export function targetOf(/** @type {Event} */ event) {
  return /** @type {HTMLElement} */ (event.target);
}

/** Read a text out (polite live region), without showing it. */
export function announce(/** @type {string} */ text) {
  byId("announcer").textContent = text;
}

const toast = { timer: 0, stays: false };

/** Show a sentence for some seconds, and read it out.
 * @param {string} text @param {SayOptions} [options]
 */
export function say(text, { bad = false, link = null, stays = false } = {}) {
  toast.stays = stays;
  const box = byId("toast");
  box.replaceChildren(text, link ? el("a", { text: "Go there", href: link }) : "");
  box.classList.toggle("bad", bad);
  box.classList.add("shown");
  clearTimeout(toast.timer);
  toast.timer = setTimeout(() => box.classList.remove("shown"), bad ? 8000 : 4000);
}

/** Something else is shown: take the sentence away that was about what was. */
export function endToast() {
  if (!toast.stays) byId("toast").classList.remove("shown");
}

/** A function that runs `work` once before the next drawing, however often it is called. */
export function soon(/** @type {() => unknown} */ work) {
  let waiting = false;
  return () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      work();
    });
  };
}

/** A set of listeners. @template {unknown[]} N @returns {Signal<N>} */
export function signal() {
  /** @type {Set<(...news: N) => unknown>} */
  const listeners = new Set();
  const listen = (/** @type {(...news: N) => unknown} */ listener) => {
    listeners.add(listener);
    return () => listeners.delete(listener);
  };
  const tell = (/** @type {N} */ ...news) => {
    for (const listener of [...listeners]) listener(...news);
  };
  return [listen, tell];
}
