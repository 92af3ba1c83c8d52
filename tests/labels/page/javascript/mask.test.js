import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { inView, mission } from "../../../../labels/page/static/core/mission.js";
import { describeCell, describeFrame } from "../../../../labels/page/static/frame/frame_bar.js";
import { view } from "../../../../labels/page/static/frame/frame_state.js";
import {
  drawMask, drawnMask, endDraft, isUnsaved, shownMask, unsaved,
} from "../../../../labels/page/static/frame/mask_draft.js";
import { hintsOf, restOf } from "../../../../labels/page/static/labelling/painting.js";
import { prefetch } from "../../../../labels/page/static/saving/labels.js";
import { MODEL, answers, loaded } from "./missions.js";

const masked = (...cells) => loaded({ model: { ...MODEL }, masked: { left: cells, right: [] } });

beforeEach(() => {
  Object.assign(view, { tool: "paint", drafts: {} });
  return masked(3, 7);
});

function twelve(change) {
  const labels = {
    camera: "left", frame: 10, mine: Array(12).fill(null), models: {}, others: {}, notes: [],
    settled: Array(12).fill(null), hidden: 0, suggestions: null, pending: new Set(),
  };
  return { ...labels, ...change };
}

test("a mask is of one camera", () => {
  assert.deepEqual(inView("left", [0, 3, 4, 7]), [0, 4]);
  assert.deepEqual(inView("right", [0, 3]), [0, 3]);
});

test("a stroke makes all patches what the first of them is not", () => {
  drawMask("left", [2, 3]);
  assert.deepEqual([...drawnMask("left")].sort(), [2, 3, 7]);
  drawMask("left", [3, 11]);
  assert.deepEqual([...drawnMask("left")].sort(), [2, 7]);
  assert.deepEqual(unsaved("left"), [2, 3]);
  drawMask("left", [3], true);
  assert.deepEqual(unsaved("left"), [2]);
  assert.deepEqual(unsaved("right"), []);
});

test("only in Mask mode is it shown before it is saved", () => {
  drawMask("left", [2]);
  assert.deepEqual([shownMask("left").has(2), isUnsaved("left", 2)], [false, false]);
  view.tool = "mask";
  assert.deepEqual([shownMask("left").has(2), isUnsaved("left", 2)], [true, true]);
  endDraft("left", true);
  assert.deepEqual(unsaved("left"), []);
});

test("what somebody else saves meanwhile stays, beside what is drawn here", async () => {
  drawMask("left", [2]);
  await masked(3, 7, 8);
  assert.deepEqual([...drawnMask("left")].sort(), [2, 3, 7, 8]);
  await masked(2, 3, 7, 8);
  endDraft("left");
  await masked(3, 7, 8);
  assert.deepEqual(unsaved("left"), []);
});

test("a masked patch is said to be none, and none waits for it", () => {
  const labels = twelve({ hidden: 2 });
  labels.mine.fill("reef").fill(null, 3, 4).fill(null, 7, 8);
  assert.match(describeFrame("left", 10, labels), /10 of 10 labelled, 2 hidden by the mask/);
  assert.equal(describeCell(3, labels, null), "row 0, column 3: masked: no view");
  assert.equal(describeCell(4, labels, null), "row 1, column 0: reef");
});

test("a masked patch gets no suggestion and is not of the rest", async () => {
  const says = { model: MODEL.label, classes: Array(12).fill(1), values: Array(12).fill(2), fault: "" };
  says.values[3] = says.values[7] = null;
  const frame = twelve({ suggestions: says });
  answers({ "/api/labels": { event: mission.event, frames: [frame] } });
  await prefetch("left", [10]);
  const cells = [0, 1, 2, 4, 5, 6, 8, 9, 10, 11];
  assert.deepEqual(restOf("left", 10).cells, cells);
  assert.deepEqual([...hintsOf("left", 10).entries()].filter(([, hint]) => hint).map(([cell]) => cell), cells);
});
