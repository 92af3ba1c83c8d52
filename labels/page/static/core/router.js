// The page's address says what is shown: #/label/left/17. Views register under the first word.

import { byId, el, say, setAttribute } from "./dom.js";
import { setViewKeys } from "./keys.js";
/** @import { GoOptions, LaterView, ShownViews, View } from "./types.js" */

/** @type {ShownViews} */
const shown = { views: new Map(), current: "", home: "", failures: 0 };

/** Register a view; `name`: first word of its addresses. */
export function addView(/** @type {string} */ name, /** @type {View} */ view) {
  shown.views.set(name, view);
}

function viewOf(/** @type {string} */ name) {
  return /** @type {View} */ (shown.views.get(name));
}

/** Register a view whose module is loaded when it is first shown, and registers itself then.
 * @param {string} name @param {string} title @param {LaterView["load"]} load
 */
export function addLaterView(name, title, load) {
  shown.views.set(name, { title, load });
}

/** Load the views that nobody has shown yet, so that they are there when the server is not. */
export async function loadLaterViews() {
  for (const view of [...shown.views.values()]) {
    try {
      if ("load" in view) await view.load("");
    } catch {
      return; // Loaded, or complained of, when it is shown.
    }
  }
}

/** Go to an address, "#/label/left/17"; `replace`: no new entry for the Back button. */
export function go(/** @type {string} */ hash, /** @type {GoOptions} */ { replace = false } = {}) {
  if (hash !== location.hash) history[replace ? "replaceState" : "pushState"](null, "", hash);
  route();
}

/** Show another address without going anywhere: what is shown moved on by itself. */
export function noteAddress(/** @type {string} */ hash) {
  if (hash !== location.hash) history.replaceState(null, "", hash);
}

export function currentView() {
  return shown.current;
}

/** Begin to follow the address; `home` stands for an empty or unknown one. */
export function startRouting(/** @type {string} */ home) {
  shown.home = home;
  window.addEventListener("popstate", route);
  buildLinks();
  route();
}

function route() {
  const [name, ...parts] = location.hash.replace(/^#\/?/, "").split("/").map(decode);
  const view = shown.views.get(name);
  if (!view) {
    noteAddress(shown.home);
    return void (shown.views.has(shown.home.split("/")[1]) && route());
  }
  if ("load" in view) return void loadView(name, view.load);
  const root = byId("view");
  if (name !== shown.current) {
    if (shown.current) viewOf(shown.current).hide();
    root.replaceChildren();
    shown.current = name;
    setViewKeys(view);
    markLink();
  }
  view.show(root, parts);
}

async function loadView(/** @type {string} */ name, /** @type {LaterView["load"]} */ load) {
  try {
    await load(shown.failures ? `?again=${shown.failures}` : "");
  } catch (error) {
    shown.failures += 1;
    if (!(error instanceof TypeError)) throw error;
    const words = "This view cannot be loaded now; choose it again when the server answers.";
    return say(words, { bad: true });
  }
  // Another address may have been asked for meanwhile.
  if (location.hash.startsWith(`#/${name}`)) route();
}

function decode(/** @type {string} */ word) {
  try {
    return decodeURIComponent(word);
  } catch {
    return word;
  }
}

function buildLinks() {
  const linked = [...shown.views].filter(([, view]) => view.title);
  const links = linked.map(([name, { title }]) => {
    const link = el("a", { text: title, href: `#/${name}`, "data-view": name });
    link.addEventListener("click", (event) => {
      event.preventDefault();
      go(viewOf(name).link?.() ?? `#/${name}`);
    });
    return link;
  });
  byId("views").replaceChildren(...links);
}

function markLink() {
  const name = viewOf(shown.current).under ?? shown.current;
  for (const link of byId("views").children) {
    setAttribute(link, "aria-current", link.getAttribute("data-view") === name && "page");
  }
}
