// The mission as the server describes it, kept up to date: classes, frames, states, counts.

import { get, onFailure, post } from "./api.js";
import { signal } from "./dom.js";
import { setSetting, setting, setWho, who } from "./settings.js";
/** @import { Derived, MissionAnswer, MissionState, News, Person, Signal } from "./types.js" */

export { onSetting, setSetting, setting, who } from "./settings.js";

/** The last /api/mission. @type {MissionState} */
export const mission = {
  loaded: false, mission: "", pictures: "", grid: { rows: 0, cols: 0, width: null }, cameras: {},
  classes: [], annotator: "", blind: false, annotators: [], model: null, fault: "", setup: "",
  event: 0, states: {}, given: {}, counts: {}, undo: { undo: null, redo: null }, masked: {},
  described: false,
  settings: {}, job: null, depths: [], carries: false, single_pictures: false, formats: {},
};

const LIGHT = 0.405; // 0.4, and what rounding may take

/** @type {Derived} */
const here = {
  byName: new Map(), frames: {}, places: {}, masked: {}, settingsHeard: 0, person: 0,
};

/** @type {Signal<[what: "all" | "states" | "status"]>} Be told that something of it changed. */
export const [onChange, changed] = signal();

/** Ask the server for everything about the mission. Throws ApiError. */
export async function loadMission() {
  const asked = here.person;
  const heard = here.settingsHeard;
  const answer = await get("/api/mission");
  // What was asked before another person came, or blind, is not for their eyes.
  if (asked === here.person && (!mission.loaded || sameMission(answer))) {
    // It may have been put together before what was heard meanwhile.
    if (heard !== here.settingsHeard) answer.settings = mission.settings;
    takeMission(answer);
  }
  return answer;
}

/** What to say where an /api/mission answer is not of this page's mission; "" where it is. */
export function strangerWords(/** @type {MissionAnswer} */ answer) {
  if (sameMission(answer)) return "";
  return `the server now shows mission ${answer.mission}; start it with ${mission.mission} again`;
}

/** Whether an answer is of the mission this page was opened on, not of another on the same port. */
export function sameMission(/** @type {MissionAnswer} */ answer) {
  const { rows, cols } = answer.grid;
  return (
    answer.mission === mission.mission && rows === mission.grid.rows && cols === mission.grid.cols
  );
}

function takeMission(/** @type {MissionAnswer} */ answer) {
  /** @type {Record<string, string[]>} */
  const states = {};
  for (const [camera, text] of Object.entries(answer.states)) states[camera] = [...text];
  Object.assign(mission, answer, { states, loaded: true });
  here.byName = new Map();
  for (const known of answer.classes) {
    here.byName.set(known.name, { ...known, color: lightened(known.color) });
  }
  here.frames = {};
  here.places = {};
  here.masked = {};
  changed("all");
}

/** Take in what an acknowledgement or an event says. */
export function takeNews(/** @type {News} */ news) {
  // Classes, the model or the masks were changed, here or elsewhere.
  if (news.setup && news.setup !== mission.setup) loadMission().catch(onFailure());
  if ((news.event ?? 0) > mission.event) mission.event = news.event ?? 0;
  for (const [camera, frames_] of Object.entries(news.states ?? {})) {
    for (const [frame, state] of Object.entries(frames_)) setState(camera, frameOf(frame), state);
  }
  for (const [camera, labels] of Object.entries(news.given ?? {})) {
    Object.assign((mission.given[camera] ??= {}), labels);
  }
  if (news.counts) mission.counts = news.counts;
  if (news.states || news.counts) changed("states");
  if (news.fault !== undefined) mission.fault = news.fault;
  if (news.model && mission.model) mission.model = { ...mission.model, ...news.model };
  if (news.settings) {
    mission.settings = news.settings;
    here.settingsHeard += 1;
  }
  if (news.job !== undefined) mission.job = news.job;
  if (news.fault !== undefined || news.model || news.settings) changed("status");
}

/** @param {string} camera @param {number} frame @param {string} state */
function setState(camera, frame, state) {
  const index = frameIndex(camera, frame);
  if (index >= 0) mission.states[camera][index] = state;
}

/** @type {Signal<[]>} Be told that another person works here, before the mission is loaded anew. */
export const [onReload, personChanged] = signal();

/** Work as somebody else, or hide (or show again) what others and the model said to this person,
 * everywhere. Another name holds at once, also where loading everything anew fails (ApiError).
 * @param {Partial<Person>} change
 */
export async function setPerson({ who: name = who(), blind: hides }) {
  // The server takes no name with signs that cannot be seen, and to it names that look the same
  // are one only where they are written the same.
  const chosen = name.normalize().replace(/\s+/g, " ").replace(/\p{C}/gu, "").trim();
  if (hides !== undefined) await post("/api/blind", { who: chosen, blind: hides });
  setWho(chosen);
  await beginAnew(hides);
}

/** Load the mission anew for who works here now, who labels blind if `hides`; throws ApiError. */
export async function beginAnew(hides = mission.blind) {
  mission.blind = hides;
  here.person += 1;
  forgetOthers();
  personChanged();
  changed("states");
  await loadMission();
}

/** Take in an answer unless somebody else works here by the time it comes. */
export async function takeNewsOf(/** @type {Promise<News>} */ request) {
  const asked = here.person;
  const news = await request;
  if (asked === here.person) takeNews(news);
}

// Until the mission is loaded anew, which may take long: nothing that shows what others said.
function forgetOthers() {
  mission.model = null;
  mission.annotators = [who()];
  mission.given = {};
  for (const states of Object.values(mission.states)) {
    states.forEach((state, at) => state === "x" && (states[at] = "p"));
  }
}

/** A class by its name; also for names that the taxonomy does not have. */
export function classOf(/** @type {?string | undefined} */ name) {
  return here.byName.get(name ?? "") ?? {
    name: name ?? "", obstacle: null, color: "#e6e6e6", key: "", description: "",
  };
}

export function colourOf(/** @type {?string} */ name) {
  return classOf(name).color;
}

/** With a luminance of 0.4 a colour has 9:1 on its black rim ((0.4 + 0.05) / 0.05), so that one of
 * both has 3:1 on any picture. Darker ones become brighter, then paler.
 */
function lightened(/** @type {string} */ color) {
  const luminance = (/** @type {number[]} */ [r, g, b]) => 0.2126 * r + 0.7152 * g + 0.0722 * b;
  let rgb = [1, 3, 5].map((at) => {
    const part = parseInt(color.slice(at, at + 2), 16) / 255;
    return part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
  });
  if (luminance(rgb) >= LIGHT) return color;
  const scale = Math.min(1 / Math.max(...rgb, 1e-6), LIGHT / luminance(rgb));
  rgb = rgb.map((part) => part * scale);
  const white = Math.max(0, (LIGHT - luminance(rgb)) / (1 - luminance(rgb)));
  const shown = rgb.map((part) => 255 * (1.055 * (part + (1 - part) * white) ** (1 / 2.4) - 0.055));
  return `rgb(${shown.map((part) => Math.max(0, Math.round(part))).join(" ")})`;
}

/** The sign that stands for a class besides its colour: its key, else its first letter. */
export function signOf(/** @type {string} */ name) {
  return classOf(name).key || name.slice(0, 1);
}

/** The class that somebody chose in this browser; null where nobody did. */
export function chosenClass() {
  const name = setting("selected");
  return here.byName.has(name) ? name : null;
}

/** The class that painting puts on patches. */
export function selectedClass() {
  return chosenClass() ?? mission.classes[0]?.name ?? "";
}

export function selectClass(/** @type {string} */ name) {
  setSetting("selected", name);
}

/** The frame numbers of a camera, in the dive's order. A number beyond 2^53 is text here. */
export function frames(/** @type {string} */ camera) {
  here.frames[camera] ??= (mission.cameras[camera]?.ranges ?? []).flatMap(([first, last]) =>
    first === last
      ? [first]
      : Array.from({ length: last - first + 1 }, (_, index) => first + index),
  );
  return here.frames[camera];
}

/** A frame number out of text, as `frames` has it. */
export function frameOf(/** @type {string | number} */ text) {
  const number = Number(text);
  return /** @type {number} */ (Number.isSafeInteger(number) ? number : text);
}

/** The cells of a camera's frames that are no view: they take no label. */
export function maskedCells(/** @type {string} */ camera) {
  return (here.masked[camera] ??= new Set(mission.masked[camera]));
}

/** Those of some cells that are in view. @param {string} camera @param {Iterable<number>} cells */
export function inView(camera, cells) {
  const masked = maskedCells(camera);
  return [...cells].filter((cell) => !masked.has(cell));
}

/** Where a frame stands in `frames(camera)`; -1 if it is not there. */
export function frameIndex(/** @type {string} */ camera, /** @type {number} */ frame) {
  here.places[camera] ??= new Map(frames(camera).map((number, index) => [number, index]));
  return here.places[camera].get(frame) ?? -1;
}

/** Where a frame stands, or else the first with a higher number; the count if there is none. */
export function indexFrom(/** @type {string} */ camera, /** @type {number} */ frame) {
  const at = frameIndex(camera, frame);
  if (at >= 0) return at;
  const higher = frames(camera).findIndex((number) => Number(number) > Number(frame));
  return higher >= 0 ? higher : frames(camera).length;
}

/** The state of a frame: u unseen, s seen, p part, d done, x disagreement; "" if not there. */
export function stateOf(/** @type {string} */ camera, /** @type {number} */ frame) {
  return mission.states[camera]?.[frameIndex(camera, frame)] ?? "";
}

/** The labels that the person who works here gave somewhere in a frame, as the server knows. */
export function givenIn(/** @type {string} */ camera, /** @type {number} */ frame) {
  return mission.given[camera]?.[frame] ?? [];
}

/** The first class of the taxonomy that is no obstacle. */
export function clearClass() {
  return mission.classes.find((known) => known.obstacle === false)?.name ?? "";
}
