// Which frame is shown and how: its picture (enhanced, raw, or the frame before), its labels, and
// the neighbours fetched ahead.

import { ApiError, onFailure, post } from "../core/api.js";
import { labelsOf, prefetch } from "../saving/labels.js";
import { frameIndex, frames, mission, setting, stateOf, takeNewsOf } from "../core/mission.js";
import { forgetFailed, picture, pictureNow, prefetchPictures } from "../core/pictures.js";
import { stepFrom } from "../labelling/steps.js";
import { framesFollowed } from "../labelling/suggest.js";
/** @import { FrameCanvas } from "../types.js" */

const NEIGHBOURS = [1, 2, 3, -1]; // steps in the direction of travel
const SLOW_MS = 250;
const SEEN_MS = 400;
const TAP_MS = 300;
const BLINK_MS = 450; // under three changes a second: no flicker that could harm anybody

/** Shows one frame at a time on a FrameCanvas. */
export class FrameShow {
  /** `changed`: another frame, or another picture of it, is shown. */
  constructor(/** @type {FrameCanvas} */ canvas, /** @type {() => void} */ changed) {
    this.canvas = canvas;
    this.changed = changed;
    this.camera = "";
    this.frame = -1;
    this.fault = "";
    this.retriable = false;
    this.ready = false;
    this.raw = false;
    this.blinking = 0;
    this.showsBefore = false;
    this.turn = 0;
    this.direction = 1;
    /** How many frames apart those are that are shown one after the other. */
    this.stride = 1;
    /** @type {?number} When it was begun to go to a frame that is not drawn yet. */
    this.started = null;
    this.first = true;
    /** @type {?number} When a key went down. */
    this.pressed = null;
    this.seenTimer = 0;
    this.slowTimer = 0;
    canvas.onDrawn = (tag) => this.drawn(tag);
  }

  close() {
    this.turn += 1;
    this.endBlink();
    clearTimeout(this.seenTimer);
    clearTimeout(this.slowTimer);
    prefetchPictures([], []);
    this.canvas.close();
  }

  get enhance() {
    return this.raw ? 0 : setting("enhance");
  }

  /** The frame before this one in the mission, whatever the filter; null at its start. */
  get before() {
    return frames(this.camera)[frameIndex(this.camera, this.frame) - 1] ?? null;
  }

  /** The other camera, if its picture of this frame is to be shown beside; or null. */
  get beside() {
    const others = setting("beside") ? Object.keys(mission.cameras) : [];
    /** @param {string} camera */
    const has = (camera) => camera !== this.camera && frameIndex(camera, this.frame) >= 0;
    return others.find(has) ?? null;
  }

  /** Whether the frame can be painted on: its picture is what is on the screen. */
  get paintable() {
    return (
      this.ready && !this.fault && !this.showsBefore && labelsOf(this.camera, this.frame) !== null
    );
  }

  go(/** @type {string} */ camera, /** @type {number} */ frame) {
    this.started = performance.now();
    this.endBlink();
    if (camera === this.camera) {
      this.direction = frameIndex(camera, frame) < frameIndex(camera, this.frame) ? -1 : 1;
    }
    this.camera = camera;
    this.frame = frame;
    this.retriable = false;
    this.fault = frameIndex(camera, frame) < 0 ? absent(camera, frame) : "";
    prefetch(camera, this.fault ? [] : this.neighbours());
    this.loadPicture();
    this.noteSeen();
  }

  // The frames that will be wanted: this one, more in the direction of travel than behind.
  neighbours() {
    const { camera, frame, direction, stride, before } = this;
    const near = NEIGHBOURS.map((steps) => stepFrom(camera, frame, steps * direction * stride));
    return [...new Set([frame, ...near, before])].filter((one) => one !== null);
  }

  /** Fetch and show the picture anew: other contrast, or the server is back. */
  async loadPicture() {
    const { camera, frame, enhance } = this;
    this.turn += 1;
    const { turn } = this;
    clearTimeout(this.slowTimer);
    this.ready = false;
    if (this.fault && !this.retriable) return this.show(null, this.fault);
    this.fault = "";
    let bitmap = pictureNow(camera, frame, enhance);
    if (!bitmap) {
      this.canvas.set({ dim: true, labels: null, message: "" });
      const tell = () => this.canvas.set({ message: `Loading frame ${frame}…` });
      this.slowTimer = setTimeout(tell, SLOW_MS);
      bitmap = await this.fetchPicture(camera, frame, enhance, turn);
    }
    if (turn !== this.turn) return;
    clearTimeout(this.slowTimer);
    this.ready = bitmap !== null;
    this.show(bitmap, this.fault);
    this.prefetch();
    // What suggestions follow from may come later than what is on the screen.
    prefetch(camera, framesFollowed(camera, frame));
  }

  /** @param {string} camera @param {number} frame @param {number} enhance @param {number} turn */
  async fetchPicture(camera, frame, enhance, turn) {
    try {
      return await picture(camera, frame, enhance);
    } catch (error) {
      if (turn !== this.turn) return null;
      const status = error instanceof ApiError ? error.status : null;
      // 409: the server shows another mission now, and may show this one again.
      this.retriable = status === 0 || status === 409;
      const why = (error instanceof Error && error.message) || "not a picture";
      this.fault = `Frame ${frame} cannot be shown${status === 0 ? " now" : ""}: ${why}.`;
      return null;
    }
  }

  show(/** @type {?ImageBitmap} */ bitmap, /** @type {string} */ message) {
    const tag = bitmap ? `${this.camera}/${this.frame}` : null;
    this.canvas.set({ bitmap, dim: false, plain: false, message, badge: this.badge(), tag });
    this.changed();
  }

  prefetch() {
    const { camera, frame, enhance, beside } = this;
    const cameras = [camera, beside ?? ""];
    const pictures = this.neighbours()
      .flatMap((near) => cameras.map((name) => ({ camera: name, frame: near, enhance })))
      .filter((one) => frameIndex(one.camera, one.frame) >= 0);
    const kept = this.raw ? [{ camera, frame, enhance: setting("enhance") }] : [];
    prefetchPictures(pictures, kept);
  }

  badge() {
    if (this.showsBefore) return `frame ${this.before} (the one before)`;
    if (this.blinking) return `frame ${this.frame}`;
    if (this.raw) return "RAW: as the camera gave it";
    return "";
  }

  /** The server is back: try again what failed. */
  retry() {
    forgetFailed();
    if (this.fault && this.retriable) this.loadPicture();
    if (frameIndex(this.camera, this.frame) >= 0) prefetch(this.camera, [this.frame]);
  }

  drawn(/** @type {?string | undefined} */ tag) {
    const { dim, labels } = this.canvas.content;
    if (tag !== `${this.camera}/${this.frame}` || dim || !labels || this.started === null) return;
    if (this.first) performance.mark("tokt:first");
    this.first = false;
    const detail = { camera: this.camera, frame: this.frame };
    performance.measure("tokt:frame", { start: this.started, end: performance.now(), detail });
    this.started = null;
  }

  // A frame that was only passed on the way to another one was not seen.
  noteSeen() {
    clearTimeout(this.seenTimer);
    const { camera, frame } = this;
    if (stateOf(camera, frame) !== "u") return;
    this.seenTimer = setTimeout(() => {
      // Not worth a message: the frame counts as unseen until it is opened again.
      takeNewsOf(post("/api/seen", { camera, frame })).catch(onFailure());
    }, SEEN_MS);
  }

  /** The raw key goes down: show the frame as it is, or enhanced again. */
  pressRaw() {
    this.pressed = performance.now();
    this.toggleRaw();
  }

  /** The raw key comes up: a short press stays, a long one was only a look. */
  releaseRaw() {
    if (performance.now() - (this.pressed ?? 0) > TAP_MS) this.toggleRaw();
  }

  toggleRaw() {
    this.raw = !this.raw;
    this.endBlink();
    this.loadPicture();
  }

  /** The blink key goes down: show the frame before, or end the blinking. */
  pressBlink() {
    this.pressed = performance.now();
    if (this.blinking || this.showsBefore) {
      this.endBlink();
      this.pressed = null;
    } else {
      this.showBefore(true);
    }
  }

  /** The blink key comes up: after a short press it goes on blinking. */
  releaseBlink() {
    if (this.pressed === null || !this.showsBefore) return;
    if (performance.now() - (this.pressed ?? 0) > TAP_MS) this.endBlink();
    else if (!matchMedia("(prefers-reduced-motion: reduce)").matches) {
      this.blinking = setInterval(() => this.showBefore(!this.showsBefore), BLINK_MS);
    }
  }

  showBefore(/** @type {boolean} */ on) {
    const frame = on ? this.before : this.frame;
    if (frame === null) return;
    this.showsBefore = on;
    const bitmap = pictureNow(this.camera, frame, this.enhance);
    this.canvas.set({ dim: !bitmap, plain: on, badge: this.badge(), tag: null });
    if (bitmap) this.canvas.set({ bitmap });
    else if (on) this.fetchBefore(frame);
    this.changed();
  }

  async fetchBefore(/** @type {number} */ frame) {
    const { turn } = this;
    // Not readable, or given up: there is nothing to compare with.
    const bitmap = await picture(this.camera, frame, this.enhance).catch(() => null);
    if (turn !== this.turn) return;
    if (!bitmap) this.endBlink();
    else if (this.showsBefore) this.showBefore(true);
  }

  endBlink() {
    clearInterval(this.blinking);
    const was = this.blinking || this.showsBefore;
    this.blinking = 0;
    if (was) this.showBefore(false);
  }
}

function absent(/** @type {string} */ camera, /** @type {number} */ frame) {
  const list = frames(camera);
  if (!list.length) return `This mission has no ${camera} camera.`;
  const range = `${list[0]} to ${list.at(-1)}`;
  return `There is no frame ${frame} of the ${camera} camera in ${mission.mission} (${range}).`;
}
