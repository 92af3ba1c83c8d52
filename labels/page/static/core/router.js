// The page's address says what is shown: #/label/left/17. Views register under the first word.

import { el, say, setAttribute } from "./dom.js";
import { setViewKeys } from "./keys.js";

const views = new Map();
let current = null;
let first = "";

/**
 * Register a view. `under`: the view whose link stands for it.
 * @param {string} name First word of its addresses.
 * @param {{title: string, under?: string, show: Function, hide: Function, keys?: KeyEntry[],
 *   classKeys?: Function, link?: () => string}} view
 *   `show(root, parts)` is called with the address's further words, and again when they change
 *   while the view stays; `root` is emptied when another view takes over.
 */
export function addView(name, view) {
  views.set(name, view);
}

/**
 * Register a view whose module is loaded when it is first shown, and registers itself then.
 * `title`: of its link, "" for a view that others lead to. `load(again)`: `again` ends the module's
 * address, as browsers do not fetch an address again that could not be had.
 */
export function addLaterView(name, title, load) {
  views.set(name, { title, load });
}

/** Load the views that nobody has shown yet, so that they are there when the server is not. */
export async function loadLaterViews() {
  for (const { load } of [...views.values()]) {
    try {
      await load?.("");
    } catch {
      return; // Loaded, or complained of, when it is shown.
    }
  }
}

/** Go to an address, "#/label/left/17"; `replace`: no new entry for the Back button. */
export function go(hash, { replace = false } = {}) {
  if (hash !== location.hash) history[replace ? "replaceState" : "pushState"](null, "", hash);
  route();
}

/** Show another address without going anywhere: what is shown moved on by itself. */
export function noteAddress(hash) {
  if (hash !== location.hash) history.replaceState(null, "", hash);
}

/** The name of the view that is shown. */
export function currentView() {
  return current;
}

/** Begin to follow the address; `home` stands for an empty or unknown one. */
export function startRouting(home) {
  first = home;
  window.addEventListener("popstate", route);
  buildLinks();
  route();
}

function route() {
  const [name, ...parts] = location.hash.replace(/^#\/?/, "").split("/").map(decode);
  if (!views.has(name)) {
    noteAddress(first);
    return void (views.has(first.split("/")[1]) && route());
  }
  const view = views.get(name);
  if (view.load) return void loadView(name, view.load);
  const root = document.getElementById("view");
  if (name !== current) {
    if (current) views.get(current).hide();
    root.replaceChildren();
    current = name;
    setViewKeys(view);
    markLink();
  }
  view.show(root, parts);
}

let failures = 0;

async function loadView(name, load) {
  try {
    await load(failures ? `?again=${failures}` : "");
  } catch (error) {
    failures += 1;
    if (!(error instanceof TypeError)) throw error;
    const words = "This view cannot be loaded now; choose it again when the server answers.";
    return say(words, { bad: true });
  }
  // Another address may have been asked for meanwhile.
  if (location.hash.startsWith(`#/${name}`)) route();
}

function decode(word) {
  try {
    return decodeURIComponent(word);
  } catch {
    return word;
  }
}

function buildLinks() {
  const linked = [...views].filter(([, view]) => view.title);
  const links = linked.map(([name, view]) => {
    const follow = (event) => {
      event.preventDefault();
      go(views.get(name).link?.() ?? `#/${name}`);
    };
    const on = { click: follow };
    return el("a", { text: view.title, href: `#/${name}`, "data-view": name, on });
  });
  document.getElementById("views").replaceChildren(...links);
}

function markLink() {
  const shown = views.get(current).under ?? current;
  for (const link of document.querySelectorAll("#views a")) {
    setAttribute(link, "aria-current", link.dataset.view === shown && "page");
  }
}
