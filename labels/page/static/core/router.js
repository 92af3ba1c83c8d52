// The page's address says what is shown: #/label/left/17. Views register under the first word.

import { byId, el, say, setAttribute } from "./dom.js";
import { setViewKeys } from "./keys.js";

/** @import { LaterView, View } from "./types.js" */

const shown = {
  /** @type {Map<string, View | LaterView>} */
  views: new Map(),
  current: "",
  home: "", // stands for an empty or unknown address
  failures: 0,
};

/** Register a view. @param {string} name First word of its addresses. @param {View} view */
export function addView(name, view) {
  shown.views.set(name, view);
}

/** The view of a name. @param {string} name */
function viewOf(name) {
  return /** @type {View} */ (shown.views.get(name));
}

/** Register a view whose module is loaded when it is first shown, and registers itself then.
 * `title`: of its link, "" for a view that others lead to. `load(again)`: `again` ends the module's
 * address, as browsers do not fetch an address again that could not be had.
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

/** Go to an address, "#/label/left/17"; `replace`: no new entry for the Back button.
 * @param {string} hash @param {{replace?: boolean}} [options]
 */
export function go(hash, { replace = false } = {}) {
  if (hash !== location.hash) history[replace ? "replaceState" : "pushState"](null, "", hash);
  route();
}

/** Show another address without going there: the view moved on by itself. @param {string} hash */
export function noteAddress(hash) {
  if (hash !== location.hash) history.replaceState(null, "", hash);
}

/** The name of the view that is shown. */
export function currentView() {
  return shown.current;
}

/** Begin to follow the address. @param {string} home Stands for an empty or unknown one. */
export function startRouting(home) {
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

/** @param {string} name @param {LaterView["load"]} load */
async function loadView(name, load) {
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

/** @param {string} word */
function decode(word) {
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
