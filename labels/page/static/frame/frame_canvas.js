// The canvas of one frame: picture, grid, labels, hints, cursor, and row and column heads.

import {
  drawCells, drawCursor, drawMasked, drawNotes, drawOthers, drawPending, drawStroke, drawUnseen,
  shownCell,
} from "../labelling/cell_drawing.js";
import { contextOf, soon } from "../core/dom.js";
import { mission, setting } from "../core/mission.js";
import { cellAt, rowCol } from "../core/patch_grid.js";
import { Viewport } from "./viewport.js";
/** @import { Box, CellPlan, Context, FrameContent, Hit, ShownLabels } from "../types.js" */

const PIXELS_FROM = 3; // screen pixels a frame pixel from which they are shown as squares
const HEAD_EVERY = 18; // least CSS pixels between two heads

/** Draws what `content` says, once a screen refresh at most. */
export class FrameCanvas {
  constructor(/** @type {HTMLCanvasElement} */ canvas) {
    this.canvas = canvas;
    this.ctx = contextOf(canvas, false);
    this.viewport = new Viewport();
    /** @type {{canvas: HTMLCanvasElement, bitmap: ?ImageBitmap, key: string}} */
    this.ground = { canvas: document.createElement("canvas"), bitmap: null, key: "" };
    /** @type {FrameContent} */
    this.content = {
      bitmap: null, labels: null, hints: [], message: "", badge: "", masked: new Set(),
    };
    /** @type {(tag: ?string | undefined) => void} */
    this.onDrawn = () => {};
    /** @type {?FrameCanvas} A canvas that shows the same part of its picture. */
    this.beside = null;
    this.invalidate = soon(() => this.draw());
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(canvas);
  }

  /** Stop drawing: the canvas leaves the page. */
  close() {
    this.observer.disconnect();
  }

  set(/** @type {Partial<FrameContent>} */ content) {
    Object.assign(this.content, content);
    const { bitmap } = this.content;
    if (bitmap) this.viewport.frame = { width: bitmap.width, height: bitmap.height };
    this.invalidate();
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.max(1, Math.round(clientWidth * ratio));
    this.canvas.height = Math.max(1, Math.round(clientHeight * ratio));
    this.viewport.canvas = { width: clientWidth, height: clientHeight };
    this.viewport.pan(0, 0);
    this.draw();
  }

  /** Where a cell lies on the canvas, in CSS pixels. @returns {Box} */
  boxOf(/** @type {number} */ cell) {
    const [row, col] = rowCol(cell);
    const { origin, scale, patch } = this.viewport;
    const [width, height] = [patch.width * scale, patch.height * scale];
    return { x: origin.x + col * width, y: origin.y + row * height, width, height };
  }

  /** @param {number} clientX @param {number} clientY @returns {Hit} What is there. */
  hit(clientX, clientY) {
    const { left, top } = this.canvas.getBoundingClientRect();
    const inFrame = this.viewport.toFrame(clientX - left, clientY - top);
    const { patch } = this.viewport;
    const [x, y] = [inFrame.x / patch.width, inFrame.y / patch.height];
    const [row, col] = [Math.floor(y), Math.floor(x)];
    let head = null;
    if (clientX - left < 24 && cellAt(row, 0) >= 0) head = { row };
    else if (clientY - top < 18 && cellAt(0, col) >= 0) head = { col };
    return { x, y, cell: head ? -1 : cellAt(row, col), head };
  }

  reveal(/** @type {number} */ cell) {
    const [row, col] = rowCol(cell);
    const { width, height } = this.viewport.patch;
    this.viewport.reveal({ x: col * width, y: row * height, width, height });
    this.invalidate();
  }

  draw() {
    const { ctx, content } = this;
    if (!this.canvas.isConnected) return; // asked for before the view was left
    const ratio = window.devicePixelRatio || 1;
    this.drawGround(ratio);
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    /** @type {CellPlan} */
    const plan = { ctx, boxOf: (cell) => this.boxOf(cell) };
    if (content.labels && !content.plain) this.drawContent(plan, content.labels);
    this.drawHeads();
    if (content.message) this.drawMessage();
    if (content.badge) this.drawBadge();
    if (content.bitmap) this.onDrawn(content.tag);
    this.beside?.follow(this.viewport);
  }

  /** Show the part that another canvas shows. */
  follow(/** @type {Viewport} */ { zoom, centre }) {
    if (zoom === this.viewport.zoom && centre === this.viewport.centre) return;
    Object.assign(this.viewport, { zoom, centre });
    this.invalidate();
  }

  /** Kept as it is on the screen: scaling a picture takes longer than drawing all the rest. */
  drawGround(/** @type {number} */ ratio) {
    const { ground, canvas, ctx, content } = this;
    const { origin, scale } = this.viewport;
    const grid = setting("grid") && Boolean(content.bitmap || content.message);
    const place = [origin.x, origin.y, scale, ratio, canvas.width, canvas.height];
    const key = [...place, content.dim, grid].join();
    if (ground.bitmap !== content.bitmap || ground.key !== key) {
      Object.assign(ground, { bitmap: content.bitmap, key });
      Object.assign(ground.canvas, { width: canvas.width, height: canvas.height });
      const under = contextOf(ground.canvas, false);
      under.setTransform(ratio, 0, 0, ratio, 0, 0);
      under.fillStyle = "#0b0e11";
      under.fillRect(0, 0, canvas.width, canvas.height);
      if (content.bitmap) this.drawPicture(under, content.bitmap, ratio);
      if (grid) this.drawGrid(under);
    }
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.drawImage(ground.canvas, 0, 0);
  }

  /** @param {Context} ctx @param {ImageBitmap} bitmap @param {number} ratio */
  drawPicture(ctx, bitmap, ratio) {
    const { origin, scale, frame } = this.viewport;
    ctx.imageSmoothingEnabled = scale * ratio < PIXELS_FROM;
    ctx.imageSmoothingQuality = "high";
    ctx.globalAlpha = this.content.dim ? 0.35 : 1;
    ctx.drawImage(bitmap, origin.x, origin.y, frame.width * scale, frame.height * scale);
    ctx.globalAlpha = 1;
  }

  drawContent(/** @type {CellPlan} */ plan, /** @type {ShownLabels} */ labels) {
    const { hints, cursor, selection, stroke, masked, unseen = [] } = this.content;
    drawMasked(plan, masked);
    if (setting("outlines")) {
      const cells = labels.mine.map((label, cell) =>
        masked.has(cell) ? null : shownCell(label, hints[cell]),
      );
      drawUnseen(plan, unseen.filter((cell) => !masked.has(cell)));
      drawCells(plan, cells);
      drawOthers(plan, labels, cells);
      drawPending(plan, this.content.pending ?? []);
      drawNotes(plan, labels.notes);
    }
    if (stroke) drawStroke(plan, stroke.cells, stroke.label);
    drawCursor(plan, cursor ?? null, selection ?? []);
  }

  drawGrid(/** @type {Context} */ ctx) {
    const { rows, cols } = mission.grid;
    const first = this.boxOf(0);
    const last = this.boxOf(rows * cols - 1);
    ctx.strokeStyle = "rgb(255 255 255 / 18%)";
    ctx.lineWidth = 1;
    ctx.beginPath();
    for (let col = 0; col <= cols; col += 1) {
      const x = Math.round(first.x + col * first.width) + 0.5;
      ctx.moveTo(x, first.y);
      ctx.lineTo(x, last.y + last.height);
    }
    for (let row = 0; row <= rows; row += 1) {
      const y = Math.round(first.y + row * first.height) + 0.5;
      ctx.moveTo(first.x, y);
      ctx.lineTo(last.x + last.width, y);
    }
    ctx.stroke();
  }

  drawHeads() {
    const { ctx } = this;
    const { rows, cols } = mission.grid;
    const { width, height } = this.viewport.canvas;
    const box = this.boxOf(0);
    ctx.fillStyle = "#12171c";
    ctx.fillRect(0, 0, 24, height);
    ctx.fillRect(0, 0, width, 18);
    ctx.fillStyle = "#9fb0bf";
    const font = "14px system-ui, sans-serif";
    Object.assign(ctx, { font, textAlign: "center", textBaseline: "middle" });
    const downs = Math.ceil(HEAD_EVERY / box.height);
    for (let row = 0; row < rows; row += downs) {
      const y = box.y + (row + 0.5) * box.height;
      if (y > 20) ctx.fillText(String(row), 12, y);
    }
    const across = Math.ceil((HEAD_EVERY + 6) / box.width);
    for (let col = 0; col < cols; col += across) {
      const x = box.x + (col + 0.5) * box.width;
      if (x > 26) ctx.fillText(String(col), x, 9);
    }
  }

  drawMessage() {
    const { ctx } = this;
    const { width, height } = this.viewport.canvas;
    const font = "15px system-ui, sans-serif";
    Object.assign(ctx, { font, textAlign: "center", textBaseline: "middle" });
    const lines = wrap(ctx, this.content.message, width * 0.7);
    const top = height / 2 - lines.length * 11;
    ctx.fillStyle = "rgb(11 14 17 / 85%)";
    ctx.fillRect(width * 0.12, top - 16, width * 0.76, lines.length * 22 + 20);
    ctx.fillStyle = "#f2f2f2";
    lines.forEach((line, at) => ctx.fillText(line, width / 2, top + at * 22 + 5));
  }

  drawBadge() {
    const { ctx } = this;
    const font = "600 14px system-ui, sans-serif";
    Object.assign(ctx, { font, textAlign: "left", textBaseline: "middle" });
    const { width } = ctx.measureText(this.content.badge);
    ctx.fillStyle = "#ffd166";
    ctx.fillRect(30, 24, width + 16, 22);
    ctx.fillStyle = "#000000";
    ctx.fillText(this.content.badge, 38, 35.5);
  }
}

function wrap(/** @type {Context} */ ctx, /** @type {string} */ text, /** @type {number} */ width) {
  const lines = [""];
  for (const word of text.split(" ")) {
    const line = `${lines.at(-1)} ${word}`.trim();
    if (ctx.measureText(line).width <= width || !lines.at(-1)) lines.splice(-1, 1, line);
    else lines.push(word);
  }
  return lines;
}
