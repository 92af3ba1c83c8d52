// The list of what was not written: conflicts to decide, refused actions, others' leftovers.

import { button, byId, el, focusView, say } from "../core/dom.js";
import { go } from "../core/router.js";
import { onChange } from "../core/mission.js";
import { cellName } from "../core/patch_grid.js";
import { closeConflicts, discard, onRefused, unwritten } from "./outbox.js";
import {
  act, changesOf, onState, patchesAre, pending, sendAgain, state, stateReason,
} from "./saver.js";
/** @import { Entry, NotedConflict } from "../types.js" */

const MAX_SHOWN = 30;

const list = { shown: "", counted: 0 }; // what it says, and of how many actions

/** Show in the header that there is something in the list; it opens over the view. */
export function startNotices() {
  document.addEventListener("keydown", closeByKey, { capture: true });
  onRefused(show);
  onState(show);
  onChange((what) => what !== "states" && show());
  show();
}

function show() {
  const { conflicts, aside, foreign } = unwritten();
  const items = [
    ...(trouble() ? [el("li", { text: trouble() })] : []),
    ...(conflicts.length > 1 ? [allConflictsItem(conflicts)] : []),
    ...someOf(conflicts, conflictItem, "conflicts"),
    ...someOf(aside, refusedItem, "refused actions"),
    ...foreignItems(foreign),
  ];
  const words = headline(conflicts.length, aside.length, foreign.length);
  const text = [words, ...items.map((item) => item.textContent)].join("\n");
  if (text === list.shown) return;
  list.shown = text;
  const box = byId("notices");
  const focused = box.contains(document.activeElement);
  const open = Boolean(words && openList());
  const title = "show what was not saved (Escape closes the list)";
  box.replaceChildren(
    el("details", { open }, el("summary", { text: words, title }), el("ul", {}, ...items)),
  );
  box.hidden = !words;
  if (focused && words) box.querySelector("summary")?.focus();
  else if (focused) focusView();
  // Said once, when it comes; the header shows it as long as it lasts.
  const count = conflicts.length + aside.length;
  if (count > list.counted) {
    say(`${words}: see the list in the header.`, { bad: true, stays: true });
  }
  list.counted = count;
}

function openList() {
  const found = byId("notices").querySelector("details");
  return found?.open ? found : null;
}

function closeByKey(/** @type {KeyboardEvent} */ event) {
  const open = openList();
  if (event.key !== "Escape" || !open || document.querySelector("dialog[open]")) return;
  event.preventDefault();
  event.stopPropagation();
  open.open = false;
  focusView();
}

/** @param {number} conflicts @param {number} refused @param {number} foreign */
function headline(conflicts, refused, foreign) {
  const parts = [];
  if (trouble()) parts.push("Your work waits in this browser");
  if (conflicts) parts.push(`${patchesAre(conflicts)} not written`);
  if (refused) parts.push(`${refused} refused by the server`);
  if (foreign) parts.push(`${foreign} of others wait`);
  return parts.join(" · ");
}

/** @template T @param {T[]} list @param {(one: T) => HTMLElement} itemOf @param {string} what */
function someOf(list, itemOf, what) {
  const items = list.slice(0, MAX_SHOWN).map(itemOf);
  const more = list.length - items.length;
  return more ? [...items, el("li", { text: `… and ${more} more ${what}` })] : items;
}

function trouble() {
  if (state() !== "refused" && state() !== "offline") return "";
  const kept = pending()
    ? `${pending()} of your actions wait in this browser`
    : "what you do now waits in this browser";
  const start = state() === "offline" ? "Server away" : "Nothing can be saved";
  return `${start}: ${stateReason()}; ${kept}.`;
}

function said(/** @type {?string} */ label) {
  return label === null ? "no label" : `“${label}”`;
}

/** One action, which one undo takes back: settlements are another one than labels. */
function useMine(/** @type {NotedConflict[]} */ conflicts) {
  for (const [source, some] of Map.groupBy(conflicts, (one) => one.source)) {
    const patches = some.map((one) => ({ ...one, label: one.yours, base: one.theirs }));
    if (act("resolve", changesOf(patches), { source })) closeConflicts(some);
  }
}

function allConflictsItem(/** @type {NotedConflict[]} */ conflicts) {
  const count = conflicts.length;
  return el("li", {},
    `${count} patches: something else was said meanwhile. `,
    button(`Use all ${count} of mine`, () => useMine(conflicts)),
    button(`Keep all ${count} of theirs`, () => closeConflicts(conflicts)),
  );
}

function conflictItem(/** @type {NotedConflict} */ conflict) {
  const { camera, frame, cell, theirs, yours } = conflict;
  const where = `${cellName(cell)} of ${camera} frame ${frame}`;
  return el("li", { class: "conflict" },
    `${where}: there is now ${said(theirs)} (said elsewhere meanwhile); ` +
      `yours, ${said(yours)}, was not written. `,
    button("Use mine", () => useMine([conflict])),
    button(theirs === null ? "Leave it" : `Keep “${theirs}”`, () => closeConflicts([conflict])),
    button("Show", () => go(`#/label/${camera}/${frame}/${cell}`)),
  );
}

function describe(/** @type {Entry} */ { kind, changes }) {
  const count = changes.reduce((sum, { cells }) => sum + cells.length, 0);
  const where = changes.length ? ` on ${changes[0].camera} frame ${changes[0].frame}` : "";
  return `${kind} (${count} ${count === 1 ? "patch" : "patches"}${where})`;
}

function refusedItem(/** @type {Entry} */ entry) {
  return el("li", { class: "bad" },
    `The server refused ${describe(entry)}: ${entry.refusal} `,
    button("Try again", () => sendAgain(entry)),
    button("Save as file", () => saveFile([entry])),
    button("Discard", () => discard(entry)),
  );
}

function foreignItems(/** @type {Entry[]} */ foreign) {
  const groups = Map.groupBy(foreign, ({ who, mission }) => `${who} on mission ${mission}`);
  return [...groups].map(([name, entries]) =>
    el("li", {},
      `${entries.length} unsaved of ${name} are kept in this browser; ` +
        "they are sent when that mission is open with that annotator. ",
      button("Save as file", () => saveFile(entries)),
    ),
  );
}

function saveFile(/** @type {Entry[]} */ entries) {
  const text = JSON.stringify(entries, null, 1);
  const url = URL.createObjectURL(new Blob([text], { type: "application/json" }));
  el("a", { href: url, download: "tokt-unsaved-actions.json" }).click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
}
