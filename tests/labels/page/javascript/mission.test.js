import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import {
  classOf, clearClass, colourOf, frameIndex, frameOf, frames, givenIn, indexFrom, mission, onChange,
  sameMission, selectedClass, signOf, stateOf, strangerWords, takeNews,
} from "../../../../labels/page/static/core/mission.js";
import { address } from "../../../../labels/page/static/core/api.js";
import { loaded } from "./missions.js";

beforeEach(() => loaded());

test("frames are the numbers of all ranges", () => {
  assert.deepEqual(frames("left"), [10, 11, 12, 13, 20, 21, 22]);
  assert.deepEqual(frames("nowhere"), []);
  assert.deepEqual([10, 13, 20, 14].map((frame) => frameIndex("left", frame)), [0, 3, 4, -1]);
  assert.deepEqual([0, 14, 23].map((frame) => indexFrom("left", frame)), [0, 4, 7]);
  assert.deepEqual([stateOf("left", 12), stateOf("left", 14)], ["s", ""]);
});

test("frames are in the dive's order, and a number that no browser holds is text", async () => {
  const large = ["1403636579763555584", "1403636579813555456"];
  const ranges = [[235950, 235951], [0, 1], ...large.map((one) => [one, one])];
  await loaded({ cameras: { left: { ranges, count: 6 } }, states: { left: "uuuuuu" } });
  assert.deepEqual(frames("left"), [235950, 235951, 0, 1, ...large]);
  assert.deepEqual([0, large[1], 7].map((frame) => frameIndex("left", frame)), [2, 5, -1]);
  assert.deepEqual([frameOf("12"), frameOf(large[0])], [12, large[0]]);
  takeNews({ event: 1, states: { left: { [large[0]]: "d" } } });
  assert.equal(stateOf("left", large[0]), "d");
});

test("a class is known by its name, also one that is only in the store", () => {
  assert.equal(clearClass(), "water");
  assert.equal(selectedClass(), "water");
  assert.equal(classOf("wreck").obstacle, null);
  assert.deepEqual([signOf("reef"), signOf("wreck")], ["2", "w"]);
});

test("colours that are too dark for their black rim become brighter", () => {
  assert.equal(colourOf("water"), classOf("water").color);
  assert.notEqual(colourOf("reef"), "#000080");
  const [r, g, b] = colourOf("reef").match(/\d+/g).map((part) => {
    const light = Number(part) / 255;
    return light <= 0.04045 ? light / 12.92 : ((light + 0.055) / 1.055) ** 2.4;
  });
  assert.ok(0.2126 * r + 0.7152 * g + 0.0722 * b > 0.4);
});

test("news change what they name, and are told once", () => {
  const told = [];
  const stop = onChange((what) => told.push(what));
  takeNews({ event: 9, states: { left: { 13: "d", 99: "d" } }, given: { left: { 13: ["reef"] } } });
  takeNews({ event: 3, counts: { reef: 2 }, fault: "the disk is full" });
  stop();
  takeNews({ counts: {} });
  assert.deepEqual([stateOf("left", 13), givenIn("left", 13)], ["d", ["reef"]]);
  assert.deepEqual([mission.event, mission.fault], [9, "the disk is full"]);
  assert.deepEqual(told, ["states", "states", "status"]);
});

test("another mission's server, or another grid, is a stranger", async () => {
  const answer = await loaded();
  assert.equal(strangerWords(answer), "");
  const other = { ...answer, mission: "wreck" };
  assert.match(strangerWords(other), /now shows mission wreck; start it with dive again/);
  assert.equal(sameMission({ ...answer, grid: { rows: 3, cols: 5 } }), false);
});

test("an address leaves out what is null and repeats lists", () => {
  assert.equal(address("/api/x", { a: 1, b: null, c: ["y z", "w"] }), "/api/x?a=1&c=y+z&c=w");
});
