// The list of what was not written: conflicts to decide, refused actions, others' leftovers.

import { button, el } from "../core/dom.js";
import { go } from "../core/router.js";
import { onChange } from "../core/mission.js";
import { cellName } from "../frame/patch_grid.js";
import { closeConflict, discard, onRefused, unwritten } from "./outbox.js";
import { act, onState, pending, sendAgain, state, stateReason } from "./saver.js";

const MAX_SHOWN = 30;

/** Show the list whenever there is something in it. */
export function startNotices() {
  onRefused(show);
  onState(show);
  onChange((what) => what !== "states" && show());
  show();
}

let shown = "";
let counted = 0;

function show() {
  const { conflicts, aside, foreign } = unwritten();
  const lists = [conflicts, aside, foreign];
  const items = [
    ...conflicts.slice(0, MAX_SHOWN).map(conflictItem),
    ...more(conflicts, "conflicts"),
    ...aside.slice(0, MAX_SHOWN).map(refusedItem),
    ...more(aside, "refused actions"),
    ...foreignItems(foreign),
  ];
  const words = headline(...lists.map(({ length }) => length));
  const text = [words, ...items.map((item) => item.textContent)].join("\n");
  if (text === shown) return;
  shown = text;
  const box = document.getElementById("notices");
  // What is new opens the list; a list that somebody closed stays closed otherwise.
  const count = lists.reduce((sum, { length }) => sum + length, 0);
  const open = count > counted || Boolean(box.querySelector("details[open]"));
  counted = count;
  const head = items.length
    ? el("details", { open }, el("summary", { text: words }), el("ul", {}, ...items))
    : el("p", { text: words });
  box.replaceChildren(head);
  box.hidden = !words;
}

function headline(conflicts, refused, foreign) {
  const parts = [];
  if (conflicts) parts.push(`${conflicts} not written: said otherwise elsewhere`);
  if (refused) parts.push(`${refused} refused by the server`);
  if (foreign) parts.push(`${foreign} of another mission or annotator wait`);
  return [trouble(), parts.join(" · ")].filter(Boolean).join(" · ");
}

function more(list, what) {
  if (list.length <= MAX_SHOWN) return [];
  return [el("li", { text: `… and ${list.length - MAX_SHOWN} more ${what}` })];
}

function trouble() {
  if (state() !== "refused" && state() !== "offline") return "";
  const kept = pending()
    ? `${pending()} of your actions wait in this browser`
    : "what you do now waits in this browser";
  const start = state() === "offline" ? "Server away" : "Nothing can be saved";
  return `${start}: ${stateReason()}; ${kept}.`;
}

function said(label) {
  return label === null ? "no label" : `“${label}”`;
}

function conflictItem(conflict) {
  const { camera, frame, cell, theirs, yours, source } = conflict;
  const where = `${cellName(cell)} of ${camera} frame ${frame}`;
  const useMine = () => {
    act("resolve", [{ camera, frame, label: yours, cells: [cell], base: [theirs] }], { source });
    closeConflict(conflict);
  };
  return el("li", { class: "conflict" },
    `${where}: there is now ${said(theirs)} (said elsewhere meanwhile); ` +
      `yours, ${said(yours)}, was not written. `,
    button("Use mine", useMine),
    button(theirs === null ? "Leave it" : `Keep “${theirs}”`, () => closeConflict(conflict)),
    button("Show", () => go(`#/label/${camera}/${frame}/${cell}`)),
  );
}

function describe({ kind, changes }) {
  const count = changes.reduce((sum, { cells }) => sum + cells.length, 0);
  const where = changes.length ? ` on ${changes[0].camera} frame ${changes[0].frame}` : "";
  return `${kind} (${count} ${count === 1 ? "patch" : "patches"}${where})`;
}

function refusedItem(entry) {
  return el("li", { class: "bad" },
    `The server refused ${describe(entry)}: ${entry.refusal} `,
    button("Try again", () => sendAgain(entry)),
    button("Save as file", () => saveFile([entry])),
    button("Discard", () => discard(entry)),
  );
}

function foreignItems(foreign) {
  const groups = Map.groupBy(foreign, ({ who, mission }) => `${who} on mission ${mission}`);
  return [...groups].map(([name, entries]) =>
    el("li", {},
      `${entries.length} unsaved of ${name} are kept in this browser; ` +
        "they are sent when that mission is open with that annotator. ",
      button("Save as file", () => saveFile(entries)),
    ),
  );
}

function saveFile(entries) {
  const text = JSON.stringify(entries, null, 1);
  const url = URL.createObjectURL(new Blob([text], { type: "application/json" }));
  el("a", { href: url, download: "tokt-unsaved-actions.json" }).click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
}
