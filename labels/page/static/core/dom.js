// Making elements without markup in strings, drawing once, telling those who listen, and saying
// things to screen readers.

/**
 * Make an element. `text`: its words; `on`: its listeners by event. All other options are
 * attributes: true gives an empty one, false, null and undefined give none. Null and undefined
 * among the children (nodes and strings) are left out.
 */
export function el(tag, { text, on = {}, ...attributes } = {}, ...children) {
  const node = document.createElement(tag);
  if (text !== undefined) node.textContent = text;
  for (const [name, value] of Object.entries(attributes)) setAttribute(node, name, value);
  for (const [type, listener] of Object.entries(on)) node.addEventListener(type, listener);
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

/** Set, or with false, null or undefined remove, an attribute. */
export function setAttribute(node, name, value) {
  if (value === false || value === null || value === undefined) return node.removeAttribute(name);
  const text = value === true ? "" : String(value);
  // Also the same one makes the browser look at the page's style again.
  if (node.getAttribute(name) !== text) node.setAttribute(name, text);
}

/** Fill an element with what `draw` gives, if it shall show something else than it does. */
export function redraw(root, what, draw) {
  const text = JSON.stringify(what);
  if (root.dataset.shown === text) return;
  root.dataset.shown = text;
  root.replaceChildren(...draw());
}

/** Set an element's words, if they are others. */
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/**
 * A button that gives the keyboard back to the view after a click with the mouse, so that the
 * next Enter or Space is the view's and does not press the button again.
 */
export function button(text, run, attributes, ...children) {
  const click = (event) => {
    if (event.currentTarget.ariaDisabled !== "true") run(event);
    if (event.detail > 0) focusView();
  };
  return el("button", { text, type: "button", on: { click }, ...attributes }, ...children);
}

/**
 * Give the keyboard back to the view when a control was changed with the mouse, so that the next
 * key is the view's; who changes it with the keyboard stays on it. Returns the control.
 */
export function backAfterMouse(control) {
  let byMouse = false;
  control.addEventListener("pointerdown", () => (byMouse = true));
  control.addEventListener("keydown", () => (byMouse = false));
  control.addEventListener("change", () => byMouse && focusView());
  return control;
}

/** Put the keyboard where the view wants it: its element with `data-home`. */
export function focusView() {
  document.querySelector("#view [data-home]")?.focus({ preventScroll: true });
}

/** Read a text out (polite live region), without showing it. */
export function announce(text) {
  document.getElementById("announcer").textContent = text;
}

let toastTimer = 0;
let toastStays = false;

/**
 * Show a sentence for some seconds, and read it out. `bad`: something was not done; `link`: the
 * address of the place that it is about; `stays`: it is not of what is shown.
 */
export function say(text, { bad = false, link = null, stays = false } = {}) {
  toastStays = stays;
  const toast = document.getElementById("toast");
  toast.replaceChildren(text, link ? el("a", { text: "Go there", href: link }) : "");
  toast.classList.toggle("bad", bad);
  toast.classList.add("shown");
  clearTimeout(toastTimer);
  toastTimer = setTimeout(() => toast.classList.remove("shown"), bad ? 8000 : 4000);
}

/** Something else is shown: take the sentence away that was about what was. */
export function endToast() {
  if (!toastStays) document.getElementById("toast").classList.remove("shown");
}

/** A function that runs `work` once before the next drawing, however often it is called. */
export function soon(work) {
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

/**
 * A set of listeners: [what adds a listener, and returns what takes it away again; what tells all
 * of them].
 */
export function signal() {
  const listeners = new Set();
  const listen = (listener) => {
    listeners.add(listener);
    return () => listeners.delete(listener);
  };
  const tell = (...news) => {
    for (const listener of [...listeners]) listener(...news);
  };
  return [listen, tell];
}
