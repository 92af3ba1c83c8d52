// The canvas of one frame: picture, grid, labels, hints, cursor, and row and column heads; zoom and
// pan: from frame pixels to the canvas and back.

import {
  drawCells, drawCursor, drawNotes, drawOthers, drawPending, drawStroke, shownCell,
} from "../labelling/cell_drawing.js";
import { soon } from "../core/dom.js";
import { mission, setting } from "../core/mission.js";
import { cellAt, patchSize, rowCol } from "../core/patch_grid.js";

const PIXELS_FROM = 3; // screen pixels a frame pixel from which they are shown as squares
const HEAD_EVERY = 18; // least CSS pixels between two heads
const MAX_ZOOM = 24;
const MARGIN = { left: 26, top: 20, right: 6, bottom: 6 }; // CSS pixels: row and column heads

/** What part of a frame the canvas shows. Sizes in CSS pixels. */
export class Viewport {
  constructor() {
    this.canvas = { width: 1, height: 1 };
    this.frame = { width: 4, height: 3 };
    this.zoom = 1; // 1: the whole frame fits
    this.centre = { x: 0.5, y: 0.5 }; // parts of the frame
  }

  /** Pixels of the canvas for one of the frame. */
  get scale() {
    const { width, height } = this.room;
    return Math.min(width / this.frame.width, height / this.frame.height) * this.zoom;
  }

  /** The part of the canvas that the frame may fill. */
  get room() {
    return {
      width: Math.max(1, this.canvas.width - MARGIN.left - MARGIN.right),
      height: Math.max(1, this.canvas.height - MARGIN.top - MARGIN.bottom),
    };
  }

  /** Size of a patch in frame pixels. */
  get patch() {
    return patchSize(this.frame.width, this.frame.height);
  }

  /** Where the frame's upper left corner lies on the canvas. */
  get origin() {
    const { width, height } = this.room;
    return {
      x: MARGIN.left + width / 2 - this.centre.x * this.frame.width * this.scale,
      y: MARGIN.top + height / 2 - this.centre.y * this.frame.height * this.scale,
    };
  }

  /** From canvas to frame pixels. */
  toFrame(x, y) {
    const { origin, scale } = this;
    return { x: (x - origin.x) / scale, y: (y - origin.y) / scale };
  }

  /** Zoom by a factor; what lies under (x, y) on the canvas stays there. */
  zoomBy(factor, x, y) {
    const held = this.toFrame(x, y);
    this.zoom = Math.min(MAX_ZOOM, Math.max(1, this.zoom * factor));
    const now = this.toFrame(x, y);
    this.moveCentre(held.x - now.x, held.y - now.y);
  }

  /** Zoom by a factor at the middle. */
  zoomMiddle(factor) {
    const { width, height } = this.room;
    this.zoomBy(factor, MARGIN.left + width / 2, MARGIN.top + height / 2);
  }

  /** Show the whole frame. */
  fit() {
    this.zoom = 1;
    this.centre = { x: 0.5, y: 0.5 };
  }

  /** Move the picture by canvas pixels. */
  pan(dx, dy) {
    this.moveCentre(-dx / this.scale, -dy / this.scale);
  }

  /** Move so that a box of frame pixels is in sight. */
  reveal({ x, y, width, height }) {
    const first = this.toFrame(MARGIN.left, MARGIN.top);
    const { width: w, height: h } = this.room;
    const last = this.toFrame(MARGIN.left + w, MARGIN.top + h);
    this.moveCentre(
      Math.min(0, x - first.x) + Math.max(0, x + width - last.x),
      Math.min(0, y - first.y) + Math.max(0, y + height - last.y),
    );
  }

  moveCentre(dx, dy) {
    const { centre, frame, room, scale } = this;
    this.centre = {
      x: hold(centre.x + dx / frame.width, room.width, frame.width * scale),
      y: hold(centre.y + dy / frame.height, room.height, frame.height * scale),
    };
  }
}

// The frame's edge does not come inside the canvas while the frame is larger than it.
function hold(centre, room, size) {
  if (size <= room) return 0.5;
  const half = room / size / 2;
  return Math.min(1 - half, Math.max(half, centre));
}

/** Draws what `content` says, once a screen refresh at most. */
export class FrameCanvas {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.ctx = canvas.getContext("2d", { alpha: false });
    this.viewport = new Viewport();
    this.ground = { canvas: document.createElement("canvas"), bitmap: null, key: "" };
    /** What to draw; see `set`. */
    this.content = { bitmap: null, labels: null, hints: [], message: "", badge: "" };
    this.onDrawn = () => {};
    /** A canvas that shows the same part of its picture. */
    this.beside = null;
    /** Draw again at the next screen refresh. */
    this.invalidate = soon(() => this.draw());
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(canvas);
  }

  /** Stop drawing: the canvas leaves the page. */
  close() {
    this.observer.disconnect();
  }

  /**
   * Change some of what is drawn.
   * @param {{bitmap?: ?ImageBitmap, dim?: boolean, labels?: ?Object, hints?: Object[],
   *   message?: string, badge?: string, cursor?: ?number, selection?: number[],
   *   stroke?: ?{cells: Iterable<number>, label: ?string}, plain?: boolean, tag?: *}} content
   *   `plain`: the picture and grid only. `tag` is handed to `onDrawn`.
   */
  set(content) {
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

  /** Where a cell lies on the canvas, in CSS pixels. */
  boxOf(cell) {
    const [row, col] = rowCol(cell);
    const { origin, scale, patch } = this.viewport;
    const [width, height] = [patch.width * scale, patch.height * scale];
    return { x: origin.x + col * width, y: origin.y + row * height, width, height };
  }

  /**
   * A point of the canvas in patches.
   * @returns {{x: number, y: number, cell: number, head: ?{row?: number, col?: number}}}
   *   `cell` -1 outside of all; `head` where a row's or column's head was hit.
   */
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

  /** Move the picture so that a cell is in sight. */
  reveal(cell) {
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
    const plan = { ctx, boxOf: (cell) => this.boxOf(cell) };
    if (content.labels && !content.plain) this.drawContent(plan);
    this.drawHeads();
    if (content.message) this.drawMessage();
    if (content.badge) this.drawBadge();
    if (content.bitmap) this.onDrawn(content.tag);
    this.beside?.follow(this.viewport);
  }

  // Show the part that another canvas shows.
  follow({ zoom, centre }) {
    if (zoom === this.viewport.zoom && centre === this.viewport.centre) return;
    Object.assign(this.viewport, { zoom, centre });
    this.invalidate();
  }

  // Labels change far more often than what lies under them, and scaling a picture takes longer than
  // drawing all the rest: it is kept as it is on the screen.
  drawGround(ratio) {
    const { ground, canvas, ctx, content } = this;
    const { origin, scale } = this.viewport;
    const grid = setting("grid") && Boolean(content.bitmap || content.message);
    const place = [origin.x, origin.y, scale, ratio, canvas.width, canvas.height];
    const key = [...place, content.dim, grid].join();
    if (ground.bitmap !== content.bitmap || ground.key !== key) {
      Object.assign(ground, { bitmap: content.bitmap, key });
      Object.assign(ground.canvas, { width: canvas.width, height: canvas.height });
      const under = ground.canvas.getContext("2d", { alpha: false });
      under.setTransform(ratio, 0, 0, ratio, 0, 0);
      under.fillStyle = "#0b0e11";
      under.fillRect(0, 0, canvas.width, canvas.height);
      if (content.bitmap) this.drawPicture(under, ratio);
      if (grid) this.drawGrid(under);
    }
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.drawImage(ground.canvas, 0, 0);
  }

  drawPicture(ctx, ratio) {
    const { origin, scale, frame } = this.viewport;
    ctx.imageSmoothingEnabled = scale * ratio < PIXELS_FROM;
    ctx.imageSmoothingQuality = "high";
    ctx.globalAlpha = this.content.dim ? 0.35 : 1;
    const { bitmap } = this.content;
    ctx.drawImage(bitmap, origin.x, origin.y, frame.width * scale, frame.height * scale);
    ctx.globalAlpha = 1;
  }

  drawContent(plan) {
    const { labels, hints, cursor, selection, stroke } = this.content;
    if (setting("outlines")) {
      const cells = labels.mine.map((label, cell) => shownCell(label, hints[cell]));
      drawCells(plan, cells);
      drawOthers(plan, labels, cells);
      drawPending(plan, this.content.pending ?? []);
      drawNotes(plan, labels.notes);
    }
    if (stroke) drawStroke(plan, stroke.cells, stroke.label);
    drawCursor(plan, cursor ?? null, selection ?? []);
  }

  drawGrid(ctx) {
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

function wrap(ctx, text, width) {
  const lines = [""];
  for (const word of text.split(" ")) {
    const line = `${lines.at(-1)} ${word}`.trim();
    if (ctx.measureText(line).width <= width || !lines.at(-1)) lines[lines.length - 1] = line;
    else lines.push(word);
  }
  return lines;
}
