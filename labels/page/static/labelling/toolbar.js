// The toolbar of the views in which patches are labelled, and undo, which goes where it changed
// something.

import { proposeAgain } from "./painting.js";
import { nextSteps, redo, undo } from "../saving/saver.js";
import { allow, commandButtons } from "../core/controls.js";
import { button, el, redraw, say, setAttribute, setText } from "../core/dom.js";
import { DRAWER_KEY, reachable, toggleDrawer } from "../core/keys.js";
import { clearClass, colourOf, mission, setting, signOf } from "../core/mission.js";
import { currentView, go } from "../core/router.js";
/** @import { Commands, Head, KeyFor, PainterButton, PainterRow, Tool } from "../types.js" */

/** Undo, and propose again what the undone action had accepted. */
export async function stepBack() {
  const head = await undo();
  proposeAgain(head?.key);
  tell("Undone", head);
}

export async function stepForward() {
  tell("Done again", await redo());
}

/** Say what was undone where, and show it: views of frames go there, the others offer to. */
function tell(/** @type {string} */ what, /** @type {?Head} */ head) {
  if (!head) return;
  const view = currentView();
  const goes = view === "label" || view === "overview";
  const link = goes ? null : `#/label/${head.camera}/${head.frame}`;
  if (goes) go(`#/${view}/${head.camera}/${head.frame}`, { replace: true });
  say(`${what}: ${words(head)}.`, { link });
}

function words(/** @type {Head} */ { kind, changed, camera, frame, frames: count }) {
  const patches = changed === 1 ? "1 patch" : `${changed} patches`;
  const more = count > 1 ? ` and ${count - 1} more` : "";
  return `${kind}, ${patches}, ${camera} frame ${frame}${more}`;
}

const OWN = { undo: stepBack, redo: stepForward, settings: toggleDrawer };
/** @type {Record<string, string>} */
const OWN_KEYS = { undo: "z", redo: "Z", settings: DRAWER_KEY };

/** Build the toolbar; `choose` takes a class; `tools`: what painting can do beside classes;
 * `actions`: of the view, "rest" among them; the first one is the main one.
 * @param {Commands} commands @param {(name: string) => unknown} choose @param {KeyFor} keyFor
 * @param {Tool[]} tools @param {Tool[]} actions
 */
export function buildToolbar(commands, choose, keyFor, tools, actions) {
  /** @param {string} name */
  const keys = (name) => (OWN_KEYS[name] ? reachable(OWN_KEYS[name]) : keyFor(name));
  const command = commandButtons({ ...OWN, ...commands }, keys);
  const make = (/** @type {Tool} */ [name, text, does]) => command(text, name, does);
  const undoing = command("Undo", "undo", "Undo");
  const redoing = command("Redo", "redo", "Do again");
  const drawer = command("Settings", "settings", "Settings");
  const group = { class: "painters", role: "group", "aria-label": "What painting puts on patches" };
  const painters = el("div", group);
  const toolRow = tools.map(make);
  const acting = actions.map(make);
  acting[0].classList.add("main");
  const root = el("div", { class: "toolbar", role: "toolbar", "aria-label": "Tools" },
    el("div", { class: "pair" }, undoing, redoing),
    painters,
    el("div", { class: "pair" }, ...toolRow),
    ...acting,
    drawer,
  );
  /** @param {?string} chosen A class or a tool. */
  const show = (chosen) => {
    showPainters(painters, choose, chosen);
    for (const made of toolRow) {
      setAttribute(made, "aria-pressed", String(made.dataset.command === chosen));
    }
    const [back, again] = nextSteps();
    allow(undoing, back ? "" : "Nothing to undo.", isHead(back) ? `Undo: ${words(back)}` : "Undo");
    allow(redoing, again ? "" : "Nothing to do again.", again ? `Do again: ${words(again)}` : "");
    setAttribute(drawer, "aria-expanded", String(setting("drawer")));
    setText(root.querySelector("[data-command=rest]"), `Rest is ${clearClass()}`);
  };
  return { root, show };
}

/** Whether that is known here. @returns {head is Head} */
function isHead(/** @type {?Partial<Head>} */ head) {
  return Boolean(head?.key);
}

/** @param {HTMLElement} root @param {(name: string) => unknown} choose @param {?string} chosen */
function showPainters(root, choose, chosen) {
  const rows = classTree().map(({ name, key, obstacle, description, depth, group }) => ({
    name,
    depth,
    group,
    on: name === chosen,
    colour: colourOf(name),
    sign: signOf(name),
    title: [description, key && `key ${key}`, `${mission.counts[name] ?? 0} patches of yours`],
    // A name that labels carry and the taxonomy does not have: shown, not given.
    disabled: obstacle === null && name !== "unsure",
  }));
  const { activeElement } = document;
  const focused = root.contains(activeElement) && activeElement?.ariaLabel;
  redraw(root, rows, () => rows.map((row) => painterButton(row, () => choose(row.name))));
  const again = [...root.children].find(({ ariaLabel }) => focused && ariaLabel === focused);
  if (again instanceof HTMLElement) again.focus();
}

// All classes with their depth, each below what it is a kind of; a group that is no class stands
// above its first one.
function classTree() {
  const all = mission.classes;
  /** @type {PainterRow[]} */
  const rows = [];
  const add = (/** @type {PainterRow} */ row, /** @type {number} */ depth) => {
    rows.push({ ...row, depth });
    for (const known of all) if (known.parent === row.name) add(known, depth + 1);
  };
  for (const known of all) {
    const { parent = "" } = known;
    const isThere = [...all, ...rows].some(({ name }) => name === parent);
    if (!parent) add(known, 0);
    else if (!isThere) add({ name: parent, group: true }, 0);
  }
  return rows;
}

/** @param {PainterButton} row @param {() => unknown} run */
function painterButton({ name, group, depth, on, colour, sign, title, disabled }, run) {
  if (group) return el("span", { class: "group", text: name });
  const attributes = { class: "painter", title: title.filter(Boolean).join(" · "), disabled };
  const made = button("", run, { ...attributes, "aria-pressed": String(on), "aria-label": name });
  const mark = el("span", { class: "sign", text: sign });
  mark.style.borderColor = colour;
  made.style.marginInlineStart = `${depth}em`;
  made.append(mark, el("span", { class: "name", text: name }));
  return made;
}
