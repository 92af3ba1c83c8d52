"use strict";
// The threshold explorer: every figure anew from the counts and frame scores in the page.

const OBSTACLE = 1, CLEAR = 0, UNKNOWN = -1;
const comparison = JSON.parse(document.getElementById("comparison").textContent);
const explorer = comparison.explorer;

// A patch's score exceeds thresholds[k] exactly where its rank exceeds k.
function decode(model) {
  model.ranks = Uint8Array.from(atob(model.ranks), (byte) => byte.charCodeAt(0));
}

// As FrameRuleState of the runtime: what was before the first frame, and in a gap, is unknown.
// The rule's margins are steps of the model's thresholds here; now is null where it is off.
class RuleState {
  constructor(rule, patches, white) {
    Object.assign(this, { rule, white, needed: Math.max(rule.least_patches, white) });
    this.last = new Array(rule.window).fill(null);
    this.counts = new Int16Array(patches);  // known places of the window over the margin
    this.known = 0;
  }

  skip() {
    this.push(null);
    return UNKNOWN;
  }

  push(ranks) {
    for (const [place, by] of [[this.last.shift(), -1], [ranks, 1]]) {
      if (place === null) continue;
      this.known += by;
      place.forEach((rank, patch) => { if (rank > this.rule.step) this.counts[patch] += by; });
    }
    this.last.push(ranks);
  }

  add(ranks) {
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

function statuses(model, rule) {
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

// The first of three frames in a row with status 1; a gap in the frames breaks a row.
function firstDetection(found, { start, stop }) {
  let row = 0;
  for (let i = start; i < stop; i++) {
    if (i > start && explorer.frames.gap[i]) row = 0;
    row = found[i] === OBSTACLE ? row + 1 : 0;
    if (row === 3) return i - 2;
  }
  return null;
}

function patchFigures(model, step) {
  const hit = model.true_positive[step], wrong = model.false_positive[step];
  const missed = explorer.obstacle - hit;
  const ratio = (part, whole) => (whole ? part / whole : null);
  return {
    precision: ratio(hit, hit + wrong),
    recall: ratio(hit, explorer.obstacle),
    f1: explorer.obstacle ? ratio(2 * hit, 2 * hit + wrong + missed) : null,
  };
}

function frameFigures(model, rule) {
  const found = statuses(model, rule);
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
  const total = (of) => of.filter(Boolean).length;
  return {
    falseStatus: `${count(ocean)} / ${total(ocean)}`,
    detected: `${count(obstacle)} / ${total(obstacle)}`,
    first: first.join("; "),
  };
}

const written = (value) => (value === null ? "–" : value.toFixed(3));

function nearest(thresholds, value) {
  const distances = thresholds.map((t) => Math.abs(t - value));
  return distances.indexOf(Math.min(...distances));
}

function element(name, attributes) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

const WIDTH = 480, HEIGHT = 170, LEFT = 26, TOP = 10, FOOT = 6;

// By step, as the slider above moves: not by value.
function across(thresholds, step) {
  return LEFT + ((WIDTH - LEFT - 6) * step) / Math.max(1, thresholds.length - 1);
}

function drawCurves(svg, model) {
  const up = (value) => TOP + (HEIGHT - FOOT - TOP) * (1 - value);
  for (const value of [0, 0.5, 1]) {
    svg.append(element("line", { class: "axis", x1: LEFT, x2: WIDTH, y1: up(value), y2: up(value) }));
    const text = element("text", { x: 0, y: up(value) + 4 });
    text.textContent = value.toFixed(1);
    svg.append(text);
  }
  for (const figure of ["precision", "recall", "f1"]) {
    const points = [];
    model.thresholds.forEach((_, step) => {
      const value = patchFigures(model, step)[figure];
      if (value !== null) points.push(`${across(model.thresholds, step).toFixed(1)},${up(value).toFixed(1)}`);
    });
    svg.append(element("polyline", { class: figure, points: points.join(" ") }));
  }
  const line = (name, value) => {
    const x = across(model.thresholds, nearest(model.thresholds, value));
    const made = element("line", { class: name, x1: x, x2: x, y1: 0, y2: HEIGHT - FOOT });
    svg.append(made);
    return made;
  };
  line("own", model.rule.margin);
  if (model.rule.margin_now !== null) line("at-once", model.rule.margin_now);
  return line("now", 0);
}

function explore(form) {
  const model = explorer.models[form.dataset.model];
  const part = (name) => form.querySelector(`[data-is="${name}"]`);
  const slider = part("slider"), least = part("least"), hits = part("hits"), frames = part("window");
  const atOnce = part("at-once"), own = model.rule;
  const here = drawCurves(part("chart"), model);
  const whole = (input) => {
    const value = Math.round(Number(input.value)) || 1;
    return Math.min(Number(input.max), Math.max(1, value));
  };

  function show() {
    const step = Number(slider.value), margin = model.thresholds[step];
    const set = { margin, least_patches: whole(least), window: whole(frames) };
    set.hits = Math.min(whole(hits), set.window);
    // A single patch never needs less than the margin.
    const sudden = own.margin_now === null ? null : Math.max(own.margin_now, margin);
    const now = atOnce.checked ? nearest(model.thresholds, sudden) : null;
    const patch = patchFigures(model, step), frame = frameFigures(model, { ...set, step, now });
    const same = Object.keys(set).every((key) => set[key] === own[key]) && atOnce.checked === (sudden !== null);
    const at = { ...patch, ...frame };
    for (const name of ["precision", "recall", "f1"]) {
      part(name).textContent = written(at[name]);
      part(name).dataset.value = at[name] === null ? "" : String(at[name]);
    }
    for (const name of ["falseStatus", "detected", "first"]) part(name).textContent = at[name];
    part("margin").textContent = `${Number(margin.toPrecision(4))}${same ? " (the model's operating point)" : ""}`;
    slider.setAttribute("aria-valuetext", `margin ${Number(margin.toPrecision(4))}`);
    if (sudden !== null) part("sudden").textContent = Number(sudden.toPrecision(4));
    const x = across(model.thresholds, step);
    here.setAttribute("x1", x);
    here.setAttribute("x2", x);
  }

  function put(rule) {
    slider.value = String(nearest(model.thresholds, rule.margin));
    least.value = String(rule.least_patches);
    hits.value = String(rule.hits);
    frames.value = String(rule.window);
    atOnce.checked = rule.margin_now !== null;
    show();
  }

  for (const [name, margin] of [["tick-own", model.rule.margin], ["tick-zero", 0]]) {
    const share = nearest(model.thresholds, margin) / Math.max(1, model.thresholds.length - 1);
    part(name).style.left = `calc(8px + ${share} * (100% - 16px))`;
    part(name).classList.toggle("rightward", share < 0.25);
    part(name).classList.toggle("leftward", share > 0.75);
  }
  slider.max = String(model.thresholds.length - 1);
  least.max = String(model.patches);
  for (const input of [slider, least, hits, frames, atOnce]) input.addEventListener("input", show);
  part("own").addEventListener("click", () => put(own));
  part("zero").addEventListener("click", () => put({ margin: 0, least_patches: 1, hits: 1, window: 1, margin_now: null }));
  put(own);
}

Object.values(explorer.models).forEach(decode);
document.querySelectorAll("[data-model]").forEach(explore);
