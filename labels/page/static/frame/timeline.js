// The strip of all frames of a camera: states told apart by colour and by height, the classes that
// a person gave, zoom, a small picture under the pointer, jump by click, drag or keys.

import { contextOf, el, soon } from "../core/dom.js";
import { colourOf, frameIndex, frames, givenIn, mission, stateOf } from "../core/mission.js";
import { reachable } from "../core/keys.js";
import { frameAspect, thumbAddress } from "../core/pictures.js";
import { passing } from "../labelling/filters.js";
import { STATES } from "../labelling/frame_states.js";
/** @import { Context, LabelClass, Passes } from "../types.js" */

const ORDER = Object.keys(STATES);
const TICK_ROOM = 16;
const MARK_ROOM = 6;
const BAND = 4; // CSS pixels of the row of a class
const LEAST_SPAN = 20; // frames that the strip shows at least
const WHEEL_STEP = 1.002;
const PEEK = 176; // CSS pixels
const REST_MS = 80; // a frame that the pointer only passes is not fetched

/** Draws the strip into a canvas that is a slider for keyboards and screen readers. */
export class Timeline {
  /** @param {HTMLCanvasElement} canvas @param {(frame: number) => void} jump Somebody chose one. */
  constructor(canvas, jump) {
    this.canvas = canvas;
    this.jump = jump;
    this.camera = "";
    this.frame = 0;
    this.from = 0; // the first frame that the strip shows, and how many, in parts of frames
    this.span = Infinity;
    this.peekTimer = 0;
    /** @type {?number} */
    this.peeked = null;
    this.image = el("img", { alt: "", width: PEEK, on: { load: () => this.showImage(true) } });
    this.words = el("span");
    this.peek = el("div", { class: "peek", hidden: true }, this.image, this.words);
    canvas.after(this.peek);
    this.invalidate = soon(() => this.draw());
    this.observer = new ResizeObserver(this.invalidate);
    this.observer.observe(canvas);
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    canvas.addEventListener("pointerleave", () => this.endPeek());
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  /** Stop: the canvas leaves the page. */
  close() {
    this.observer.disconnect();
    clearTimeout(this.peekTimer);
  }

  set(/** @type {string} */ camera, /** @type {number} */ frame) {
    const list = frames(camera);
    const at = frameIndex(camera, frame);
    if (camera !== this.camera) this.span = Infinity;
    const moved = camera !== this.camera || frame !== this.frame;
    Object.assign(this, { camera, frame });
    if (moved && at >= 0 && (at < this.from || at + 1 > this.from + this.shown)) {
      this.from = at + 0.5 - this.shown / 2;
    }
    this.look(0);
    const words = [STATES[stateOf(camera, frame)]?.words ?? "", ...givenIn(camera, frame)];
    const aria = {
      valuemin: 1,
      valuemax: list.length,
      valuenow: at + 1,
      valuetext: `frame ${frame}, ${at + 1} of ${list.length}, ${words.join(", ")}`,
    };
    for (const [name, value] of Object.entries(aria)) {
      this.canvas.setAttribute(`aria-${name}`, String(value));
    }
  }

  get shown() {
    return Math.min(this.span, frames(this.camera).length);
  }

  /** Where a frame of the list begins, in CSS pixels. */
  xOf(/** @type {number} */ at) {
    return ((at - this.from) / this.shown) * this.canvas.clientWidth;
  }

  /** Move what is shown by a count of frames. */
  look(/** @type {number} */ by) {
    const last = frames(this.camera).length - this.shown;
    this.from = Math.min(last, Math.max(0, this.from + by));
    this.invalidate();
  }

  /** Show fewer frames (a factor over 1) or more; the frame at `held` stays where it is. */
  zoom(/** @type {number} */ factor, /** @type {number} */ held) {
    const part = (held - this.from) / this.shown;
    this.span = Math.max(LEAST_SPAN, this.shown / factor);
    this.from = held - part * this.shown;
    this.look(0);
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!this.camera || !width) return;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    const ctx = contextOf(this.canvas, false);
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.fillStyle = "#0f1418";
    ctx.fillRect(0, 0, width, height);
    const given = Object.values(mission.given[this.camera] ?? {});
    const used = new Set(given.flat());
    const bands = mission.classes.filter(({ name }) => used.has(name));
    const room = height - TICK_ROOM - MARK_ROOM;
    const thick = Math.min(BAND, room / 2 / bands.length);
    this.drawFrames(ctx, width, room - thick * bands.length - 1, bands, thick);
    this.drawTicks(ctx, width, height);
    this.drawCurrent(ctx, width, height);
  }

  /** @param {Context} ctx @param {number} width @param {number} room
   * @param {LabelClass[]} bands @param {number} thick
   */
  drawFrames(ctx, width, room, bands, thick) {
    const list = frames(this.camera);
    const states = mission.states[this.camera];
    const pass = passing();
    const first = Math.floor(this.from);
    const count = Math.min(list.length, Math.ceil(this.from + this.shown)) - first;
    const each = width / this.shown;
    const columns = Math.min(count, Math.ceil(width * 2));
    for (let column = 0; column < columns; column += 1) {
      const from = first + Math.floor((column * count) / columns);
      const to = Math.max(from + 1, first + Math.floor(((column + 1) * count) / columns));
      const { state, passes, given } = this.summary(list, states, pass, from, to);
      const { colour, height } = STATES[state];
      const x = this.xOf(from);
      // A single frame among thousands must still be seen.
      const least = state === "u" ? 0.5 : 2;
      const wide = Math.max(least, (to - from) * each - (each > 4 ? 1 : 0));
      ctx.globalAlpha = passes ? 1 : 0.25;
      ctx.fillStyle = colour;
      ctx.fillRect(x, MARK_ROOM + room * (1 - height), wide, room * height);
      if (state === "x") {
        // A notch, so that disagreement differs from done without its colour.
        ctx.fillStyle = "#0f1418";
        ctx.fillRect(x, MARK_ROOM + room * 0.4, wide, Math.max(2, room * 0.2));
      }
      bands.forEach(({ name }, row) => {
        if (!given.has(name)) return;
        ctx.fillStyle = colourOf(name);
        ctx.fillRect(x, MARK_ROOM + room + row * thick + 2, Math.max(2, wide), thick - 1);
      });
      ctx.globalAlpha = 1;
    }
  }

  /** @param {number[]} list @param {string[]} states @param {Passes} pass
   * @param {number} from @param {number} to
   */
  summary(list, states, pass, from, to) {
    let best = 0;
    let passes = false;
    /** @type {Set<string>} */
    const given = new Set();
    for (let at = from; at < to; at += 1) {
      best = Math.max(best, ORDER.indexOf(states[at]));
      passes ||= pass(this.camera, list[at]);
      for (const name of givenIn(this.camera, list[at])) given.add(name);
    }
    return { state: ORDER[best], passes, given };
  }

  drawTicks(/** @type {Context} */ ctx, /** @type {number} */ width, /** @type {number} */ height) {
    const list = frames(this.camera);
    const step = niceStep((this.shown * 70) / width);
    ctx.fillStyle = "#9fb0bf";
    const font = "14px system-ui, sans-serif";
    Object.assign(ctx, { font, textBaseline: "bottom", textAlign: "left" });
    for (let at = Math.floor(this.from); at < this.from + this.shown; at += 1) {
      if (list[at] % step && at) continue;
      const x = this.xOf(at + 0.5);
      ctx.fillRect(Math.round(x), height - TICK_ROOM, 1, 4);
      if (x < width - 30) ctx.fillText(String(list[at]), x + 3, height);
    }
  }

  /** @param {Context} ctx @param {number} width @param {number} height */
  drawCurrent(ctx, width, height) {
    const count = frames(this.camera).length;
    const x = this.xOf(frameIndex(this.camera, this.frame) + 0.5);
    if (this.shown < count) {
      // What part of the mission is shown.
      ctx.fillStyle = "#7cc7ff";
      const part = Math.max(8, (this.shown / count) * width);
      ctx.fillRect((this.from / count) * width, 0, part, 4);
    }
    ctx.fillStyle = "#ffffff";
    ctx.fillRect(Math.round(x) - 1, 0, 2, height - TICK_ROOM);
    ctx.beginPath();
    ctx.moveTo(x - 6, 0);
    ctx.lineTo(x + 6, 0);
    ctx.lineTo(x, 7);
    ctx.fill();
  }

  placeAt(/** @type {MouseEvent} */ event) {
    const { left, width } = this.canvas.getBoundingClientRect();
    return this.from + ((event.clientX - left) / width) * this.shown;
  }

  frameAt(/** @type {MouseEvent} */ event) {
    const list = frames(this.camera);
    return list[Math.min(list.length - 1, Math.max(0, Math.floor(this.placeAt(event))))];
  }

  wheel(/** @type {WheelEvent} */ event) {
    event.preventDefault();
    const { deltaX, deltaY, deltaMode } = event;
    if (Math.abs(deltaX) > Math.abs(deltaY)) {
      this.look((deltaX / this.canvas.clientWidth) * this.shown);
    } else this.zoom(WHEEL_STEP ** -(deltaMode ? deltaY * 30 : deltaY), this.placeAt(event));
    this.showPeek(event);
  }

  /** The small picture of the frame under the pointer, its number and what is known of it. */
  showPeek(/** @type {MouseEvent} */ event) {
    const { camera, peek, image } = this;
    const frame = this.frameAt(event);
    const words = [STATES[stateOf(camera, frame)].words, givenIn(camera, frame).join(", ")];
    this.words.textContent = [`frame ${frame}`, ...words].filter(Boolean).join(" · ");
    peek.hidden = false;
    const { top } = this.canvas.getBoundingClientRect();
    const most = window.innerWidth - peek.offsetWidth;
    peek.style.left = `${Math.max(0, Math.min(most, event.clientX - peek.offsetWidth / 2))}px`;
    peek.style.bottom = `${window.innerHeight - top + 4}px`;
    if (frame === this.peeked) return;
    this.peeked = frame;
    this.showImage(false);
    clearTimeout(this.peekTimer);
    this.peekTimer = setTimeout(() => {
      image.height = PEEK * frameAspect(camera);
      // A pointer that passes does not have a long video read.
      image.src = `${thumbAddress(camera, frame, PEEK)}&near=1`;
    }, REST_MS);
  }

  /** Until it is there: another frame's picture must not stand beside this one's number. */
  showImage(/** @type {boolean} */ on) {
    this.image.style.visibility = on ? "visible" : "hidden";
  }

  endPeek() {
    clearTimeout(this.peekTimer);
    this.peek.hidden = true;
    this.peeked = null;
  }

  press(/** @type {PointerEvent} */ event) {
    if (event.button !== 0) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.jump(this.frameAt(event));
  }

  drag(/** @type {PointerEvent} */ event) {
    if (event.buttons & 1) {
      const frame = this.frameAt(event);
      if (frame !== this.frame) this.jump(frame);
    }
    this.showPeek(event);
  }

  key(/** @type {KeyboardEvent} */ event) {
    const list = frames(this.camera);
    const at = frameIndex(this.camera, this.frame);
    const page = Math.max(1, Math.round(this.shown / 20));
    /** @type {Record<string, number>} */
    const factors = { "+": 1.5, "=": 1.5, "-": 1 / 1.5, 0: 1 / list.length };
    const factor = factors[event.key];
    if (factor && !event.ctrlKey && !event.altKey && reachable(event.key) === event.key) {
      this.zoom(factor, at + 0.5);
      event.preventDefault();
      event.stopPropagation();
      return;
    }
    /** @type {Record<string, number>} */
    const moves = {
      ArrowLeft: at - 1,
      ArrowDown: at - 1,
      ArrowRight: at + 1,
      ArrowUp: at + 1,
      PageDown: at - page,
      PageUp: at + page,
      Home: 0,
      End: list.length - 1,
    };
    if (!(event.key in moves) || event.ctrlKey || event.altKey) return;
    event.preventDefault();
    this.jump(list[Math.min(list.length - 1, Math.max(0, moves[event.key]))]);
  }
}

/** The step between ticks: 1, 2 or 5 times a power of ten. */
export function niceStep(/** @type {number} */ least) {
  for (let power = 1; ; power *= 10) {
    for (const digit of [1, 2, 5]) if (digit * power >= least) return digit * power;
  }
}
