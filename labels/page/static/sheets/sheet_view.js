// The review sheet: all patches of a class, odd ones first, many relabelled at once.

import { get } from "../core/api.js";
import { pager, sizeButtons } from "../core/bar_parts.js";
import { classButtons, classTag } from "../core/class_buttons.js";
import { button, el, say, soon } from "../core/dom.js";
import { lookAtShapes } from "../core/frame_shape.js";
import { labelsOf, onLabels, prefetch } from "../saving/labels.js";
import { lookKeys } from "../core/keys.js";
import {
  classes,
  mission,
  onChange,
  onReload,
  onSetting,
  setSetting,
  setting,
} from "../core/mission.js";
import { PatchPreview, nameOf } from "../frame/patch_preview.js";
import { actOn, patchesAre } from "../saving/relabel.js";
import { addView, go } from "../core/router.js";
import { TileGrid, selectionKeys } from "./tile_grid.js";
import { MARGINS } from "./tile_pictures.js";

const LIMIT = 200;
const ASK_AGAIN_MS = 2000;
const SIZES = [48, 64, 84, 112, 150];

let parts = null; // the elements on show; null while another view is
let label = "";
let page = null; // {offset, total, by, ready, done, of, tiles}
let asked = 0;
let timer = 0;
const places = new Map(); // class -> {page, cursor}: where the person was, to come back to

async function show(root, [name]) {
  if (parts) leave();
  label = classes().some((known) => known.name === name) ? name : firstLabelled();
  parts = build();
  root.replaceChildren(parts.root);
  parts.grid.focus();
  const here = parts;
  await lookAtShapes();
  if (here !== parts) return;
  const place = places.get(label);
  if (place) {
    page = place.page;
    showPage(place.cursor);
    watchLabels();
  } else load(0);
}

function leave() {
  if (page) places.set(label, { page, cursor: parts.grid.selection.cursor });
  clearTimeout(timer);
  asked += 1;
  parts.grid.close();
  parts = null;
  page = null;
}

function firstLabelled() {
  return classes().find(({ name }) => mission.counts[name] > 0)?.name ?? classes()[0].name;
}

function build() {
  const grid = new TileGrid({
    label: `patches labelled ${label}`,
    describe,
    captionLines: 0,
    onChange: showSelection,
    onOpen: open,
  });
  const preview = new PatchPreview();
  const tabs = el("nav", { class: "sheet-tabs", attrs: { "aria-label": "classes" } });
  const words = el("p", { class: "sheet-words", attrs: { role: "status" } });
  const range = el("span", { class: "sheet-range" });
  const chosen = el("span", { class: "sheet-chosen", attrs: { role: "status" } });
  const root = el(
    "section",
    { class: "sheet tiles-view", attrs: { "aria-label": "review sheet" } },
    tabs,
    el("div", { class: "bar one-line" }, words, ...controls(range)),
    el(
      "div",
      { class: "bar", attrs: { role: "group", "aria-label": "relabel the selected patches" } },
      chosen,
      ...classButtons(relabel),
      button("no label", () => relabel(null), { title: "take the label away (key Delete)" }),
    ),
    el("div", { class: "tiles-and-preview" }, grid.element, preview.element),
  );
  return { root, tabs, words, range, chosen, grid, preview };
}

function controls(range) {
  const again = button("reload", reload, { title: "order the patches anew (r)" });
  const around = button("surroundings", changeMargin, {
    title: "more or less around each patch (m)",
  });
  return [pager(turn, range, again), sizeButtons(resize, around)];
}

function look() {
  const width = SIZES.includes(setting("tileWidth")) ? setting("tileWidth") : 84;
  const margin = MARGINS.includes(setting("tileMargin")) ? setting("tileMargin") : 0.25;
  return { width, margin };
}

function resize(step) {
  const at = SIZES.indexOf(look().width) + step;
  setSetting("tileWidth", SIZES[Math.max(0, Math.min(SIZES.length - 1, at))]);
}

function changeMargin() {
  setSetting("tileMargin", MARGINS[(MARGINS.indexOf(look().margin) + 1) % MARGINS.length]);
}

// ---- What the server has

async function load(offset, { quietly = false } = {}) {
  const mine = (asked += 1);
  clearTimeout(timer);
  if (!quietly) showWords("Loading ...");
  try {
    const answer = await get("/api/sheet", { class: label, offset, limit: LIMIT });
    if (mine !== asked) return;
    // Somebody began to choose patches meanwhile: other tiles must not take their places.
    if (quietly && !untouched()) {
      page.newOrder = true;
      return showState();
    }
    if (answer.patches.length === 0 && offset > 0) return load(0);
    page = { ...answer, offset, tiles: answer.patches };
    watchLabels();
    showPage(0);
  } catch (error) {
    if (error.name !== "ApiError") throw error;
    if (mine !== asked) return;
    showWords(`The patches could not be loaded: ${error.message}.`);
  }
}

/** Labels of the frames shown: they say which patches have been relabelled since. */
function watchLabels() {
  const byCamera = Map.groupBy(page.tiles, (tile) => tile.camera);
  for (const [camera, tiles] of byCamera) {
    prefetch(camera, [...new Set(tiles.map((tile) => tile.frame))]);
  }
}

/** While features are being computed, ask how far they are; order anew only untouched pages. */
async function askAgain() {
  const mine = asked;
  try {
    const answer = await get("/api/sheet", { class: label, offset: page.offset, limit: 1 });
    if (mine !== asked) return;
    Object.assign(page, { done: answer.done, of: answer.of });
    if (answer.ready && untouched()) return load(page.offset, { quietly: true });
    page.newOrder = answer.ready;
  } catch (error) {
    if (error.name !== "ApiError") throw error;
    // The page says that the server is away; the question is asked again.
  }
  if (mine === asked && parts) showState();
}

function untouched() {
  const { chosen, cursor } = parts.grid.selection;
  if (parts.grid.busy) return false;
  return chosen.size === 0 && cursor === 0 && page.tiles.every((tile) => labelNow(tile) === label);
}

function reload() {
  if (page) load(page.offset);
}

/** The next page starts after what is still of this class, so that relabelling skips nothing. */
function turn(step) {
  if (!page) return;
  const { offset, tiles, total } = page;
  if (step > 0 && offset + tiles.length >= total) return say("This is the last page.");
  if (step < 0 && offset === 0) return say("This is the first page.");
  const here = tiles.filter((tile) => labelNow(tile) === label).length;
  load(Math.max(0, offset + (step > 0 ? here : -LIMIT)));
}

// ---- What is shown

function showPage(cursor) {
  parts.grid.show(page.tiles, look());
  parts.grid.select((selection) => selection.place(cursor));
  showTabs();
  showState();
}

function showTabs() {
  const audit = el("a", { class: "tab", text: "Audit", attrs: { href: "#/audit" } });
  audit.title = "labels that a model which did not learn them contradicts";
  parts.tabs.replaceChildren(
    ...classes().map(({ name }) => {
      const count = (mission.counts[name] ?? 0).toLocaleString("en");
      const tab = el("a", { class: "tab", attrs: { href: `#/sheet/${encodeURIComponent(name)}` } });
      if (name === label) tab.setAttribute("aria-current", "page");
      tab.append(classTag(name), el("span", { class: "count", text: count }));
      return tab;
    }),
    audit,
  );
}

function showState() {
  const { total, offset, tiles, ready, by, done, of, newOrder } = page;
  const first = tiles.length > 0 ? offset + 1 : 0;
  const [from, to, all] = [first, offset + tiles.length, total].map((n) => n.toLocaleString("en"));
  parts.range.textContent = `${from}–${to} of ${all}`;
  parts.grid.element.dataset.empty = total ? "" : `You have labelled no patch ${label} yet.`;
  if (total === 0) return showWords("");
  const waiting = ready ? "" : ` (features ${done} of ${of} frames)`;
  const news = newOrder ? " The order is ready: press r to see it." : "";
  const odd = tiles.some((tile) => tile.value !== null) ? "; odd ones first" : "";
  showWords(`${by[0].toUpperCase()}${by.slice(1)}${odd}${waiting}.${news}`);
  clearTimeout(timer);
  if (!ready && !newOrder) timer = setTimeout(askAgain, ASK_AGAIN_MS);
}

function showWords(text) {
  parts.words.textContent = text;
}

function showSelection() {
  if (!parts || !page) return;
  const count = parts.grid.selection.chosen.size;
  parts.chosen.textContent = `Relabel ${count > 0 ? `${count} selected` : "this one"} as`;
  const tile = parts.grid.current();
  parts.preview.show(tile, tile ? about(tile) : []);
}

function about(tile) {
  const now = labelNow(tile);
  const odd = tile.value === null ? [] : [`Ordered by its value, ${tile.value.toFixed(2)}.`];
  return [now ? `Labelled ${now}.` : "No label.", ...odd, "Enter opens its frame."];
}

function describe(tile) {
  const now = labelNow(tile);
  if (now === label) return { name: nameOf(tile), lines: [] };
  const lines = [now ? classTag(now) : el("span", { text: "no label" })];
  return { name: `${nameOf(tile)}, now ${now ?? "without label"}`, lines, faded: true };
}

/** My label of the patch, with what has not reached the server yet. */
function labelNow({ camera, frame, cell }) {
  const mine = labelsOf(camera, frame)?.mine;
  return mine ? mine[cell] : label;
}

// ---- What a person does

function relabel(name) {
  if (!page || page.tiles.length === 0) return;
  const targets = parts.grid.targets();
  const count = actOn(
    "relabel",
    targets.map((tile) => ({ ...tile, label: name, base: labelNow(tile) })),
  );
  parts.grid.select((selection) => selection.clear());
  const now = name === null ? "without a label" : name;
  if (count === 0) say(`Nothing to change: ${patchesAre(targets.length)} ${now} already.`);
  else say(`${patchesAre(count)} now ${now}; Ctrl+Z undoes.`);
}

function open(tile) {
  if (tile) go(`#/label/${tile.camera}/${tile.frame}/${tile.cell}`);
}

function turnClass(step) {
  const names = classes().map((known) => known.name);
  const next = (names.indexOf(label) + step + names.length) % names.length;
  go(`#/sheet/${encodeURIComponent(names[next])}`);
}

const view = {
  title: "Review sheet",
  show,
  hide: leave,
  link: () => `#/sheet/${encodeURIComponent(label || firstLabelled())}`,
  classKeys: relabel,
  keys: [
    { keys: ["class key"], does: "relabel the selected patches" },
    { keys: ["Delete", "Backspace"], does: "take their labels away", run: () => relabel(null) },
    { keys: ["Enter"], does: "open the frame of the patch", run: () => open(parts.grid.current()) },
    { keys: ["d", "PageDown"], does: "next page", run: () => turn(1) },
    { keys: ["a", "PageUp"], does: "previous page", run: () => turn(-1) },
    { keys: ["c"], does: "next class", run: () => turnClass(1) },
    { keys: ["C"], does: "class before", run: () => turnClass(-1) },
    { keys: ["+"], does: "larger pictures", run: () => resize(1) },
    { keys: ["-"], does: "smaller pictures", run: () => resize(-1) },
    { keys: ["m"], does: "more or less around each patch", run: changeMargin },
    { keys: ["r"], does: "reload, in the newest order", run: reload },
    ...lookKeys,
    ...selectionKeys(() => parts?.grid),
  ],
};
function showLabels() {
  if (!parts || !page) return;
  watchLabels();
  parts.grid.refresh();
  showTabs();
  showSelection();
}

onLabels(soon(showLabels));
onChange(soon(showLabels));
onReload(() => {
  places.clear();
  if (parts) load(0);
});
onSetting((name) => {
  if (!parts || !page || !["tileWidth", "tileMargin", "enhance"].includes(name)) return;
  parts.grid.resize(look());
});

addView("sheet", view);
