// The overview: a contact sheet of frames, on which many frames are labelled at once.

import { el, say, setAttribute, soon, targetOf } from "../core/dom.js";
import { showProgress } from "../core/progress.js";
import { labelKeys } from "../core/keys.js";
import {
  chosenClass, clearClass, frameIndex, frameOf, frames, inView, indexFrom, maskedCells, mission, onChange, onReload, onSetting, setSetting,
  setting,
} from "../core/mission.js";
import { frameAspect, lookAtShapes, thumbAddress } from "../core/pictures.js";
import { addView, go, noteAddress } from "../core/router.js";
import { ARROWS, arrowKeys, cellAt, cellFrom } from "../core/patch_grid.js";
import { passesBlindList, tryBlindList } from "../labelling/blind_list.js";
import { filterWords, onClassFrames, passing } from "../labelling/filters.js";
import { putOffWords } from "../labelling/obstacle_class.js";
import { leftWords, restOf, withKnownClass } from "../labelling/painting.js";
import { framesFollowed, kindOf, modelObstacles } from "../labelling/suggest.js";
import { labelsOf, onLabels, prefetch } from "../saving/labels.js";
import { act, actOn, changesOf, patchesAre, withdraw } from "../saving/saver.js";
import { OverviewBar, rangeWords } from "./overview_bar.js";
import { newPage, page, parts, view } from "./overview_state.js";
import { Thumb, contentOf } from "./thumb.js";
import { paintOver } from "./thumb_painting.js";
/** @import { Cells, KeyEntry, LabelledPatch, Tally, ThumbContent } from "../types.js" */

const GAP = 6;
const CAPTION = 20;
const CAPTION_WIDTH = 150; // CSS pixels that the longest one takes
const COLUMNS = { least: 2, most: 10, usual: 7 };
const MAX_BEFORE = 120; // frames fetched only because suggestions depend on them
const UNSURE = "unsure";
const MIN_WIDTH = 60; // CSS pixels
const MIN_HEIGHT = 40;
// So much of a row may be missing: pictures a little smaller are better than an empty strip.
const SQUEEZED = 0.2;

async function show(/** @type {HTMLElement} */ root, /** @type {string[]} */ [camera, first]) {
  const known = camera in mission.cameras ? camera : Object.keys(mission.cameras)[0];
  const wanted = newPage(known, first ? frameOf(first) : frames(known)[0]);
  if (view.parts && view.page?.camera === known) {
    const at = page().thumbs.findIndex(({ frame }) => frame === wanted.first);
    if (at >= 0) return focusOn(at);
    wanted.asked = wanted.first; // an undo names a frame to see, whatever is filtered
  }
  view.last = wanted;
  if (view.page?.camera === known) wanted.excluded = page().excluded;
  if (!view.parts) {
    const made = (view.parts = { ...build(), host: root });
    root.replaceChildren(made.root);
    made.resized.observe(made.list);
  }
  parts().list.focus({ preventScroll: true });
  await Promise.all([lookAtShapes(), tryBlindList()]);
  if (!view.parts || view.last !== wanted) return;
  view.page = wanted;
  layOut();
}

/** Another person works here, or blind, or the mission was loaded anew. */
function showAnew() {
  const { host } = parts();
  const left = view.page;
  hide();
  view.page = left; // which frames are left out
  if (view.last) show(host, [view.last.camera, String(view.last.first)]);
}

function addressOf() {
  return view.last ? `#/overview/${view.last.camera}/${view.last.first}` : "#/overview";
}

function hide() {
  parts().resized.disconnect();
  view.parts = null;
  view.page = null;
}

function build() {
  const list = el("div", {
    class: "thumbs",
    role: "listbox", tabindex: "0", "aria-label": "frames", "data-home": true,
  });
  list.addEventListener("click", clicked);
  list.addEventListener("pointerdown", () => (view.painted = null));
  paintOver(list, { thumbAt, allThumbs, onStroke, onPainted });
  const does = { accept: accepting, rest: restOfAll, turn, resize, otherCamera };
  const bar = new OverviewBar(does);
  const options = { class: "overview", "aria-label": "overview of frames" };
  const stage = el("div", { class: "stage" }, bar.element, list);
  const root = el("section", options, bar.tools.root, stage, bar.drawer.root);
  return { root, list, bar, resized: new ResizeObserver(soon(relayOut)) };
}

// ---- Which frames

/** Blind, and asked to label what somebody labelled: only those frames. */
function keeps(/** @type {number} */ frame) {
  const { camera, asked, passes } = page();
  return passesBlindList(camera, frame) && (frame === asked || passes(camera, frame));
}

function columns() {
  const whole = Math.max(COLUMNS.least, Math.floor(parts().list.clientWidth / CAPTION_WIDTH));
  return setting("overviewColumns") || Math.min(COLUMNS.usual, whole);
}

/** How many thumbnails fit, and the size of each one's picture in CSS pixels. */
function size() {
  const style = getComputedStyle(parts().list);
  const [left, right] = [parseFloat(style.paddingLeft), parseFloat(style.paddingRight)];
  const across = parts().list.clientWidth - left - right;
  const [top, bottom] = [parseFloat(style.paddingTop), parseFloat(style.paddingBottom)];
  const down = parts().list.clientHeight - top - bottom;
  const aspect = frameAspect(page().camera);
  const share = Math.floor((across - (columns() - 1) * GAP) / columns());
  const widest = Math.max(MIN_WIDTH, share);
  const highest = Math.round(widest * aspect);
  const fitting = (down + GAP) / (highest + CAPTION + GAP);
  const rows = Math.max(1, Math.floor(fitting + SQUEEZED));
  const room = Math.floor((down + GAP) / rows - GAP - CAPTION); // for the height of each picture
  const height = Math.min(highest, Math.max(room, MIN_HEIGHT));
  const width = Math.min(widest, Math.round(height / aspect));
  return { count: rows * columns(), width, height };
}

// The first `count` frames from index `from` on that are shown.
/** @param {number[]} list @param {number} from @param {number} count */
function framesFrom(list, from, count) {
  const found = [];
  for (let at = from; at < list.length && found.length < count; at += 1) {
    if (keeps(list[at])) found.push(list[at]);
  }
  return found;
}

// The last `count` frames before index `until` that are shown, ascending.
/** @param {number[]} list @param {number} until @param {number} count */
function framesBefore(list, until, count) {
  return framesFrom(list.slice(0, until).reverse(), 0, count).reverse();
}

function layOut() {
  showProgress(page().camera);
  const { camera, first } = page();
  const { count, width, height } = size();
  const list = frames(camera);
  page().passes = passing();
  const shown = framesFrom(list, indexFrom(camera, first), count);
  // Who makes the window or the pictures larger still means to leave the same frames out.
  const excluded = new Set(shown.filter((frame) => page().excluded.has(frame)));
  const focus = Math.max(0, shown.indexOf(focused()?.frame ?? -1));
  Object.assign(page(), { count, width, excluded, focus });
  Object.assign(page(), { stroke: null, touched: new Set() });
  // Those that are seen stay: what is said of others that are loading may take a line, and the
  // thumbnails would be laid out anew without end.
  const seen = new Map(page().thumbs.filter((one) => one.seen).map((one) => [one.frame, one]));
  const told = { onShape: layOutSoon, onPicture: drawSoon };
  page().thumbs = shown.map((frame) => seen.get(frame) ?? new Thumb(camera, frame, told));
  page().thumbs.forEach((thumb, index) => thumb.place(`thumb-${index}`, width, height));
  parts().list.replaceChildren(...page().thumbs.map((thumb) => thumb.element));
  if (shown.length === 0) parts().list.append(el("p", { class: "empty-state", text: nothing() }));
  draw();
  prefetch(camera, needed(shown)).then(readAhead);
}

/** These frames, and those before them that their suggestions depend on. */
function needed(/** @type {number[]} */ shown) {
  const before = shown.flatMap((frame) => framesFollowed(page().camera, frame));
  return [...new Set([...before.slice(0, MAX_BEFORE), ...shown])];
}

function nothing() {
  const keys = "/ filters, Page Up goes back.";
  return `From frame ${page().first} on there is nothing: ${filterWords()}. ${keys}`;
}

function relayOut() {
  if (!view.page) return;
  const { count, width } = size();
  if (count !== page().count || width !== page().width) layOut();
}

const layOutSoon = soon(() => view.page && layOut());

/** The next page's labels and pictures, so that going on is instant. */
function readAhead() {
  if (!view.page) return;
  const next = nextFrames();
  prefetch(page().camera, needed(next));
  for (const frame of next) {
    new Image().src = thumbAddress(page().camera, frame, page().width);
  }
}

function nextFrames() {
  const { camera, thumbs, count } = page();
  if (thumbs.length === 0) return [];
  return framesFrom(frames(camera), frameIndex(camera, thumbs[thumbs.length - 1].frame) + 1, count);
}

// ---- What is shown

function draw() {
  if (!view.page) return;
  // What was forgotten, or could not be had when it was asked for.
  const missing = page().thumbs.filter(({ camera, frame }) => !labelsOf(camera, frame));
  if (missing.length > 0) prefetch(page().camera, missing.map(({ frame }) => frame));
  page().thumbs.forEach(drawThumb);
  const active = page().thumbs.length > 0 && `thumb-${page().focus}`;
  setAttribute(parts().list, "aria-activedescendant", active);
  showWords();
}

const drawSoon = soon(draw);

function drawThumb(/** @type {Thumb} */ thumb) {
  const { stroke, excluded, cell } = page();
  const focus = thumb === focused();
  const cells = stroke?.cells.get(thumb);
  thumb.draw({
    excluded: excluded.has(thumb.frame),
    painted: stroke && cells ? new Map([...cells].map((one) => [one, stroke.label])) : null,
    cursor: focus ? cell : null,
  });
  thumb.element.setAttribute("aria-selected", String(focus));
}

/** A stroke goes on: only the thumbnails that it has touched change. */
const drawStrokeSoon = soon(() => view.page?.touched.forEach(drawThumb));

function showWords() {
  const { camera, thumbs } = page();
  const range = thumbs.length
    ? rangeWords(camera, thumbs.map(({ frame }) => frame))
    : `${camera}: no frame`;
  parts().bar.show(range, tally((thumb) => thumb.content));
}

/** Patches of the frames that Enter works on, by what would happen to them. */
function tally(/** @type {(thumb: Thumb) => ?ThumbContent} */ contentFor) {
  /** @type {Tally} */
  const sum = { strong: 0, weak: 0, open: 0, waiting: 0 };
  for (const thumb of worked()) {
    const content = contentFor(thumb);
    if (!content || content.waits || thumb.seen === null) sum.waiting += 1;
    const { mine = [], hints = [] } = content ?? {};
    sum.open += inView(thumb.camera, mine.keys()).filter((cell) => mine[cell] === null).length;
    for (const hint of hints) if (hint) sum[hint.strong ? "strong" : "weak"] += 1;
  }
  return sum;
}

/** The frames that can be seen, or soon will be, and are not left out. */
function worked() {
  return page().thumbs.filter((thumb) => thumb.seen !== false && !page().excluded.has(thumb.frame));
}

// ---- What a person does

function accepting(/** @type {boolean} */ all) {
  if (page().thumbs.length === 0) return;
  const { waiting, open } = tally(({ camera, frame }) => contentOf(camera, frame));
  if (waiting > 0) return sayWaiting(waiting);
  const patches = withKnownClass(worked().flatMap((thumb) => suggestedPatches(thumb, all)));
  if (!patches) return;
  const count = actOn("accept", patches);
  const left = open - count;
  if (count > 0 && left > 0) {
    return say(`${patchesAre(count)} accepted; ${left} wait for you. Enter again goes on.`);
  }
  goOn(count > 0 ? `${patchesAre(count)} accepted; Ctrl+Z undoes.` : putOffWords() || "Nothing to accept here.");
}

function sayWaiting(/** @type {number} */ count) {
  say(`${count} of the frames shown are still being loaded.`, { bad: true });
}

/** @param {Thumb} thumb @param {boolean} all @returns {LabelledPatch[]} */
function suggestedPatches({ camera, frame }, all) {
  return (contentOf(camera, frame)?.hints ?? []).flatMap((hint, cell) => {
    if (!hint || !(all || hint.strong)) return [];
    return [{ camera, frame, cell, label: hint.label, base: null, model: hint.model }];
  });
}

function restOfAll() {
  // What was not on the screen is nobody's judgement.
  const waiting = worked().filter(({ seen, content }) => !seen || !content).length;
  const rests = worked().map(({ camera, frame }) => ({ camera, frame, ...restOf(camera, frame) }));
  const unknown = rests.filter(({ waits }) => waits).length;
  if (waiting + unknown > 0) return sayWaiting(Math.max(waiting, unknown));
  const patches = rests.flatMap(({ camera, frame, cells }) =>
    cells.map((cell) => ({ camera, frame, cell, label: clearClass(), base: null })),
  );
  const count = actOn("rest", patches);
  const left = rests.reduce((sum, rest) => sum + rest.left, 0);
  const words = count > 0 ? `${patchesAre(count)} now ${clearClass()}; Ctrl+Z undoes.` : "";
  if (left > 0) return say(`${words} ${leftWords(left)}`.trim());
  goOn(words || "All labelled.");
}

function goOn(/** @type {string} */ words) {
  const more = nextFrames().length > 0;
  say(more ? words : `${words} This is the last page.`);
  if (more) turn(1);
}

function turn(/** @type {number} */ step) {
  const { camera, first, count } = page();
  const before = () => framesBefore(frames(camera), indexFrom(camera, first), count);
  const [found] = step > 0 ? nextFrames() : before();
  if (found === undefined) say(`This is the ${step > 0 ? "last" : "first"} page.`);
  else go(`#/overview/${camera}/${found}`);
}

function resize(/** @type {number} */ step) {
  setSetting("overviewColumns", Math.max(COLUMNS.least, Math.min(COLUMNS.most, columns() - step)));
}

function otherCamera() {
  const names = Object.keys(mission.cameras);
  const next = names[(names.indexOf(page().camera) + 1) % names.length];
  go(`#/overview/${next}/${page().first}`);
}

function exclude(/** @type {Thumb | undefined} */ thumb) {
  if (!thumb) return;
  if (!page().excluded.delete(thumb.frame)) page().excluded.add(thumb.frame);
  draw();
}

function focused() {
  return view.page?.thumbs.at(page().focus);
}

function open(/** @type {Thumb | undefined} */ thumb) {
  if (thumb) go(`#/label/${thumb.camera}/${thumb.frame}`);
}

function moveFrame(/** @type {KeyboardEvent} */ event) {
  const [down, right] = ARROWS[event.key];
  const next = page().focus + down * columns() + right;
  if (next in page().thumbs) focusOn(next);
}

function focusOn(/** @type {number} */ index) {
  page().focus = index;
  noteAddress(addressOf());
  draw();
  focused()?.element.scrollIntoView({ block: "nearest" });
}

function moveCell(/** @type {KeyboardEvent} */ event) {
  const { rows, cols } = mission.grid;
  const middle = cellAt(Math.floor(rows / 2), Math.floor(cols / 2));
  const { cell } = page();
  page().cell = cell === null ? middle : cellFrom(cell, ...ARROWS[event.key]);
  draw();
}

function paintCell() {
  const thumb = focused();
  const { cell } = page();
  if (thumb?.seen && cell !== null) onPainted(new Map([[thumb, new Set([cell])]]), 0);
}

// ---- Painting with the mouse

function thumbAt(/** @type {number} */ x, /** @type {number} */ y) {
  const picture = document.elementFromPoint(x, y)?.closest(".thumb-picture");
  return page().thumbs.find((thumb) => thumb.seen && thumb.picture === picture) ?? null;
}

function allThumbs(/** @type {Thumb} */ start) {
  return page().thumbs.filter(
    (thumb) => thumb === start || (thumb.seen && !page().excluded.has(thumb.frame)),
  );
}

/** A class that nobody chose is not painted with: the first one means that the way is clear. */
function labelOf(/** @type {number} */ mouseButton) {
  return mouseButton === 2 ? UNSURE : chosenClass();
}

function onStroke(/** @type {?Cells} */ cells, /** @type {number} */ mouseButton) {
  if (!view.page) return;
  const label = labelOf(mouseButton);
  page().stroke = cells && label ? { cells, label } : null;
  for (const thumb of cells?.keys() ?? []) page().touched.add(thumb);
  drawStrokeSoon();
}

/** @param {Cells} cells @param {number} mouseButton @param {Cells} [own] */
function onPainted(cells, mouseButton, own = cells) {
  if (!view.page) return;
  const label = labelOf(mouseButton);
  if (!label) {
    const keys = mission.classes.filter(({ key }) => key).map(({ key, name }) => `${key} ${name}`);
    return say(`Choose a class first, by its key: ${keys.join(", ")}.`);
  }
  /** @type {LabelledPatch[]} */
  const patches = [];
  let left = 0;
  for (const [thumb, some] of cells) {
    const { camera, frame } = thumb;
    const mine = contentOf(camera, frame)?.mine;
    if (!mine) continue;
    const masked = maskedCells(camera);
    // Where the hand was not, clear is not painted over what the model calls an obstacle.
    const obstacles = kindOf(label) === false ? modelObstacles(camera, frame) : [];
    for (const cell of some) {
      if (mine[cell] === label || masked.has(cell)) continue;
      const barred = !own.get(thumb)?.has(cell) && (!obstacles || obstacles[cell]);
      if (barred) left += 1;
      else patches.push({ camera, frame, cell, label, base: mine[cell] });
    }
  }
  // A click may be half of a double click, which opens the frame and paints nothing.
  const hold = [...cells.values()].every((some) => some.size === 1);
  view.painted = act("paint", changesOf(patches), { hold });
  if (view.painted) {
    const shown = new Set(patches.map(({ camera, frame }) => `${camera} frame ${frame}`));
    const where = shown.size === 1 ? [...shown][0] : `${shown.size} frames`;
    const words = `${patchesAre(patches.length)} now ${label}, ${where}; Ctrl+Z undoes.`;
    say(`${words} ${leftWords(left)}`.trim());
  }
  drawSoon();
}

function clicked(/** @type {MouseEvent} */ event) {
  view.clicks = [...(event.detail > 1 ? view.clicks : []), view.painted];
  const thumb = page().thumbs.find(({ element }) => element.contains(targetOf(event)));
  if (!thumb) return;
  if (event.target === thumb.leave) return exclude(thumb);
  page().focus = page().thumbs.indexOf(thumb);
  if (event.detail < 2) return draw();
  const keys = view.clicks.filter((key) => key !== null);
  keys.forEach(withdraw);
  if (keys.length > 0) say("Opened; nothing was painted.");
  open(thumb);
}

/** @type {(keys: string[], does: string, run?: KeyEntry["run"]) => KeyEntry} */
const row = (keys, does, run) => ({ keys, does, run });
/** @param {() => void} run @returns {KeyEntry["run"]} */
const once = (run) => (event) => event.repeat || run();

addView("overview", {
  title: "Overview",
  show,
  hide,
  link: addressOf,
  keys: [
    row(
      ["Enter"],
      "accept the sure suggestions of all frames shown; go on when nothing is left",
      once(() => accepting(false)),
    ),
    row(
      ["Shift+Enter"],
      "accept all suggestions of all frames shown, and go on",
      once(() => accepting(true)),
    ),
    row(["o"], "the rest of all frames shown is clear, but for obstacles; go on", once(restOfAll)),
    row(["x"], "leave this frame out of all that, or no longer", () => exclude(focused())),
    row(["d", ".", "PageDown"], "next page", () => turn(1)),
    row(["a", ",", "PageUp"], "previous page", () => turn(-1)),
    row(arrowKeys(), "move from frame to frame", moveFrame),
    row(["w"], "open this frame as a whole; so does a double click", () => open(focused())),
    row(arrowKeys("Ctrl+"), "move over the frame's patches", moveCell),
    row(["Space"], "paint the patch under the cursor", paintCell),
    row(["Drag"], "paint; also over several frames; right button: unsure"),
    row(["Shift+Drag"], "paint a rectangle"),
    row(["Ctrl+Drag"], "paint the same patches in all frames shown"),
    row(["/"], "filter: which frames are shown", () => parts().bar.nextFilter()),
    row(["s"], "the other camera", otherCamera),
    row(["+", "-"], "larger, smaller pictures", (_, key) => resize(key === "+" ? 1 : -1)),
    ...labelKeys,
  ],
});

onLabels(drawSoon);
onReload(() => view.page?.excluded.clear());
onClassFrames((first) => (first ? layOutSoon() : drawSoon()));
onChange((what) => {
  if (what === "all" && view.parts) showAnew();
  else drawSoon();
});
onSetting((name) => {
  if (name === "filter" && view.page) view.page.asked = null;
  if (["overviewColumns", "filter", "enhance"].includes(name)) layOutSoon();
  else drawSoon();
});
