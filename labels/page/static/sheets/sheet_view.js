// The review sheet: all patches of a class, odd ones first, many relabelled at once.

import { classButtons, classTag, nothingYet, pager, sizeButtons } from "../core/controls.js";
import { button, el, say, soon } from "../core/dom.js";
import { lookKeys } from "../core/keys.js";
import { mission, onChange, onReload, onSetting, setSetting, setting } from "../core/mission.js";
import { lookAtShapes } from "../core/pictures.js";
import { addView, go } from "../core/router.js";
import { onLabels, prefetchOf } from "../saving/labels.js";
import { patchesAre } from "../saving/saver.js";
import { selectionKeys } from "./tile_grid.js";
import { nameOf } from "./tile_pictures.js";
import { Asking, PAGE, TileSheet, mineOf, relabel, sheetRow, tab } from "./tile_sheet.js";
/** @import { ApiError, SheetPage, SheetTile } from "../types.js" */

const ASK_AGAIN_MS = 2000;
const SIZES = [48, 64, 84, 112, 150];
const MARGINS = [0, 0.25, 1]; // around a patch, in patches

/** A person's patches of one class. @extends {TileSheet<SheetTile>} */
class ReviewSheet extends TileSheet {
  constructor(/** @type {string} */ label) {
    super(`patches labelled ${label}`, 0);
    this.label = label;
    /** @type {?SheetPage} Null until it is loaded. */
    this.page = null;
    this.asking = new Asking();
    this.timer = 0;
    this.tabs = el("nav", { class: "sheet-tabs", "aria-label": "classes" });
    this.words = el("p", { class: "sheet-words", role: "status" });
    this.range = el("span", { class: "sheet-range" });
    this.root = el("section", { class: "sheet tiles-view", "aria-label": "review sheet" },
      this.tabs,
      el("div", { class: "bar one-line" }, this.words, ...this.#controls()),
      this.bar(
        "relabel the selected patches",
        ...classButtons((name) => this.relabel(name)),
        button("no label", () => this.relabel(null), { title: "take the label away (key Delete)" }),
      ),
      this.tiles,
    );
  }

  #controls() {
    const again = button("reload", () => this.reload(), { title: "order the patches anew (r)" });
    const title = "more or less around each patch (m)";
    const around = button("surroundings", changeMargin, { title });
    return [pager((step) => this.turn(step), this.range, again), sizeButtons(resize, around)];
  }

  show(/** @type {SheetPage} */ page, /** @type {?number} */ cursor) {
    this.page = page;
    this.showTiles(page.tiles, look(), cursor);
    this.#showTabs();
    this.#showState(page);
  }

  refresh() {
    if (!this.page) return;
    prefetchOf(this.page.tiles);
    this.grid.refresh();
    this.#showTabs();
    this.showSelection();
  }

  redraw() {
    if (this.page) this.grid.resize(look());
  }

  close() {
    clearTimeout(this.timer);
    this.asking.stop();
    super.close();
  }

  // ---- What the server has

  /** Load the page that begins with the patch at `offset`.
   * @param {number} offset @param {{quietly?: boolean}} [options]
   */
  async load(offset, { quietly = false } = {}) {
    clearTimeout(this.timer);
    if (!quietly) this.words.textContent = "Loading ...";
    const answer = await this.#ask(offset, PAGE, ({ message }) => {
      this.words.textContent = `The patches could not be loaded: ${message}.`;
    });
    if (!answer) return;
    // Somebody began to choose patches meanwhile: other tiles must not take their places.
    if (quietly && this.page && !this.#untouched()) {
      this.page.newOrder = true;
      this.#showState(this.page);
    } else if (answer.patches.length === 0 && offset > 0) this.load(0);
    else {
      const tiles = answer.patches.map((patch) => ({ ...patch, mine: this.label }));
      this.show({ ...answer, offset, tiles }, null);
    }
  }

  /** @param {number} offset @param {number} limit @param {(error: ApiError) => unknown} failed */
  #ask(offset, limit, failed) {
    return this.asking.get("/api/sheet", { class: this.label, offset, limit }, failed);
  }

  /** While features are being computed, ask how far they are; order anew only untouched pages. */
  async #askAgain() {
    // Where the server is away the page says so; the question is asked again.
    const { page } = this;
    if (!page) return;
    const answer = await this.#ask(page.offset, 1, () => this.#showState(page));
    if (!answer) return;
    const { done, of, ready } = answer;
    Object.assign(page, { done, of });
    if (ready && this.#untouched()) return void this.load(page.offset, { quietly: true });
    page.newOrder = ready;
    this.#showState(page);
  }

  #untouched() {
    const { busy, selection } = this.grid;
    if (busy || selection.chosen.size > 0 || selection.pointed) return false;
    return this.#still().length === this.page?.tiles.length;
  }

  /** The tiles that are still of this class. */
  #still() {
    return (this.page?.tiles ?? []).filter((tile) => mineOf(tile) === this.label);
  }

  reload() {
    if (this.page) this.load(this.page.offset);
  }

  /** The next page starts after what is still of this class, so that relabelling skips nothing. */
  turn(/** @type {number} */ step) {
    if (!this.page) return;
    const { offset, tiles, total } = this.page;
    if (step > 0 && offset + tiles.length >= total) return say("This is the last page.");
    if (step < 0 && offset === 0) return say("This is the first page.");
    this.load(Math.max(0, offset + (step > 0 ? this.#still().length : -PAGE)));
  }

  // ---- What is shown

  #showTabs() {
    const audit = el("a", { class: "tab", text: "Audit", href: "#/audit" });
    audit.title = "labels that a model which did not learn them contradicts";
    const tabs = mission.classes.map(({ name }) =>
      tab(classTag(name), mission.counts[name] ?? 0, addressOf(name), name === this.label),
    );
    this.tabs.replaceChildren(...tabs, audit);
  }

  #showState(/** @type {SheetPage} */ { total, offset, tiles, ready, by, done, of, newOrder }) {
    const first = tiles.length > 0 ? offset + 1 : 0;
    const numbers = [first, offset + tiles.length, total];
    const [from, to, all] = numbers.map((n) => n.toLocaleString("en"));
    this.range.textContent = `${from}–${to} of ${all}`;
    this.grid.element.dataset.empty = total ? "" : `You have labelled no patch ${this.label} yet.`;
    const waiting = ready ? "" : ` (features ${done} of ${of} frames)`;
    const news = newOrder ? " The order is ready: press r to see it." : "";
    const odd = tiles.some((tile) => tile.value !== null) ? "; odd ones first" : "";
    const words = `${by[0].toUpperCase()}${by.slice(1)}${odd}${waiting}.${news}`;
    this.words.textContent = total ? words : "";
    if (total === 0) {
      this.words.append(nothingYet("Labels are given frame by frame.", "Label frames", "#/label"));
      return;
    }
    clearTimeout(this.timer);
    if (!ready && !newOrder) this.timer = setTimeout(() => this.#askAgain(), ASK_AGAIN_MS);
  }

  chosenWords(/** @type {number} */ count) {
    return `Relabel ${count > 0 ? `${count} selected` : "this one"} as`;
  }

  about(/** @type {SheetTile} */ tile) {
    const now = mineOf(tile);
    const odd = tile.value === null ? [] : [`Ordered by its value, ${tile.value.toFixed(2)}.`];
    return [now ? `Labelled ${now}.` : "No label.", ...odd, "Enter opens its frame."];
  }

  describe(/** @type {SheetTile} */ tile) {
    const now = mineOf(tile);
    if (now === this.label) return { name: nameOf(tile), lines: [] };
    const lines = [now ? classTag(now) : el("span", { text: "no label" })];
    return { name: `${nameOf(tile)}, now ${now ?? "without label"}`, lines, faded: true };
  }

  /** Give the selected patches another label; null takes it away. */
  relabel(/** @type {?string} */ name) {
    const targets = this.targets();
    if (targets.length === 0) return;
    const count = relabel(targets, () => name);
    this.grid.select((selection) => selection.clear());
    const now = name === null ? "without a label" : name;
    if (count === 0) say(`Nothing to change: ${patchesAre(targets.length)} ${now} already.`);
    else say(`${patchesAre(count)} now ${now}; Ctrl+Z undoes.`);
  }
}

// ---- How tiles look

function look() {
  const width = SIZES.includes(setting("tileWidth")) ? setting("tileWidth") : 84;
  const margin = MARGINS.includes(setting("tileMargin")) ? setting("tileMargin") : 0.25;
  return { width, margin };
}

function resize(/** @type {number} */ step) {
  const at = SIZES.indexOf(look().width) + step;
  setSetting("tileWidth", SIZES[Math.max(0, Math.min(SIZES.length - 1, at))]);
}

function changeMargin() {
  setSetting("tileMargin", MARGINS[(MARGINS.indexOf(look().margin) + 1) % MARGINS.length]);
}

// ---- The view

/** The view's state; all of it. */
const view = {
  /** @type {?ReviewSheet} Null while another view is shown. */
  sheet: null,
  label: "",
  /** @type {Map<string, {page: SheetPage, cursor: ?number}>} By class: where the person was. */
  places: new Map(),
};

async function show(/** @type {HTMLElement} */ root, /** @type {string[]} */ [name]) {
  leave();
  view.label = mission.classes.some((known) => known.name === name) ? name : firstLabelled();
  const here = (view.sheet = new ReviewSheet(view.label));
  root.replaceChildren(here.root);
  here.grid.focus();
  await lookAtShapes();
  if (here !== view.sheet) return;
  const place = view.places.get(view.label);
  if (place) here.show(place.page, place.cursor);
  else here.load(0);
}

function leave() {
  const { sheet, label, places } = view;
  if (sheet?.page) places.set(label, { page: sheet.page, cursor: sheet.cursor() });
  sheet?.close();
  view.sheet = null;
}

function firstLabelled() {
  const { classes, counts } = mission;
  return classes.find(({ name }) => counts[name] > 0)?.name ?? classes[0].name;
}

function addressOf(/** @type {string} */ name) {
  return `#/sheet/${encodeURIComponent(name)}`;
}

function turnClass(/** @type {number} */ step) {
  const names = mission.classes.map((known) => known.name);
  go(addressOf(names[(names.indexOf(view.label) + step + names.length) % names.length]));
}

const row = sheetRow(() => view.sheet);

addView("sheet", {
  title: "Review sheet",
  show,
  hide: leave,
  link: () => addressOf(view.label || firstLabelled()),
  classKeys: (name) => view.sheet?.relabel(name),
  keys: [
    { keys: ["class key"], does: "relabel the selected patches" },
    row(["Delete", "Backspace"], "take their labels away", (it) => it.relabel(null)),
    row(["Enter"], "open the frame of the patch", (it) => it.openCurrent()),
    row(["d", "PageDown"], "next page", (it) => it.turn(1)),
    row(["a", "PageUp"], "previous page", (it) => it.turn(-1)),
    row(["c"], "next class", () => turnClass(1)),
    row(["C"], "class before", () => turnClass(-1)),
    row(["+"], "larger pictures", () => resize(1)),
    row(["-"], "smaller pictures", () => resize(-1)),
    row(["m"], "more or less around each patch", changeMargin),
    row(["r"], "reload, in the newest order", (it) => it.reload()),
    ...lookKeys,
    ...selectionKeys(() => view.sheet?.grid),
  ],
});

const refresh = () => view.sheet?.refresh();
onLabels(soon(refresh));
onChange(soon(refresh));
onReload(() => {
  view.places.clear();
  view.sheet?.load(0);
});
onSetting((name) => {
  if (["tileWidth", "tileMargin", "enhance"].includes(name)) view.sheet?.redraw();
});
