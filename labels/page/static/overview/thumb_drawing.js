// Labels drawn over a small frame: outlines of areas, solid where somebody said so, dashed where a
// confident model suggests it, dotted with a question mark where the model is not confident.
// One sign an area: signs in every patch would hide a picture this small.

import { colourOf, mission, signOf } from "../core/mission.js";
import { patchSize, rowCol } from "../frame/patch_grid.js";

const DASHES = { solid: [], dashed: [5, 3], dotted: [1.5, 3] };
const RIM = "rgb(0 0 0 / 60%)";
const INSET = 1; // CSS pixels that a line lies inside its area, so that neighbours both show
const SIDES = [
  { down: -1, right: 0, from: [0, 0], to: [1, 0] },
  { down: 1, right: 0, from: [0, 1], to: [1, 1] },
  { down: 0, right: -1, from: [0, 0], to: [0, 1] },
  { down: 0, right: 1, from: [1, 0], to: [1, 1] },
];

/**
 * @typedef {?{label: string, line: "solid" | "dashed" | "dotted"}} ShownCell
 */

/**
 * Draw the areas.
 * @param {HTMLCanvasElement} canvas
 * @param {{width: number, height: number}} size Of the picture below it, in CSS pixels.
 * @param {ShownCell[]} cells Row by row.
 * @param {?number} cursor Cell of the keyboard's cursor.
 */
export function drawAreas(canvas, { width, height }, cells, cursor) {
  const { context, size } = fresh(canvas, width, height);
  const area = areasOf(cells);
  const paths = new Map();
  cells.forEach((cell, index) => {
    if (!cell) return;
    const key = `${cell.line} ${cell.label}`;
    if (!paths.has(key)) paths.set(key, { cell, path: new Path2D() });
    addEdges(paths.get(key).path, index, area, size);
  });
  for (const { cell, path } of paths.values()) stroke(context, path, cell);
  area.forEach((first, index) => {
    if (first === index && cells[index]) write(context, index, cells[index], size);
  });
  if (cursor !== null) drawCursor(context, cursor, size);
}

function fresh(canvas, width, height) {
  const scale = Math.min(2, window.devicePixelRatio || 1);
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const context = canvas.getContext("2d");
  context.scale(scale, scale);
  return { context, size: patchSize(width, height) };
}

/** For each cell the first cell of the connected area of equal ones that it lies in. */
function areasOf(cells) {
  const same = (a, b) => a?.label === b?.label && a?.line === b?.line;
  const area = cells.map(() => -1);
  cells.forEach((cell, start) => {
    if (area[start] >= 0) return;
    area[start] = start;
    const waiting = [start];
    while (waiting.length > 0) {
      for (const next of neighbours(waiting.pop())) {
        if (next < 0 || area[next] >= 0 || !same(cell, cells[next])) continue;
        area[next] = start;
        waiting.push(next);
      }
    }
  });
  return area;
}

/** The cells above, below, left and right; -1 outside the frame. */
function neighbours(index) {
  const { rows, cols } = mission.grid;
  const [row, col] = rowCol(index);
  return SIDES.map(({ down, right }) => {
    const [r, c] = [row + down, col + right];
    return r < 0 || c < 0 || r >= rows || c >= cols ? -1 : r * cols + c;
  });
}

function addEdges(path, index, area, size) {
  const [row, col] = rowCol(index);
  neighbours(index).forEach((next, at) => {
    if (next >= 0 && area[next] === area[index]) return;
    const { down, right, from, to } = SIDES[at];
    const x = (part) => (col + part) * size.width - right * INSET;
    const y = (part) => (row + part) * size.height - down * INSET;
    path.moveTo(x(from[0]), y(from[1]));
    path.lineTo(x(to[0]), y(to[1]));
  });
}

function stroke(context, path, { label, line }) {
  context.setLineDash([]);
  context.lineWidth = 3;
  context.strokeStyle = RIM;
  if (line === "solid") context.stroke(path);
  context.setLineDash(DASHES[line]);
  context.lineWidth = 1.6;
  context.strokeStyle = colourOf(label);
  context.stroke(path);
}

function write(context, index, { label, line }, size) {
  const [row, col] = rowCol(index);
  const text = signOf(label) + (line === "dotted" ? "?" : "");
  const [x, y] = [col * size.width + 3, row * size.height + 2.5];
  context.font = "600 10px system-ui, sans-serif";
  context.textBaseline = "top";
  context.setLineDash([]);
  context.lineWidth = 3;
  context.strokeStyle = "rgb(0 0 0 / 80%)";
  context.strokeText(text, x, y);
  context.fillStyle = "#ffffff";
  context.fillText(text, x, y);
}

function drawCursor(context, cell, size) {
  const [row, col] = rowCol(cell);
  context.setLineDash([]);
  for (const [width, colour] of [
    [4, "#000000"],
    [2, "#ffffff"],
  ]) {
    context.lineWidth = width;
    context.strokeStyle = colour;
    context.strokeRect(col * size.width, row * size.height, size.width, size.height);
  }
}
