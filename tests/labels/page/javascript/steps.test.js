import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { mission, setSetting } from "../../../../labels/page/static/core/mission.js";
import { nextBlindFrame } from "../../../../labels/page/static/labelling/blind_list.js";
import {
  filterChoices, filterName, filterWords, onClassFrames, passing, passingFrames,
} from "../../../../labels/page/static/labelling/filters.js";
import { nextIn, nextUncertain, stepFrom, whereStopped } from "../../../../labels/page/static/labelling/steps.js";
import { MODEL, answers, loaded } from "./missions.js";

beforeEach(() => loaded());

test("a step is of the filter, and null at the end", () => {
  assert.equal(stepFrom("left", 13, 1), 20);
  assert.equal(stepFrom("left", 13, -2), 11);
  assert.equal(stepFrom("left", 22, 1), null);
  setSetting("filter", "u");
  assert.deepEqual(passingFrames("left"), [20, 22]);
  assert.equal(stepFrom("left", 10, 2), 22);
  assert.equal(stepFrom("left", 10, 9), 22); // as far as it goes
});

test("the next frame in a state is looked for round the end of the mission", () => {
  assert.equal(nextIn("left", 13, "s"), 21);
  assert.equal(nextIn("left", 22, "s"), 12);
  assert.equal(nextIn("left", 12, "s", -1), 21);
  assert.equal(nextIn("left", 10, "x"), null);
  assert.equal(nextIn("left", 13, "p"), null); // it is itself no other one
});

test("a person goes on at the frame labelled last, else at the first that is not done", async () => {
  assert.deepEqual(whereStopped(), ["left", 12]);
  mission.undo = { undo: { camera: "right", frame: 11 }, redo: null };
  assert.deepEqual(whereStopped(), ["right", 11]);
  await loaded({ states: { left: "ddddddd", right: "dd" } });
  assert.deepEqual(whereStopped(), ["left", 10]);
});

test("filters are by state, class and depth; one that is gone lets all through", () => {
  const names = filterChoices().map(([name]) => name);
  assert.ok(["all", "open", "x", "class:reef", "depth:2:4"].every((name) => names.includes(name)));
  setSetting("filter", "class:gone");
  assert.deepEqual([filterName(), filterWords()], ["all", "all frames"]);
  mission.blind = true;
  assert.equal(filterChoices().some(([name]) => name === "x"), false);
});

test("frames with a label of a class are asked of the server, and told of when they are there", async () => {
  answers({ "/api/frames_with": ({ searchParams }) => {
    return { cameras: { left: searchParams.get("class") === "reef" ? [11, 20] : [], right: [] } };
  } });
  setSetting("filter", "class:reef");
  const known = new Promise((resolve) => onClassFrames(resolve));
  assert.equal(passing()("left", 11), false); // not known yet
  assert.equal(await known, true);
  assert.deepEqual(passingFrames("left"), [11, 20]);
});

test("the queue says why, its frames come once each, those of this camera first", async () => {
  assert.match((await nextUncertain("left", 10)).why, /no model yet/);
  await loaded({ model: MODEL });
  const queue = (change) => answers({ "/api/queue": {
    ready: true, done: 2, total: 2, why_not: "", frames: [], ...change,
  } });
  queue({ ready: false, done: 1 });
  assert.match((await nextUncertain("left", 10)).why, /still looking .* \(1 of 2 frames\)/);
  queue({ frames: [
    { camera: "right", frame: 11, score: 1, why: "a" }, { camera: "left", frame: 12, score: 1, why: "b" },
  ] });
  assert.equal((await nextUncertain("left", 10)).frame, 12);
  assert.equal((await nextUncertain("left", 12)).frame, 11);
  assert.match((await nextUncertain("right", 11)).why, /begins again/);
  queue({ why_not: "The model cannot judge 3 frames" });
  assert.match((await nextUncertain("right", 11)).why, /cannot judge 3 frames/);
});

test("without a list nothing is to be labelled blind", () => {
  mission.blind = true;
  assert.equal(nextBlindFrame("left", 10), null);
});
