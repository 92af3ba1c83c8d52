// Agreement of two annotators: figures, the patches on which they differ, and blind labelling.

import { classTable, confusionTable, figures } from "./agreement_tables.js";
import { get } from "../core/api.js";
import { loadBlindList } from "./blind_list.js";
import { blindForm, blindProgress, continueBlind } from "./blind_panel.js";
import { ConflictSheet } from "./conflict_sheet.js";
import { button, el, soon } from "../core/dom.js";
import { lookAtShapes } from "../core/frame_shape.js";
import { onLabels } from "../saving/labels.js";
import { lookKeys } from "../core/keys.js";
import { blind, mission, onChange, onReload, onSetting, who } from "../core/mission.js";
import { addView, go } from "../core/router.js";
import { selectionKeys } from "./tile_grid.js";

const COMPARE_AGAIN_MS = 1000;

let root = null; // null while another view is shown
let parts = null; // the elements of a comparison; null while there is none
let pair = null; // {a, b}: names
let found = null; // the last answer of /api/agreement
let event = 0; // up to which the figures are
let asked = 0;
let timer = 0;
let last = null; // {pair, place}: where the person was, to come back to

async function show(element, [a, b]) {
  leave();
  root = element;
  if (blind()) return showBlind();
  pair = pairFor(a, b);
  if (!pair) return showAlone();
  const here = (parts = build());
  root.replaceChildren(parts.root);
  parts.sheet.grid.focus();
  await lookAtShapes();
  if (here === parts) await compare({ anew: true });
}

function leave() {
  if (found) last = { pair, place: parts.sheet.place() };
  clearTimeout(timer);
  asked += 1;
  parts?.sheet.close();
  parts = null;
  found = null;
}

function hide() {
  leave();
  root = null;
}

/** Who is compared: as the address says, else somebody else with whom works here. */
function pairFor(a, b) {
  const names = mission.annotators;
  if (names.length < 2) return null;
  const known = (name) => names.includes(name);
  const second = known(b) ? b : who();
  const first = known(a) && a !== second ? a : names.find((name) => name !== second);
  return { a: first, b: second };
}

function addressOf({ a, b }) {
  return `#/agreement/${encodeURIComponent(a)}/${encodeURIComponent(b)}`;
}

// ---- What is shown where nothing can be compared

async function showBlind() {
  let fault = "";
  try {
    await loadBlindList();
  } catch (error) {
    if (error.name !== "ApiError") throw error;
    fault = `The list of frames could not be loaded: ${error.message}.`;
  }
  if (root && blind()) showAlso(blindProgress(fault));
}

function showAlone() {
  const [only] = mission.annotators;
  const text = `Only ${only} has worked on this mission so far: there is nothing to compare.`;
  showAlso(el("p", { class: "empty-state", text }), blindForm({ of: only }));
}

function showForm() {
  const back = () => go(addressOf(pair));
  const form = blindForm({ of: pair.a, onCancel: back });
  leave();
  showAlso(form);
  form.querySelector("input").focus();
}

function showAlso(...children) {
  const attrs = { tabindex: -1, "data-home": true };
  root.replaceChildren(el("section", { class: "agreement-alone", attrs }, ...children));
}

// ---- The comparison

function build() {
  const numbers = el("div", { class: "agreement-numbers" });
  const words = el("p", { class: "agreement-words", attrs: { role: "status" } });
  const same = last?.pair.a === pair.a && last.pair.b === pair.b;
  const sheet = new ConflictSheet({
    pair,
    place: same ? last.place : null,
    onOpen: ({ camera, frame, cell }) => go(`#/label/${camera}/${frame}/${cell}`),
    onChoice: showNumbers,
  });
  const section = el(
    "section",
    { class: "agreement tiles-view", attrs: { "aria-label": "agreement of two annotators" } },
    el(
      "div",
      { class: "bar" },
      person("a"),
      button("⇄", swap, { title: "exchange them (s)", attrs: { "aria-label": "exchange them" } }),
      person("b"),
      button("Label blind …", showForm, { title: "label again without seeing this (b)" }),
      words,
    ),
    el("div", { class: "agreement-columns" }, numbers, sheet.element),
  );
  return { root: section, numbers, words, sheet };
}

function person(side) {
  const choose = ({ target }) => {
    const next = { ...pair, [side]: target.value };
    if (next.a === next.b) next[side === "a" ? "b" : "a"] = pair[side];
    go(addressOf(next));
  };
  const options = mission.annotators.map((name) =>
    el("option", { text: name, attrs: { value: name, selected: name === pair[side] } }),
  );
  const letter = side.toUpperCase();
  const attrs = { "aria-label": `annotator ${letter}` };
  return el(
    "label",
    { class: "person-choice" },
    el("strong", { text: letter }),
    el("select", { attrs, on: { change: choose } }, ...options),
  );
}

function swap() {
  go(addressOf({ a: pair.b, b: pair.a }));
}

async function compare({ anew }) {
  const mine = (asked += 1);
  const upTo = mission.event;
  if (!found) parts.words.textContent = "Comparing …";
  let answer;
  try {
    answer = await get("/api/agreement", pair);
  } catch (error) {
    if (mine !== asked) return;
    if (error.name !== "ApiError") throw error;
    return showFault(error);
  }
  if (mine !== asked) return;
  found = answer;
  event = upTo;
  parts.words.textContent = "";
  parts.root.classList.remove("not-compared");
  parts.sheet.take(found.conflicts, { anew });
  showNumbers();
}

function showFault({ status, message }) {
  const yet = status === 404 || status === 409;
  const words = yet
    ? `${pair.a} and ${pair.b} cannot be compared yet: ${message}.`
    : `The labels could not be compared: ${message}.`;
  const hint = "A second person labels the same frames blind: “Label blind …” begins that.";
  parts.root.classList.add("not-compared");
  parts.words.textContent = "";
  parts.numbers.replaceChildren(
    el("p", { class: "empty-state", text: words, attrs: { role: "status" } }),
    ...(yet ? [el("p", { class: "empty-state", text: hint })] : []),
  );
}

function showNumbers() {
  const { sheet, numbers } = parts;
  const { only } = sheet.view;
  const confusion = confusionTable(found, only, (chosen) => sheet.choosePair(chosen));
  numbers.replaceChildren(figures(found), confusion, classTable(found));
}

/** Labels changed somewhere: figures are computed anew, and the tiles stay where they are. */
function compareSoon() {
  if (!found || event === mission.event) return;
  clearTimeout(timer);
  timer = setTimeout(() => found && compare({ anew: false }), COMPARE_AGAIN_MS);
}

// ---- Keys

function enter() {
  if (blind()) continueBlind();
  else parts?.sheet.openCurrent();
}

/** A row of the table that only works while two annotators are compared. */
function row(keys, does, run) {
  return { keys, does, run: () => (found ? run(parts.sheet) : false) };
}

addView("agreement", {
  title: "Agreement",
  show,
  hide,
  link: () => (pair ? addressOf(pair) : "#/agreement"),
  classKeys: (name) => found && parts.sheet.settle(name),
  keys: [
    { keys: ["class key"], does: "settle the selected conflicts as this class" },
    row(["Delete", "Backspace"], "take settlements back", (sheet) => sheet.settle(null)),
    { keys: ["Enter"], does: "open the frame of the patch; blind: the next frame", run: enter },
    row(["/"], "filter: open, settled, all", (sheet) => sheet.nextWhich()),
    row(["e"], "also where one of them is unsure, or not", (sheet) => sheet.withUnsure()),
    row(["d", "PageDown"], "next page", (sheet) => sheet.turn(1)),
    row(["a", "PageUp"], "previous page", (sheet) => sheet.turn(-1)),
    row(["s"], "exchange the two annotators", swap),
    { keys: ["b"], does: "label blind", run: () => (parts ? showForm() : false) },
    row(["r"], "compare anew", () => compare({ anew: true })),
    ...lookKeys,
    ...selectionKeys(() => parts?.sheet.grid),
  ],
});

onLabels(soon(() => found && parts.sheet.refresh()));
onChange((what) => {
  // Heard again of the server: what is selected stays selected.
  if (found && what === "all") compare({ anew: false });
  else if (root && what === "all") show(root, pair ? [pair.a, pair.b] : []);
  else if (root && blind()) showBlind();
  else compareSoon();
});
onReload(() => {
  if (root) leave();
  last = null;
  if (!root) return;
  if (blind()) showBlind();
  else root.replaceChildren();
});
onSetting((name) => {
  if (!found || !["enhance", "palette"].includes(name)) return;
  parts.sheet.redraw();
  showNumbers();
});
