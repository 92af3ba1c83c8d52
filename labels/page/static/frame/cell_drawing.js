// Drawing what is known of patches onto a canvas: outlines inside their borders, signs, values.
// The texture in the middle of a patch stays free.

import { colourOf, signOf } from "../core/mission.js";
import { cellAt, rowCol } from "./patch_grid.js";

const HINT_DASH = { strong: [8, 4], kept: [2, 3], weak: [2, 8] };
const TEXT_FROM = 34; // CSS pixels of patch width from which text fits
const MARK_FROM = 16;

/**
 * @typedef {Object} CellPlan
 * @property {CanvasRenderingContext2D} ctx Scaled so that one unit is one CSS pixel.
 * @property {(cell: number) => {x: number, y: number, width: number, height: number}} boxOf
 */

/**
 * Outline regions of equal labels: solid, with a dark rim so that they show on any ground.
 * @param {CellPlan} plan
 * @param {(?string)[]} labels
 */
export function drawLabels(plan, labels) {
  for (const [label, path] of outlines(labels, plan.boxOf, 2.5)) {
    strokeTwice(plan.ctx, path, colourOf(label), label === "unsure" ? [2, 3] : []);
  }
  labels.forEach((label, cell) => label !== null && drawSign(plan, cell, label, true));
}

/**
 * Outline unconfirmed labels: dashed, those from the frame before dotted, the less sure ones thinly
 * so; with the value or a word in each patch.
 * @param {CellPlan} plan
 * @param {(?{label: string, text: string, strong: boolean, kept: boolean})[]} hints
 */
export function drawHints(plan, hints) {
  const groups = hints.map((hint) => hint && `${hint.label}/${styleOf(hint)}`);
  for (const [group, path] of outlines(groups, plan.boxOf, 3.5)) {
    const [label, style] = group.split("/");
    strokeTwice(plan.ctx, path, colourOf(label), HINT_DASH[style], 1.75);
  }
  hints.forEach((hint, cell) => {
    if (!hint) return;
    const { x, y, width } = plan.boxOf(cell);
    plan.ctx.globalAlpha = hint.strong ? 1 : 0.7;
    drawSign(plan, cell, hint.label, false);
    if (width >= TEXT_FROM) smallText(plan.ctx, hint.text, x + width - 5, y + 5, "right");
    plan.ctx.globalAlpha = 1;
  });
}

function styleOf({ strong, kept }) {
  if (kept) return "kept";
  return strong ? "strong" : "weak";
}

/**
 * Mark patches that the server has not acknowledged.
 * @param {CellPlan} plan
 * @param {Iterable<number>} cells
 */
export function drawPending({ ctx, boxOf }, cells) {
  for (const cell of cells) {
    const { x, y, width, height } = boxOf(cell);
    ctx.fillStyle = "#ffb000";
    ctx.strokeStyle = "#000";
    ctx.lineWidth = 1;
    ctx.beginPath();
    ctx.arc(x + width - 9, y + height - 9, 3.5, 0, 2 * Math.PI);
    ctx.fill();
    ctx.stroke();
  }
}

/**
 * What others said: an initial and the class's sign in the lower left corner, a mark in the right
 * one where two people are sure of different classes; a settled patch shows a tick.
 * @param {CellPlan} plan
 * @param {{mine: (?string)[], others: Object, settled: (?string)[]}} labels
 */
export function drawOthers(plan, { mine, others, settled }) {
  const people = Object.entries(others);
  for (let cell = 0; cell < mine.length; cell += 1) {
    const said = people.filter(([, theirs]) => theirs[cell] !== null);
    const decided = settled[cell];
    if (!said.length && decided === null) continue;
    const box = plan.boxOf(cell);
    if (box.width < MARK_FROM) continue;
    const differ = decided === null && disagree([mine[cell], ...said.map(([, all]) => all[cell])]);
    if (differ) drawDisagreement(plan, box);
    if (box.width < TEXT_FROM) continue;
    const words = said.slice(0, 2).map(([name, all]) => name.slice(0, 1) + signOf(all[cell]));
    if (said.length > 2) words.push("+");
    if (decided !== null) words.push(`✓${signOf(decided)}`);
    smallText(plan.ctx, words.join(" "), box.x + 5, box.y + box.height - 15, "left");
  }
}

/** Whether two of these labels are sure and different. */
export function disagree(labels) {
  const sure = new Set(labels.filter((label) => label !== null && label !== "unsure"));
  return sure.size > 1;
}

function drawDisagreement({ ctx }, { x, y, width, height }) {
  Object.assign(ctx, { font: "700 18px system-ui, sans-serif", lineWidth: 4, lineJoin: "round" });
  Object.assign(ctx, { textAlign: "right", textBaseline: "bottom" });
  rimmedText(ctx, "≠", x + width - 5, y + height - 3, { rim: "#000000", ink: "#ff7aa2" });
}

/**
 * Show the cursor and the selected rectangle.
 * @param {CellPlan} plan
 * @param {?number} cursor
 * @param {number[]} selection
 */
export function drawCursor(plan, cursor, selection) {
  const { ctx, boxOf } = plan;
  for (const cell of selection) {
    const { x, y, width, height } = boxOf(cell);
    ctx.fillStyle = "rgb(255 255 255 / 14%)";
    ctx.fillRect(x, y, width, height);
  }
  if (cursor === null) return;
  const { x, y, width, height } = boxOf(cursor);
  const path = new Path2D();
  path.rect(x - 0.5, y - 0.5, width + 1, height + 1);
  strokeTwice(ctx, path, "#ffffff", [], 2);
}

/**
 * Fill patches faintly: the stroke that is being drawn.
 * @param {CellPlan} plan
 * @param {Iterable<number>} cells
 * @param {?string} label Null takes labels back.
 */
export function drawStroke({ ctx, boxOf }, cells, label) {
  ctx.globalAlpha = 0.35;
  ctx.fillStyle = label === null ? "#000000" : colourOf(label);
  for (const cell of cells) {
    const { x, y, width, height } = boxOf(cell);
    ctx.fillRect(x + 1, y + 1, width - 2, height - 2);
  }
  ctx.globalAlpha = 1;
}

/**
 * The outlines of areas of equal patches.
 * @param {(?string)[]} keys One a cell: what is equal; null: none.
 * @param {(cell: number) => Object} boxOf
 * @param {number} inset How far inside the patches the lines lie.
 * @param {number} [cut] How much shorter they are at corners.
 * @returns {Map<string, Path2D>} By key.
 */
export function outlines(keys, boxOf, inset, cut = inset) {
  const paths = new Map();
  keys.forEach((key, cell) => {
    if (key === null) return;
    if (!paths.has(key)) paths.set(key, new Path2D());
    addEdges(paths.get(key), boxOf(cell), cell, keys, inset, cut);
  });
  return paths;
}

// Edges towards a patch with another key.
function addEdges(path, { x, y, width, height }, cell, keys, inset, cut) {
  const [row, col] = rowCol(cell);
  const same = (r, c) => keys[cellAt(r, c)] === keys[cell];
  const up = same(row - 1, col);
  const down = same(row + 1, col);
  const left = same(row, col - 1);
  const right = same(row, col + 1);
  const x0 = x + (left ? 0 : cut);
  const x1 = x + width - (right ? 0 : cut);
  const y0 = y + (up ? 0 : cut);
  const y1 = y + height - (down ? 0 : cut);
  const edges = [
    [up, x0, y + inset, x1, y + inset],
    [down, x0, y + height - inset, x1, y + height - inset],
    [left, x + inset, y0, x + inset, y1],
    [right, x + width - inset, y0, x + width - inset, y1],
  ];
  for (const [joined, fromX, fromY, toX, toY] of edges) {
    if (joined) continue;
    path.moveTo(fromX, fromY);
    path.lineTo(toX, toY);
  }
}

function strokeTwice(ctx, path, colour, dash, width = 2) {
  ctx.lineCap = "butt";
  ctx.setLineDash([]);
  ctx.lineWidth = width + 1.5;
  ctx.strokeStyle = "rgb(0 0 0 / 55%)";
  ctx.stroke(path);
  ctx.setLineDash(dash);
  ctx.lineWidth = width;
  ctx.strokeStyle = colour;
  ctx.stroke(path);
  ctx.setLineDash([]);
}

function drawSign({ ctx, boxOf }, cell, label, sure) {
  const { x, y, width } = boxOf(cell);
  if (width < MARK_FROM) return;
  const size = width < TEXT_FROM ? 9 : 13;
  const left = x + 4;
  const top = y + 4;
  const colour = colourOf(label);
  ctx.fillStyle = sure ? colour : "rgb(0 0 0 / 60%)";
  ctx.fillRect(left, top, size, size);
  ctx.fillStyle = sure ? inkOn(colour) : lighter(colour);
  const font = `600 ${size - 2}px system-ui, sans-serif`;
  Object.assign(ctx, { font, textAlign: "center", textBaseline: "middle" });
  ctx.fillText(signOf(label), left + size / 2, top + size / 2 + 0.5);
}

function smallText(ctx, text, x, y, textAlign) {
  Object.assign(ctx, { font: "10px system-ui, sans-serif", lineWidth: 3, lineJoin: "round" });
  Object.assign(ctx, { textAlign, textBaseline: "top" });
  rimmedText(ctx, text, x, y, { rim: "rgb(0 0 0 / 75%)", ink: "#f2f2f2" });
}

/** Write a text with a rim, so that it shows on any ground. */
export function rimmedText(ctx, text, x, y, { rim, ink }) {
  ctx.strokeStyle = rim;
  ctx.strokeText(text, x, y);
  ctx.fillStyle = ink;
  ctx.fillText(text, x, y);
}

function channels(colour) {
  return [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
}

/** Black or white: what reads better on a colour. */
export function inkOn(colour) {
  const [r, g, b] = channels(colour).map((value) => {
    const part = value / 255;
    return part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
  });
  const luminance = 0.2126 * r + 0.7152 * g + 0.0722 * b;
  return luminance > 0.179 ? "#000000" : "#ffffff";
}

function lighter(colour) {
  const [r, g, b] = channels(colour).map((value) => Math.round(value + (255 - value) * 0.45));
  return `rgb(${r} ${g} ${b})`;
}

/**
 * Fold the upper right corner of patches that have a note.
 * @param {CellPlan} plan
 * @param {{cell: ?number}[]} notes
 */
export function drawNotes({ ctx, boxOf }, notes) {
  for (const { cell } of notes) {
    if (cell === null) continue;
    const { x, y, width, height } = boxOf(cell);
    const size = Math.min(11, width / 3, height / 3);
    ctx.beginPath();
    ctx.moveTo(x + width - size, y);
    ctx.lineTo(x + width, y);
    ctx.lineTo(x + width, y + size);
    ctx.closePath();
    Object.assign(ctx, { fillStyle: "#ffffff", strokeStyle: "#000000", lineWidth: 1.5 });
    ctx.fill();
    ctx.stroke();
  }
}
