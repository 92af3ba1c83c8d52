// The strip of all frames of a camera: states told apart by colour and by height, jump by click,
// drag or keys.

import { soon } from "../core/dom.js";
import { frameIndex, frames, mission } from "../core/mission.js";
import { passing } from "./steps.js";

/** Each state's name, colour and part of the strip's height. Later ones win a shared pixel. */
export const STATES = {
  u: { words: "unseen", colour: "#66727d", height: 0.14 },
  s: { words: "seen", colour: "#b4bec7", height: 0.34 },
  d: { words: "done", colour: "#4fb3e8", height: 1 },
  p: { words: "part", colour: "#f0b429", height: 0.62 },
  x: { words: "disagreement", colour: "#ff5c8a", height: 1 },
};
const ORDER = Object.keys(STATES);
const TICK_ROOM = 16;
const MARK_ROOM = 6;

/** Draws the strip into a canvas that is a slider for keyboards and screen readers. */
export class Timeline {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {(frame: number) => void} jump
   */
  constructor(canvas, jump) {
    this.canvas = canvas;
    this.jump = jump;
    this.camera = "";
    this.frame = 0;
    /** Draw again at the next screen refresh. */
    this.invalidate = soon(() => this.draw());
    this.observer = new ResizeObserver(this.invalidate);
    this.observer.observe(canvas);
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  /** Stop: the canvas leaves the page. */
  close() {
    this.observer.disconnect();
  }

  /** Show a frame as the current one. */
  set(camera, frame) {
    this.camera = camera;
    this.frame = frame;
    const list = frames(camera);
    const at = frameIndex(camera, frame);
    const words = STATES[mission.states[camera][at]]?.words ?? "";
    const aria = {
      valuemin: 1,
      valuemax: list.length,
      valuenow: at + 1,
      valuetext: `frame ${frame}, ${at + 1} of ${list.length}, ${words}`,
    };
    for (const [name, value] of Object.entries(aria)) {
      this.canvas.setAttribute(`aria-${name}`, value);
    }
    this.invalidate();
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!this.camera || !width) return;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    const ctx = this.canvas.getContext("2d", { alpha: false });
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.fillStyle = "#0f1418";
    ctx.fillRect(0, 0, width, height);
    this.drawStates(ctx, width, height - TICK_ROOM - MARK_ROOM);
    this.drawTicks(ctx, width, height);
    this.drawCurrent(ctx, width, height);
  }

  drawStates(ctx, width, room) {
    const list = frames(this.camera);
    const states = mission.states[this.camera];
    const pass = passing();
    const each = width / list.length;
    const columns = Math.min(list.length, Math.ceil(width * 2));
    for (let column = 0; column < columns; column += 1) {
      const from = Math.floor((column * list.length) / columns);
      const to = Math.max(from + 1, Math.floor(((column + 1) * list.length) / columns));
      const { state, passes } = this.summary(list, states, pass, from, to);
      const { colour, height } = STATES[state];
      const x = from * each;
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
      ctx.globalAlpha = 1;
    }
  }

  summary(list, states, pass, from, to) {
    let best = 0;
    let passes = false;
    for (let at = from; at < to; at += 1) {
      best = Math.max(best, ORDER.indexOf(states[at]));
      passes ||= pass(this.camera, list[at]);
    }
    return { state: ORDER[best], passes };
  }

  drawTicks(ctx, width, height) {
    const list = frames(this.camera);
    const step = niceStep((list.length * 70) / width);
    ctx.fillStyle = "#9fb0bf";
    const font = "14px system-ui, sans-serif";
    Object.assign(ctx, { font, textBaseline: "bottom", textAlign: "left" });
    list.forEach((frame, at) => {
      if (frame % step && at) return;
      const x = ((at + 0.5) / list.length) * width;
      ctx.fillRect(Math.round(x), height - TICK_ROOM, 1, 4);
      if (x < width - 30) ctx.fillText(String(frame), x + 3, height);
    });
  }

  drawCurrent(ctx, width, height) {
    const at = frameIndex(this.camera, this.frame);
    const x = ((at + 0.5) / frames(this.camera).length) * width;
    ctx.fillStyle = "#ffffff";
    ctx.fillRect(Math.round(x) - 1, 0, 2, height - TICK_ROOM);
    ctx.beginPath();
    ctx.moveTo(x - 6, 0);
    ctx.lineTo(x + 6, 0);
    ctx.lineTo(x, 7);
    ctx.fill();
  }

  frameAt(event) {
    const { left, width } = this.canvas.getBoundingClientRect();
    const list = frames(this.camera);
    const at = Math.floor(((event.clientX - left) / width) * list.length);
    return list[Math.min(list.length - 1, Math.max(0, at))];
  }

  press(event) {
    if (event.button !== 0) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.jump(this.frameAt(event));
  }

  drag(event) {
    if (event.buttons & 1) {
      const frame = this.frameAt(event);
      if (frame !== this.frame) this.jump(frame);
    } else {
      this.canvas.title = `frame ${this.frameAt(event)}`;
    }
  }

  key(event) {
    const list = frames(this.camera);
    const at = frameIndex(this.camera, this.frame);
    const page = Math.max(1, Math.round(list.length / 20));
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

function niceStep(least) {
  for (let power = 1; ; power *= 10) {
    for (const digit of [1, 2, 5]) if (digit * power >= least) return digit * power;
  }
}
