// Keys: one set of tables that dispatches them and that the ? overlay shows.
// Class keys come from the taxonomy and may be any character: they win. Each page key that is a
// single character therefore also answers to Alt with it.

import { dialogById, el } from "./dom.js";
import { mission, selectClass } from "./mission.js";
import { changeSetting, setSetting, setting } from "./settings.js";
/** @import { KeyEntry, KeyTables, ViewKeys } from "./types.js" */

const CONTRAST_STEP = 10;

/** @type {KeyTables} */
const tables = { view: { title: "" }, everywhere: [], held: new Map() };

export function setViewKeys(/** @type {ViewKeys} */ view) {
  tables.view = view;
  tables.held.clear();
}

/** Add entries that answer in every view. */
export function addGlobalKeys(/** @type {KeyEntry[]} */ entries) {
  tables.everywhere.push(...entries);
}

export function listen() {
  document.addEventListener("keydown", onKeyDown);
  document.addEventListener("keyup", onKeyUp);
  window.addEventListener("blur", releaseAll);
  addGlobalKeys([{ keys: ["?", "F1"], does: "these keys, and back", run: toggleHelp }]);
}

function onKeyDown(/** @type {KeyboardEvent} */ event) {
  if (document.querySelector("dialog[open]") || ownsKey(event)) return;
  const entry = entryFor(event);
  if (!entry?.run || entry.run(event, nameOf(event)) === false) return;
  event.preventDefault();
  if (entry.release) tables.held.set(event.code, entry);
}

function onKeyUp(/** @type {KeyboardEvent} */ event) {
  tables.held.get(event.code)?.release?.(event);
  tables.held.delete(event.code);
}

function releaseAll(/** @type {Event} */ event) {
  for (const entry of tables.held.values()) entry.release?.(event);
  tables.held.clear();
}

function entryFor(/** @type {KeyboardEvent} */ event) {
  const known = classFor(event);
  const { keys: own = [], classKeys = selectClass } = tables.view;
  if (known) return { keys: [], does: "", run: () => classKeys(known.name) };
  const name = nameOf(event);
  const table = [...own, ...tables.everywhere];
  const plain = name.replace(/^Alt\+(?=.$)/u, "");
  return (
    table.find(({ keys }) => keys.includes(name)) ?? table.find(({ keys }) => keys.includes(plain))
  );
}

function classFor(/** @type {KeyboardEvent} */ event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return null;
  return mission.classes.find(({ key }) => key && key === event.key) ?? null;
}

/** Shift is part of a character ("N", "?") and said only with named keys and Ctrl. */
function nameOf(/** @type {KeyboardEvent} */ event) {
  let key = event.key === " " ? "Space" : event.key;
  if (event.altKey && /^(Key|Digit)/.test(event.code)) key = layoutKey(event);
  const character = [...key].length === 1;
  const ctrl = event.ctrlKey || event.metaKey;
  if (ctrl && character) key = key.toUpperCase();
  const parts = [
    ctrl && "Ctrl",
    event.altKey && "Alt",
    event.shiftKey && (!character || ctrl) && "Shift",
    key,
  ];
  return parts.filter(Boolean).join("+");
}

/** Alt makes other characters on some keyboards: what is printed on the key counts. */
function layoutKey(/** @type {KeyboardEvent} */ { key, code, shiftKey }) {
  if (/^[\x20-\x7e]$/.test(key)) return key;
  const letter = code.replace(/^(Key|Digit)/, "");
  return shiftKey ? letter : letter.toLowerCase();
}

/** What a control does with a key by itself stays its own. */
function ownsKey(/** @type {KeyboardEvent} */ { target, key, ctrlKey, altKey }) {
  if (!(target instanceof HTMLElement)) return false;
  if (target instanceof HTMLInputElement) {
    if (target.type === "range") return /^(Arrow|Page|Home|End)/.test(key);
    if (target.type === "checkbox") return key === " ";
    return key !== "Escape";
  }
  if (target instanceof HTMLSelectElement) return !ctrlKey && !altKey && key !== "Escape";
  if (target.getAttribute("role") === "slider") return /^(Arrow|Page|Home|End)/.test(key);
  if (target.matches("button, a, summary")) {
    return key === "Enter" || (key === " " && !target.matches("a"));
  }
  return false;
}

/** Open the overlay of keys, or close it. */
export function toggleHelp() {
  const dialog = dialogById("help");
  if (dialog.open) return dialog.close();
  const on = { click: toggleHelp };
  dialog.replaceChildren(
    el("button", { class: "close", text: "Close (Esc)", type: "button", on }),
    el("h2", { text: "Keys" }),
    el("p", {},
      "Class keys go before page keys; a one-character page key also answers to Alt with it.",
    ),
    el("div", { class: "help-columns" }, ...shownTables()),
  );
  dialog.onkeydown = (event) => {
    if (event.key !== "?" && event.key !== "F1") return;
    event.preventDefault();
    dialog.close();
  };
  dialog.showModal();
}

function shownTables() {
  const given = mission.classes.filter(({ key }) => key);
  const { title: viewTitle, keys: own = [] } = tables.view;
  const rows = [
    ...given.map(({ key, name }) => ({ title: "Classes", keys: [key], does: name })),
    ...own.map(({ keys, does, group = viewTitle }) => tableRow(group, keys, does)),
    ...tables.everywhere.map(({ keys, does }) => tableRow("Everywhere", keys, does)),
  ];
  return [...Map.groupBy(rows, (row) => row.title)].map(([title, some]) =>
    el("section", {},
      el("h3", { text: title }),
      el("table", {}, ...some.map(keyRow)),
    ),
  );
}

/** @param {string} title @param {string[]} keys @param {string} does */
function tableRow(title, keys, does) {
  return { title, keys: keys.map(reachable), does };
}

function keyRow(/** @type {{keys: string[], does: string}} */ { keys, does }) {
  const marks = keys.flatMap((key, at) => [at ? " " : null, el("kbd", { text: printed(key) })]);
  return el("tr", {}, el("td", {}, ...marks), el("td", { text: does }));
}

/** @type {Record<string, string>} */
const ARROWS = { ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓" };

function printed(/** @type {string} */ key) {
  return key.replace(/Arrow\w+/, (name) => ARROWS[name]);
}

/** The form in which a page key can be pressed: with Alt where a class takes it. */
export function reachable(/** @type {string} */ key) {
  return mission.classes.some((known) => known.key === key) ? `Alt+${key}` : key;
}

/** @param {string} key @param {string} does @param {() => void} run @returns {KeyEntry} */
const lookKey = (key, does, run) => ({ keys: [key], does, run, group: "Seeing" });

/** Keys for how pictures look, the same in every view that shows pictures. */
export const lookKeys = [
  lookKey("[", "less contrast", () => changeSetting("enhance", -CONTRAST_STEP, 100)),
  lookKey("]", "more contrast", () => changeSetting("enhance", CONTRAST_STEP, 100)),
];

/** Opens and closes the drawer of settings. */
export const DRAWER_KEY = "S";

export function toggleDrawer() {
  setSetting("drawer", !setting("drawer"));
}

/** The same and further ones, for views with a toolbar. */
export const labelKeys = [
  ...lookKeys,
  lookKey("<", "more suggestions are sure", () => changeSetting("confidence", -0.1, 3)),
  lookKey(">", "fewer suggestions are sure", () => changeSetting("confidence", 0.1, 3)),
  lookKey(DRAWER_KEY, "settings, and back", toggleDrawer),
];
