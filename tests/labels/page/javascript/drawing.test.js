import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { mission } from "../../../../labels/page/static/core/mission.js";
import { describeCell, describeFrame, describeInfo } from "../../../../labels/page/static/frame/frame_bar.js";
import { noteWords } from "../../../../labels/page/static/frame/notes.js";
import { Timeline, niceStep } from "../../../../labels/page/static/frame/timeline.js";
import { Viewport } from "../../../../labels/page/static/frame/viewport.js";
import { disagree, firstOfAreas, shownCell } from "../../../../labels/page/static/labelling/cell_drawing.js";
import { TileSelection } from "../../../../labels/page/static/sheets/tile_grid.js";
import { patchInTile } from "../../../../labels/page/static/sheets/tile_pictures.js";
import { loaded } from "./missions.js";

beforeEach(() => loaded());

const close = (value, wanted) => assert.ok(Math.abs(value - wanted) < 1e-9, `${value}, not ${wanted}`);

test("a label is solid; a proposal is dashed where sure, dotted where not, and says why", () => {
  assert.deepEqual(shownCell("reef", null), { label: "reef", line: "solid", mark: "" });
  assert.equal(shownCell(null, null), null);
  const hint = { label: "sand", strong: true, kept: false, against: false };
  assert.deepEqual(shownCell(null, hint), { label: "sand", line: "dashed", mark: "" });
  assert.equal(shownCell(null, { ...hint, strong: false, kept: true }).mark, "?→");
  assert.equal(shownCell(null, { ...hint, against: true }).mark, "≠");
});

test("people disagree where two are sure of different classes", () => {
  assert.equal(disagree(["reef", "reef", null]), false);
  assert.equal(disagree(["reef", "unsure"]), false);
  assert.equal(disagree(["reef", null, "sand"]), true);
});

test("an area has one first cell, which a frame of one class shows at once too", () => {
  assert.deepEqual(firstOfAreas(["a", "b", "a", "a", "a", "b", null, "a", "a", "a", "a", null]), [0, 1, 2]);
  const { grid } = mission;
  mission.grid = { rows: 20, cols: 20, width: null };
  assert.deepEqual(firstOfAreas(Array(400).fill("reef")), [0]);
  mission.grid = grid;
});

function viewport() {
  const made = new Viewport();
  Object.assign(made, { canvas: { width: 432, height: 326 }, frame: { width: 400, height: 300 } });
  return made; // 400 x 300 CSS pixels of room
}

test("what is under the pointer stays there while zooming", () => {
  const view = viewport();
  assert.equal(view.scale, 1);
  const before = view.toFrame(126, 95);
  view.zoomBy(4, 126, 95);
  const after = view.toFrame(126, 95);
  assert.equal(view.scale, 4);
  close(after.x, before.x);
  close(after.y, before.y);
});

test("the frame's edge does not come inside the canvas, and a box is brought into sight", () => {
  const view = viewport();
  view.pan(50, 50);
  assert.deepEqual(view.centre, { x: 0.5, y: 0.5 }); // it fits: nothing to move
  view.zoomMiddle(2);
  view.pan(9999, 9999);
  assert.deepEqual(view.centre, { x: 0.25, y: 0.25 });
  view.reveal({ x: 390, y: 290, width: 10, height: 10 });
  close(view.centre.x, 0.75);
  view.fit();
  assert.deepEqual([view.zoom, view.centre], [1, { x: 0.5, y: 0.5 }]);
  view.zoomMiddle(1e6);
  assert.equal(view.zoom, 24);
});

test("steps between ticks are 1, 2 or 5 times a power of ten", () => {
  assert.deepEqual([0.3, 1, 3, 7, 12, 500, 501].map(niceStep), [1, 1, 5, 10, 20, 500, 1000]);
});

function strip(change) {
  const made = Object.create(Timeline.prototype);
  const canvas = { clientWidth: 700, getBoundingClientRect: () => ({ left: 100, width: 700 }) };
  return Object.assign(made, { canvas, camera: "left", frame: 10, from: 0, span: Infinity, invalidate() {} }, change);
}

test("the strip shows all frames, or some from a frame on, and finds the one under the pointer", () => {
  const all = strip();
  assert.deepEqual([all.shown, all.xOf(2)], [7, 200]);
  assert.deepEqual([100, 450, 799, 2000].map((clientX) => all.frameAt({ clientX })), [10, 13, 22, 22]);
  const some = strip({ span: 3.5, from: 2 });
  assert.deepEqual([some.shown, some.xOf(2), some.frameAt({ clientX: 100 })], [3.5, 0, 12]);
  some.look(99);
  assert.equal(some.from, 3.5);
  some.look(-99);
  assert.equal(some.from, 0);
});

test("of frames that share a pixel the later state wins, and any that passes counts", () => {
  const found = strip().summary([10, 11, 12], ["u", "x", "d"], (_, frame) => frame === 12, 0, 3);
  assert.deepEqual([found.state, found.passes], ["x", true]);
});

const LABELS = {
  mine: ["reef", null], models: { 0: "m 1" }, others: { bob: ["sand", null] }, settled: [null, null],
  pending: new Set([0]), notes: [],
};

test("a frame and its patches in words", () => {
  assert.equal(describeFrame("left", 10, LABELS), "left frame 10 · 1 of 2 labelled · done");
  assert.equal(
    describeCell(0, LABELS, null),
    "row 0, column 0: reef, accepted from m 1, not saved yet, bob: sand, disagreement",
  );
  const hint = { label: "reef", text: "0.42", percent: 80, strong: true, kept: false, said: "reef", against: false };
  assert.match(describeCell(1, LABELS, hint), /model suggests reef, sure \(an obstacle: 80 %\)/);
  assert.match(describeCell(1, LABELS, { ...hint, kept: true, against: true, said: "water" }), /kept from the frame before, the model says water/);
});

test("when and where a frame was taken: only what is known", () => {
  const said = { time: "2024-05-06T07:08:09.5Z", depth_m: 0, heading_deg: null, latitude: 1, longitude: 2 };
  assert.equal(describeInfo(said), "2024-05-06 07:08:09 UTC, depth 0 m, 1°, 2°");
  assert.equal(describeInfo({}), "");
});

test("notes are of the patch or of the frame", () => {
  const notes = [{ cell: null, text: "murky", who: "bob" }, { cell: 1, text: "rope", who: "" }, { cell: 2, text: "no", who: "" }];
  assert.deepEqual(noteWords(notes, 1), ["note on the frame of bob: murky", "note: rope"]);
});

test("tiles are selected as in a file manager; a plain click adds", () => {
  const tiles = new TileSelection(6);
  assert.deepEqual(tiles.targets(), []); // nobody pointed at one
  tiles.toggle(1);
  tiles.toggle(4);
  assert.deepEqual(tiles.targets(), [1, 4]);
  tiles.extendTo(2);
  assert.deepEqual(tiles.targets(), [1, 2, 3, 4]);
  tiles.extendTo(5); // from where it began, not what it had reached
  assert.deepEqual(tiles.targets(), [1, 4, 5]);
  tiles.sweep(new Set([0, 1]), [1, 2], true);
  assert.deepEqual(tiles.targets(), [0]);
  tiles.clear();
  assert.deepEqual(tiles.targets(), [5]);
  tiles.move(1, false);
  assert.equal(tiles.cursor, 5);
  tiles.all();
  assert.equal(tiles.targets().length, 6);
});

test("at a frame's edge a patch is not in the middle of its tile", () => {
  const inside = patchInTile({ camera: "left", frame: 10, cell: 5 }, 100, 100, 1);
  close(inside.left + inside.width / 2, 50);
  const corner = patchInTile({ camera: "left", frame: 10, cell: 0 }, 100, 100, 1);
  assert.ok(corner.left < 1e-9 || corner.top < 1e-9);
});
