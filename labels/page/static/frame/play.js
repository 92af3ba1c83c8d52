// Playing: one frame after the other at a chosen rate, as a person asked for. Frames that do not
// come in time are passed over. Nothing is written by it.

import { choice } from "../core/controls.js";
import { backAfterMouse, el, say } from "../core/dom.js";
import { setSetting, setting } from "../core/settings.js";
import { stepFrom } from "../labelling/steps.js";
/** @import { FrameShow, ShowFrame } from "../types.js" */

const RATES = [1, 2, 5, 10, 25]; // frames a second
const LOOK_MS = 8; // between two looks whether a late picture is there
const MEAN_OF = 12; // frames over which the rate that is reached is taken
const IN_TIME = 10; // frames that come in time before fewer are passed over

/** Plays the frames that pass the filter. */
export class Player {
  /** @param {FrameShow} show @param {ShowFrame} go @param {HTMLButtonElement} toggle */
  constructor(show, go, toggle) {
    this.show = show;
    this.go = go;
    this.toggle = toggle;
    this.timer = 0;
    this.times = [0];
    this.inTime = 0;
    /** @type {[string, string][]} */
    const rates = RATES.map((rate) => [String(rate), `${rate}/s`]);
    const options = { "aria-label": "Frames a second" };
    const select = backAfterMouse(choice(rates, String(setting("rate")), options));
    select.addEventListener("change", () => setSetting("rate", Number(select.value)));
    this.reached = el("output", { class: "place" });
    this.root = el("span", { class: "pick" }, toggle, select, this.reached);
    this.tell();
  }

  start() {
    this.times = [performance.now()];
    this.inTime = 0;
    this.timer = setTimeout(() => this.tick());
    this.tell();
  }

  /** Stay on the frame that is shown; whether it played. */
  stop() {
    const played = this.timer !== 0;
    clearTimeout(this.timer);
    this.timer = 0;
    this.show.stride = 1;
    this.tell();
    return played;
  }

  /** When the newest frame was shown. */
  get newest() {
    return this.times[this.times.length - 1];
  }

  tell() {
    this.toggle.setAttribute("aria-pressed", String(this.timer !== 0));
    const { timer, times } = this;
    const rate = timer && times.length > 1 ? (times.length - 1) / (this.newest - times[0]) : 0;
    this.reached.textContent = rate ? `${(1000 * rate).toFixed(rate < 0.01 ? 1 : 0)}/s reached` : "";
  }

  tick() {
    const { show } = this;
    // Away, or not looked at: what would pass now would pass unseen.
    if (show.retriable || document.hidden) return void this.stop();
    const each = 1000 / setting("rate");
    const now = performance.now();
    const wait = this.newest + each * show.stride - now;
    if (wait > 1 || !(show.ready || show.fault)) {
      this.timer = setTimeout(() => this.tick(), Math.max(wait, LOOK_MS));
      return;
    }
    const next = stepFrom(show.camera, show.frame, show.stride);
    // By one at a time: what is fetched ahead is of no use after a change.
    const late = -wait > each / 2;
    if (late || (this.inTime > IN_TIME && show.stride > 1)) {
      show.stride += late ? 1 : -1;
      this.inTime = 0;
    } else this.inTime += 1;
    if (next === null) {
      this.stop();
      return say("No further frame (of this filter).");
    }
    // A little late is made up for by the next one.
    this.times = [...this.times, -wait < each ? now + wait : now].slice(-MEAN_OF);
    this.tell();
    this.timer = setTimeout(() => this.tick(), LOOK_MS);
    this.go(show.camera, next);
  }
}
