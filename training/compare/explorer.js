"use strict";
// The threshold explorer: every figure anew from the counts and frame scores in the page. It is part
// of a template: two braces in a row would be filled in.

const OBSTACLE = 1, CLEAR = 0, UNKNOWN = -1;

/** @import { Explorer, Figure, Model, Rule, Sequence, StepRule } from "./explorer_types.js" */

/** @type {Explorer} */
const explorer = JSON.parse(document.getElementById("comparison")?.textContent ?? "").explorer;
/** @type {Figure[]} */
const FIGURES = ["precision", "recall", "f1"];

/** A patch's score exceeds thresholds[k] exactly where its rank exceeds k. @returns {Model} */
function decoded(/** @type {string} */ name) {
  const model = explorer.models[name];
  return { ...model, ranks: Uint8Array.from(atob(model.ranks), (byte) => byte.charCodeAt(0)) };
}

// As FrameRuleState of the runtime: what was before the first frame, and in a gap, is unknown.
// The rule's margins are steps of the model's thresholds here; now is null where it is off.
class RuleState {
  /** @param {StepRule} rule @param {number} patches @param {number} white */
  constructor(rule, patches, white) {
    this.rule = rule;
    this.white = white;
    this.needed = Math.max(rule.least_patches, white);
    /** @type {(?Uint8Array)[]} */
    this.last = new Array(rule.window).fill(null);
    this.counts = new Int16Array(patches);  // known places of the window over the margin
    this.known = 0;
  }

  skip() {
    this.push(null);
    return UNKNOWN;
  }

  push(/** @type {?Uint8Array} */ ranks) {
    this.count(this.last.shift() ?? null, -1);
    this.count(ranks, 1);
    this.last.push(ranks);
  }

  count(/** @type {?Uint8Array} */ place, /** @type {number} */ by) {
    this.known += place ? by : 0;
    place?.forEach((rank, patch) => { if (rank > this.rule.step) this.counts[patch] += by; });
  }

  add(/** @type {Uint8Array} */ ranks) {
    this.push(ranks);
    const { now, hits, window } = this.rule;
    const unknown = window - this.known;
    let confirmed = 0, sudden = 0, possible = 0;
    ranks.forEach((rank, patch) => {
      if (this.counts[patch] >= hits) confirmed++;
      if (now !== null && rank > now) sudden++;
      if (this.counts[patch] > 0 && this.counts[patch] + unknown >= hits) possible++;
    });
    if (confirmed >= this.needed || sudden >= this.white) return OBSTACLE;
    return possible >= this.needed ? UNKNOWN : CLEAR;
  }
}

function statuses(/** @type {Model} */ model, /** @type {StepRule} */ rule) {
  const found = new Array(model.judged.length);
  for (const { start, stop } of explorer.sequences) {
    const state = new RuleState(rule, model.patches, model.white);
    for (let i = start; i < stop; i++) {
      for (let n = Math.min(explorer.frames.gap[i], rule.window); n > 0; n--) state.skip();
      const ranks = model.ranks.subarray(i * model.patches, (i + 1) * model.patches);
      found[i] = model.judged[i] ? state.add(ranks) : state.skip();
    }
  }
  return found;
}

/** The first of three frames in a row with status 1; a gap in the frames breaks a row. */
function firstDetection(/** @type {number[]} */ found, /** @type {Sequence} */ { start, stop }) {
  let row = 0;
  for (let i = start; i < stop; i++) {
    if (i > start && explorer.frames.gap[i]) row = 0;
    row = found[i] === OBSTACLE ? row + 1 : 0;
    if (row === 3) return i - 2;
  }
  return null;
}

/** @param {Model} model @param {number} step @returns {Record<Figure, ?number>} */
function patchFigures(model, step) {
  const hit = model.true_positive[step], wrong = model.false_positive[step];
  const missed = explorer.obstacle - hit;
  /** @param {number} part @param {number} whole */
  const ratio = (part, whole) => (whole ? part / whole : null);
  return {
    precision: ratio(hit, hit + wrong),
    recall: ratio(hit, explorer.obstacle),
    f1: explorer.obstacle ? ratio(2 * hit, 2 * hit + wrong + missed) : null,
  };
}

function frameFigures(/** @type {Model} */ model, /** @type {StepRule} */ rule) {
  const found = statuses(model, rule);
  /** @param {boolean[]} of */
  const count = (of) => of.filter((yes, i) => yes && found[i] === OBSTACLE).length;
  const { ocean, obstacle, number } = explorer.frames;
  const first = explorer.sequences.map((sequence) => {
    const at = firstDetection(found, sequence);
    const labelled = obstacle.indexOf(true, sequence.start);
    const early = at !== null && (labelled < 0 || labelled >= sequence.stop || at < labelled);
    const name = explorer.sequences.length > 1 ? `${sequence.name}: ` : "";
    const said = at === null ? "none" : `${number[at]}${early ? " (before any labelled obstacle)" : ""}`;
    return name + said;
  });
  const total = (/** @type {boolean[]} */ of) => of.filter(Boolean).length;
  return {
    falseStatus: `${count(ocean)} / ${total(ocean)}`,
    detected: `${count(obstacle)} / ${total(obstacle)}`,
    first: first.join("; "),
  };
}

const written = (/** @type {?number} */ value) => (value === null ? "–" : value.toFixed(3));

function nearest(/** @type {number[]} */ thresholds, /** @type {number} */ value) {
  const distances = thresholds.map((t) => Math.abs(t - value));
  return distances.indexOf(Math.min(...distances));
}

/** @param {string} name @param {Record<string, string | number>} attributes */
function element(name, attributes) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  return made;
}

const WIDTH = 480, HEIGHT = 170, LEFT = 26, TOP = 10, FOOT = 6;

/** By step, as the slider above moves: not by value. */
function across(/** @type {number[]} */ thresholds, /** @type {number} */ step) {
  return LEFT + ((WIDTH - LEFT - 6) * step) / Math.max(1, thresholds.length - 1);
}

function drawCurves(/** @type {HTMLElement} */ svg, /** @type {Model} */ model) {
  const up = (/** @type {number} */ value) => TOP + (HEIGHT - FOOT - TOP) * (1 - value);
  for (const value of [0, 0.5, 1]) {
    svg.append(element("line", { class: "axis", x1: LEFT, x2: WIDTH, y1: up(value), y2: up(value) }));
    const text = element("text", { x: 0, y: up(value) + 4 });
    text.textContent = value.toFixed(1);
    svg.append(text);
  }
  for (const figure of FIGURES) {
    /** @type {string[]} */
    const points = [];
    model.thresholds.forEach((_, step) => {
      const value = patchFigures(model, step)[figure];
      if (value !== null) points.push(`${across(model.thresholds, step).toFixed(1)},${up(value).toFixed(1)}`);
    });
    svg.append(element("polyline", { class: figure, points: points.join(" ") }));
  }
  const line = (/** @type {string} */ name, /** @type {number} */ value) => {
    const x = across(model.thresholds, nearest(model.thresholds, value));
    const made = element("line", { class: name, x1: x, x2: x, y1: 0, y2: HEIGHT - FOOT });
    svg.append(made);
    return made;
  };
  line("own", model.rule.margin);
  if (model.rule.margin_now !== null) line("at-once", model.rule.margin_now);
  return line("now", 0);
}

function explore(/** @type {HTMLElement} */ form) {
  const model = decoded(form.dataset.model ?? "");
  /** @param {string} name */
  const part = (name) => /** @type {HTMLElement} */ (form.querySelector(`[data-is="${name}"]`));
  const input = (/** @type {string} */ name) => /** @type {HTMLInputElement} */ (part(name));
  const slider = input("slider"), least = input("least"), hits = input("hits"), frames = input("window");
  const atOnce = input("at-once"), own = model.rule;
  const here = drawCurves(part("chart"), model);
  const whole = (/** @type {HTMLInputElement} */ from) => {
    const value = Math.round(Number(from.value)) || 1;
    return Math.min(Number(from.max), Math.max(1, value));
  };

  function show() {
    const step = Number(slider.value), margin = model.thresholds[step];
    const window = whole(frames);
    const set = { margin, least_patches: whole(least), window, hits: Math.min(whole(hits), window) };
    // A single patch never needs less than the margin.
    const sudden = own.margin_now === null ? null : Math.max(own.margin_now, margin);
    const now = atOnce.checked ? nearest(model.thresholds, sudden ?? 0) : null;
    const patch = patchFigures(model, step), frame = frameFigures(model, { ...set, step, now });
    const same = margin === own.margin && set.least_patches === own.least_patches &&
      set.window === own.window && set.hits === own.hits && atOnce.checked === (sudden !== null);
    for (const name of FIGURES) {
      part(name).textContent = written(patch[name]);
      part(name).dataset.value = patch[name] === null ? "" : String(patch[name]);
    }
    for (const [name, said] of Object.entries(frame)) part(name).textContent = said;
    part("margin").textContent = `${Number(margin.toPrecision(4))}${same ? " (the model's operating point)" : ""}`;
    slider.setAttribute("aria-valuetext", `margin ${Number(margin.toPrecision(4))}`);
    if (sudden !== null) part("sudden").textContent = String(Number(sudden.toPrecision(4)));
    const x = across(model.thresholds, step);
    here.setAttribute("x1", String(x));
    here.setAttribute("x2", String(x));
  }

  function put(/** @type {Rule} */ rule) {
    slider.value = String(nearest(model.thresholds, rule.margin));
    least.value = String(rule.least_patches);
    hits.value = String(rule.hits);
    frames.value = String(rule.window);
    atOnce.checked = rule.margin_now !== null;
    show();
  }

  /** @type {[name: string, margin: number][]} */
  const ticks = [["tick-own", model.rule.margin], ["tick-zero", 0]];
  for (const [name, margin] of ticks) {
    const share = nearest(model.thresholds, margin) / Math.max(1, model.thresholds.length - 1);
    part(name).style.left = `calc(8px + ${share} * (100% - 16px))`;
    part(name).classList.toggle("rightward", share < 0.25);
    part(name).classList.toggle("leftward", share > 0.75);
  }
  slider.max = String(model.thresholds.length - 1);
  least.max = String(model.patches);
  for (const each of [slider, least, hits, frames, atOnce]) each.addEventListener("input", show);
  part("own").addEventListener("click", () => put(own));
  part("zero").addEventListener("click", () => put({ margin: 0, least_patches: 1, hits: 1, window: 1, margin_now: null }));
  put(own);
}

for (const form of document.querySelectorAll("[data-model]")) {
  if (form instanceof HTMLElement) explore(form);
}
