import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import {
  PatchCursor, arrowKeys, cellAt, cellFrom, cellName, cellsBetween, cellsOfColumn, cellsOfRow,
  cellsOnLine, patchSize, rowCol,
} from "../../../../labels/page/static/core/patch_grid.js";
import { loaded } from "./missions.js";

beforeEach(() => loaded());

test("cells are counted row by row", () => {
  assert.deepEqual(rowCol(6), [1, 2]);
  assert.equal(cellAt(1, 2), 6);
  assert.equal(cellName(6), "row 1, column 2");
  for (const [row, col] of [[-1, 0], [0, -1], [3, 0], [0, 4]]) assert.equal(cellAt(row, col), -1);
});

test("a patch is rounded down, as in the extractors", async () => {
  assert.deepEqual(patchSize(101, 50), { width: 25, height: 16 });
  await loaded({ grid: { rows: 3, cols: 4, width: 50 } });
  // 50 x 25 pixels when resized: 12 x 8 a patch, each of them two of the frame's.
  assert.deepEqual(patchSize(100, 50), { width: 24, height: 16 });
});

test("a line leaves out no cell that it crosses, however fast the pointer was", () => {
  assert.deepEqual(cellsOnLine({ x: 0.5, y: 0.5 }, { x: 3.5, y: 0.5 }), [0, 1, 2, 3]);
  assert.deepEqual(cellsOnLine({ x: 0.5, y: 0.5 }, { x: 2.5, y: 1.5 }), [0, 1, 5, 6]);
  assert.deepEqual(cellsOnLine({ x: 3.5, y: 2.5 }, { x: 9, y: 2.5 }), [11]);
  assert.deepEqual(cellsOnLine({ x: 1.2, y: 1.2 }, { x: 1.2, y: 1.2 }), [5]);
});

test("rectangles, rows and columns", () => {
  assert.deepEqual(cellsBetween(5, 0), [0, 1, 4, 5]);
  assert.deepEqual(cellsBetween(1, 4), [0, 1, 4, 5]);
  assert.deepEqual(cellsOfRow(2), [8, 9, 10, 11]);
  assert.deepEqual(cellsOfColumn(3), [3, 7, 11]);
});

test("the cursor stops at the edge and spans a rectangle with Shift", () => {
  assert.equal(cellFrom(0, -1, -1), 0);
  assert.equal(cellFrom(11, 1, 1), 11);
  const cursor = new PatchCursor();
  cursor.move(1, 1, false);
  assert.deepEqual([cursor.visible, cursor.cell], [true, 0]); // the first press only shows it
  cursor.move(1, 1, false);
  assert.deepEqual(cursor.cells, [5]);
  cursor.move(1, 1, true);
  assert.deepEqual([cursor.spans, cursor.cells], [true, [5, 6, 9, 10]]);
  assert.equal(cursor.collapse(), true);
  assert.deepEqual(cursor.cells, [10]);
  cursor.put(3, false);
  assert.deepEqual([cursor.visible, cursor.cells, cursor.collapse()], [false, [3], false]);
});

test("the names of arrow keys carry what is held", () => {
  assert.deepEqual(arrowKeys("Ctrl+").slice(0, 2), ["Ctrl+ArrowLeft", "Ctrl+ArrowRight"]);
});
