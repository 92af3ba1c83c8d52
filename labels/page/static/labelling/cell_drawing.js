// Drawing what is known of patches onto a canvas: tints, outlines inside their borders, signs. The
// texture in the middle of a patch stays readable; where all is clear nearly nothing is drawn.

import { contextOf } from "../core/dom.js";
import { classOf, colourOf, setting, signOf } from "../core/mission.js";
import { ARROWS, cellAt, rowCol } from "../core/patch_grid.js";
/** @import { Box, CellPlan, Context, DrawText, Hint, Note, ShownCell } from "../types.js" */
/** @import { ShownLabels } from "../types.js" */

const DASHES = { solid: [], dashed: [6, 4], dotted: [2, 6] };
const TEXT_FROM = 44; // CSS pixels of patch width from which text fits
const MARK_FROM = 16;
const HATCH = 10; // CSS pixels between two lines
const WASH = "rgb(128 128 128 / 40%)"; // over what is masked
/** What is said of a masked patch. */
export const MASKED = "masked: no view";
const FAINT = 0.5; // opacity of lines around what is clear
const BOLD = "600 14px system-ui, sans-serif";

/** What is drawn of a patch: its label, else what is proposed for it. @returns {?ShownCell} */
export function shownCell(/** @type {?string} */ label, /** @type {?Hint | undefined} */ hint) {
  if (label !== null) return { label, line: "solid", mark: "" };
  if (!hint) return null;
  const mark = hint.against ? "≠" : (hint.strong ? "" : "?") + (hint.kept ? "→" : "");
  return { label: hint.label, line: hint.strong ? "dashed" : "dotted", mark };
}

/** Draw labels, outlined solid and tinted (unsure ones hatched), and proposals, outlined dashed or,
 * if not confident, dotted. What is clear has faint lines only. `cells`: row by row.
 */
export function drawCells(/** @type {CellPlan} */ plan, /** @type {(?ShownCell)[]} */ cells) {
  const { ctx } = plan;
  const boxOf = (/** @type {number} */ cell) => snapped(plan.boxOf(cell));
  const roomy = boxOf(0).width >= TEXT_FROM;
  const width = roomy ? 2 : 1;
  const keys = cells.map((cell) => cell && Object.values(cell).join(" "));
  cells.forEach((cell, at) => cell?.line === "solid" && fill(ctx, boxOf(at), cell.label));
  for (const area of Map.groupBy(keys.keys(), (cell) => keys[cell]).values()) {
    const shown = cells[area[0]];
    if (!shown) continue;
    const path = new Path2D();
    for (const cell of area) addEdges(path, boxOf(cell), cell, keys, width / 2 + 1);
    const { label, line } = shown;
    ctx.globalAlpha = isClear(label) ? FAINT : 1;
    strokeTwice(ctx, path, colourOf(label), DASHES[line], width);
  }
  ctx.globalAlpha = 1;
  for (const at of firstOfAreas(keys)) {
    const shown = cells[at];
    if (shown) drawSign(ctx, boxOf(at), shown);
  }
}

function isClear(/** @type {?string} */ label) {
  return classOf(label).obstacle === false;
}

/** On whole pixels lines are not blurred into what lies beside them. */
function snapped(/** @type {Box} */ { x, y, width, height }) {
  const [left, top] = [Math.round(x), Math.round(y)];
  return {
    x: left, y: top, width: Math.round(x + width) - left, height: Math.round(y + height) - top,
  };
}

/** @param {Context} ctx @param {Box} box @param {string} label */
function fill(ctx, { x, y, width, height }, label) {
  if (isClear(label)) return;
  const unsure = label === "unsure";
  ctx.globalAlpha = Math.min(1, (setting("tint") / 100) * (unsure ? 2 : 1));
  ctx.fillStyle = unsure ? hatching(ctx) : colourOf(label);
  ctx.fillRect(x, y, width, height);
  ctx.globalAlpha = 1;
}

/** Thin lines, light beside dark, so that they show on any ground. */
function hatching(/** @type {Context} */ ctx) {
  return hatchingOf(ctx, [colourOf("unsure"), "#000000"], (x) => HATCH - 1 - x);
}

/** @type {Map<string, ?CanvasPattern>} By the lines' colours. */
const hatches = new Map();

/** Lines side by side in these colours; `rowOf` an x within a tile they go through.
 * @param {Context} ctx @param {string[]} colours @param {(x: number) => number} rowOf
 */
function hatchingOf(ctx, colours, rowOf) {
  const known = hatches.get(colours.join());
  if (known) return known;
  const tile = document.createElement("canvas");
  tile.width = tile.height = HATCH;
  const of = contextOf(tile);
  for (let x = 0; x < HATCH; x += 1) {
    for (const [at, colour] of colours.entries()) {
      of.fillStyle = colour;
      of.fillRect((x + at) % HATCH, rowOf(x), 1, 1);
    }
  }
  const made = ctx.createPattern(tile, "repeat");
  hatches.set(colours.join(), made);
  return made ?? colours[0];
}

/** Hatch patches that are no view, in grey and the other way than unsure ones.
 * @param {CellPlan} plan @param {Iterable<number>} cells
 */
export function drawMasked({ ctx, boxOf }, cells) {
  const lines = hatchingOf(ctx, ["#cccccc", "#cccccc", "#222222", "#222222"], (x) => x);
  for (const cell of cells) {
    const { x, y, width, height } = snapped(boxOf(cell));
    for (const style of [WASH, lines]) {
      ctx.fillStyle = style;
      ctx.fillRect(x, y, width, height);
    }
  }
}

/** Draw an eye that is struck out on patches that are not seen.
 * @param {CellPlan} plan @param {Iterable<number>} cells
 */
export function drawUnseen({ ctx, boxOf }, cells) {
  const path = new Path2D();
  for (const cell of cells) {
    const { x: left, y: top, width, height } = boxOf(cell);
    if (width < MARK_FROM) continue;
    const [x, y, size] = [left + width / 2, top + height / 2, Math.min(9, width / 4)];
    path.moveTo(x - size, y);
    path.quadraticCurveTo(x, y - size, x + size, y);
    path.quadraticCurveTo(x, y + size, x - size, y);
    path.moveTo(x - 0.7 * size, y + 0.7 * size);
    path.lineTo(x + 0.7 * size, y - 0.7 * size);
  }
  strokeTwice(ctx, path, "#cccccc", [], 1);
}

/** The first cell of each connected area of equal keys. */
export function firstOfAreas(/** @type {unknown[]} */ keys) {
  const known = new Set();
  return [...keys.keys()].filter((start) => {
    if (keys[start] === null || known.has(start)) return false;
    const waiting = [start];
    for (const cell of waiting) {
      if (known.has(cell)) continue; // reached by another way too
      known.add(cell);
      const [row, col] = rowCol(cell);
      const near = Object.values(ARROWS).map(([down, right]) => cellAt(row + down, col + right));
      waiting.push(...near.filter((next) => keys[next] === keys[cell] && !known.has(next)));
    }
    return true;
  });
}

/** Mark what is not acknowledged. @param {CellPlan} plan @param {Iterable<number>} cells */
export function drawPending({ ctx, boxOf }, cells) {
  Object.assign(ctx, { fillStyle: "#ffb000", strokeStyle: "#000", lineWidth: 1 });
  for (const cell of cells) {
    const { x, y, width, height } = boxOf(cell);
    ctx.beginPath();
    ctx.arc(x + width - 9, y + height - 9, 3.5, 0, 2 * Math.PI);
    ctx.fill();
    ctx.stroke();
  }
}

/** What others said other than what is shown: an initial and the class's sign in the lower left
 * corner; a mark in the right one where two people are sure of different classes; a tick where it
 * is settled. That only somebody else said clear is not told where nothing is shown.
 * @param {CellPlan} plan @param {ShownLabels} labels @param {(?ShownCell)[]} cells
 */
export function drawOthers(plan, { mine, others, settled }, cells) {
  const people = Object.entries(others);
  for (let cell = 0; cell < mine.length; cell += 1) {
    const box = plan.boxOf(cell);
    if (box.width < MARK_FROM) continue;
    const decided = settled[cell];
    const all = [mine[cell], ...people.map(([, theirs]) => theirs[cell])];
    if (decided === null && disagree(all)) drawDisagreement(plan, box);
    if (box.width < TEXT_FROM) continue;
    const shown = cells[cell];
    /** @param {?string} label */
    const told = (label) => (shown ? label !== shown.label : !isClear(label));
    const said = people.filter(([, theirs]) => theirs[cell] !== null && told(theirs[cell]));
    const signs = said.map(([name, theirs]) => name.slice(0, 1) + signOf(theirs[cell] ?? ""));
    const words = signs.slice(0, 2);
    if (said.length > 2) words.push("+");
    if (decided !== null && (words.length || told(decided))) words.push(`✓${signOf(decided)}`);
    smallText(plan.ctx, words.join(" "), box.x + 5, box.y + box.height - 19, "#f2f2f2");
  }
}

/** Whether two of these labels are sure and different. */
export function disagree(/** @type {(?string)[]} */ labels) {
  const sure = new Set(labels.filter((label) => label !== null && label !== "unsure"));
  return sure.size > 1;
}

/** @param {CellPlan} plan @param {Box} box */
function drawDisagreement({ ctx }, { x, y, width, height }) {
  Object.assign(ctx, { font: "700 18px system-ui, sans-serif", lineWidth: 4 });
  Object.assign(ctx, { textAlign: "right", textBaseline: "bottom" });
  rimmedText(ctx, "≠", x + width - 5, y + height - 3, "#ff7aa2");
}

/** Show the cursor's cell, if there is one, and the cells that are selected.
 * @param {CellPlan} plan @param {?number} cursor @param {number[]} selection
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

/** Fill patches faintly: the stroke that is being drawn. A null label takes labels back.
 * @param {CellPlan} plan @param {Iterable<number>} cells @param {?string} label
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

// Edges towards a patch with another key, `inset` CSS pixels inside the patch.
/** @type {(path: Path2D, box: Box, cell: number, keys: unknown[], inset: number) => void} */
function addEdges(path, { x, y, width, height }, cell, keys, inset) {
  const [row, col] = rowCol(cell);
  /** @param {number} r @param {number} c */
  const same = (r, c) => keys[cellAt(r, c)] === keys[cell];
  const up = same(row - 1, col);
  const down = same(row + 1, col);
  const left = same(row, col - 1);
  const right = same(row, col + 1);
  const x0 = x + (left ? 0 : inset);
  const x1 = x + width - (right ? 0 : inset);
  const y0 = y + (up ? 0 : inset);
  const y1 = y + height - (down ? 0 : inset);
  /** @type {[joined: boolean, fromX: number, fromY: number, toX: number, toY: number][]} */
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

/** @type {(ctx: Context, path: Path2D, colour: string, dash: number[], width: number) => void} */
function strokeTwice(ctx, path, colour, dash, width) {
  ctx.lineCap = "butt";
  ctx.setLineDash([]);
  ctx.lineWidth = width + 2; // all of the rim and of `colourOf` is needed for 3:1 on any ground
  ctx.strokeStyle = "#000000";
  ctx.stroke(path);
  ctx.setLineDash(dash);
  ctx.lineWidth = width;
  ctx.strokeStyle = colour;
  ctx.stroke(path);
  ctx.setLineDash([]);
}

// On its colour only where it is a label and there is room: all else covers less of the picture.
/** @param {Context} ctx @param {Box} box @param {ShownCell} shown */
function drawSign(ctx, { x, y, width }, { label, line, mark }) {
  const text = (isClear(label) ? "" : signOf(label)) + mark;
  if (width < TEXT_FROM) smallText(ctx, text, x + 2, y, colourOf(label));
  else if (line !== "solid") smallText(ctx, text, x + 5, y + 4, colourOf(label));
  else if (text) {
    Object.assign(ctx, { font: BOLD, textAlign: "left", textBaseline: "top" });
    ctx.fillStyle = colourOf(label);
    ctx.fillRect(x + 3, y + 3, ctx.measureText(text).width + 6, 16);
    ctx.fillStyle = "#000000";
    ctx.fillText(text, x + 6, y + 4);
  }
}

/** @type {DrawText} */
function smallText(ctx, text, x, y, ink) {
  Object.assign(ctx, { font: BOLD, lineWidth: 3, textAlign: "left", textBaseline: "top" });
  rimmedText(ctx, text, x, y, ink);
}

/** @type {DrawText} */
function rimmedText(ctx, text, x, y, ink) {
  Object.assign(ctx, { lineJoin: "round", strokeStyle: "#000000", fillStyle: ink });
  ctx.strokeText(text, x, y);
  ctx.fillText(text, x, y);
}

/** Fold the upper right corner of patches that have a note. */
export function drawNotes(/** @type {CellPlan} */ { ctx, boxOf }, /** @type {Note[]} */ notes) {
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
