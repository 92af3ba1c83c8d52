// The table of classes: names, colours, keys, which are obstacles, of which kind, in which order.

import { get, onFailure, post } from "../core/api.js";
import { complain } from "../core/controls.js";
import { button, el, part, say } from "../core/dom.js";
/** @import { ClassesAnswer, Field, Options, UsedClass } from "../types.js" */

/** A table of the workspace's classes that can be changed and saved as a whole. */
export function classEditor() {
  const root = el("div", {});
  const load = async () => {
    const known = await get("/api/classes").catch(onFailure(complain()));
    if (known) showClasses(root, known, load);
  };
  load();
  return root;
}

/** @param {HTMLElement} root @param {ClassesAnswer} answer @param {() => void} load */
function showClasses(root, { classes, setup, fixed }, load) {
  const rows = classes.map((known) => ({ ...known }));
  const body = el("tbody", {});
  const draw = () => body.replaceChildren(...rows.map((row, at) => rowOf(row, at, rows, draw)));
  const add = () => {
    rows.push({ name: "", obstacle: true, color: "#c85fd0", key: "", description: "", parent: "", labels: 0 });
    draw();
    if (body.lastElementChild) part(body.lastElementChild, "input").focus();
  };
  const save = async () => {
    const changed = rows.map(({ labels, given, ...one }) => one);
    const request = post("/api/classes", { setup, classes: changed });
    const answer = await request.catch(onFailure(complain("Not saved:")));
    if (answer) say("The classes are saved.");
    if (answer) load();
  };
  const heads = ["Name", "Colour", "Key", "Obstacle", "Kind of", "What to look for", "Labels", ""];
  draw();
  root.replaceChildren(
    el("table", { class: "classes" },
      el("thead", {}, el("tr", {}, ...heads.map((text) => el("th", { text, scope: "col" })))),
      body,
    ),
    fixed ? el("p", { text: fixed }) : el("div", {},
      button("Add a class", add), button("Save the classes", save, { class: "main" })),
  );
}

/** @param {UsedClass} row @param {number} at @param {UsedClass[]} rows @param {() => void} draw */
function rowOf(row, at, rows, draw) {
  /** @param {Field} name @param {string} label @param {Options<"input">} options */
  const input = (name, label, options) => {
    const value = row[name];
    const state = options.type === "checkbox" ? { checked: value } : { value };
    const made = el("input", { ...options, ...state, "aria-label": label });
    made.addEventListener("input", () => {
      const set = options.type === "checkbox" ? made.checked : made.value;
      Object.assign(row, { [name]: set });
    });
    return el("td", {}, made);
  };
  const move = (/** @type {number} */ step) => () => {
    rows.splice(at + step, 0, ...rows.splice(at, 1));
    draw();
  };
  const remove = () => {
    rows.splice(at, 1);
    draw();
  };
  const named = row.name || "the new class";
  const used = row.given;
  return el("tr", {},
    input("name", "name", { maxlength: 60, disabled: used, title: used ? "It was given: its name stays." : "" }),
    input("color", `colour of ${named}`, { type: "color" }),
    input("key", `key of ${named}`, { maxlength: 1, size: 2 }),
    input("obstacle", `${named} is an obstacle`, { type: "checkbox", disabled: used }),
    input("parent", `${named} is a kind of`, { maxlength: 60, size: 12 }),
    input("description", `what to look for: ${named}`, { maxlength: 200 }),
    el("td", { class: "count", text: row.labels.toLocaleString("en") }),
    el("td", { class: "moves" },
      button("↑", move(-1), { "aria-label": `${named} earlier`, disabled: at === 0 }),
      button("↓", move(1), { "aria-label": `${named} later`, disabled: at === rows.length - 1 }),
      button("×", remove, { "aria-label": `remove ${named}`, disabled: used }),
    ),
  );
}
