import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { mission, setSetting } from "../../../../labels/page/static/core/mission.js";
import { hintsOf, leftWords, restOf } from "../../../../labels/page/static/labelling/painting.js";
import {
  asksObstacleClass, chosenObstacles, framesFollowed, modelObstacles, obstacleClass, obstacleClasses,
  percentRight, suggestedLabels, whyNoSuggestions,
} from "../../../../labels/page/static/labelling/suggest.js";
import { prefetch } from "../../../../labels/page/static/saving/labels.js";
import { MODEL, REEF, UNSURE, WATER, answers, loaded } from "./missions.js";

let event = 100;

/** Let frames of the left camera have labels of mine, and suggestions [class, value] a patch. */
async function labelled(byFrame) {
  event += 100;
  const frames = Object.entries(byFrame).map(([frame, { mine, says, fault = "" }]) => ({
    camera: "left", frame: Number(frame), mine, models: {}, others: {}, notes: [],
    settled: mine.map(() => null),
    suggestions: says && {
      model: MODEL.label, classes: says.map(([index]) => index), values: says.map(([, v]) => v), fault,
    },
  }));
  answers({ "/api/labels": { event, frames } });
  const { labelsAreStale } = await import("../../../../labels/page/static/saving/labels.js");
  labelsAreStale(frames.map(({ camera, frame }) => [camera, frame]), event);
  await prefetch("left", frames.map(({ frame }) => frame));
}

const NONE = [null, null];
const OBSTACLE = 0;
const CLEAR = 1;

beforeEach(() => loaded({ model: { ...MODEL } }));

test("the obstacle class is what somebody said, else what the model learnt most", () => {
  assert.deepEqual(obstacleClasses(), ["reef", "sand"]);
  assert.equal(obstacleClass(), "reef");
  assert.equal(asksObstacleClass(), true); // two were learnt and nobody said which
  mission.settings = { obstacle_as: "sand" };
  assert.deepEqual([obstacleClass(), asksObstacleClass()], ["sand", false]);
});

test("of several chosen classes an obstacle is the one that painting gives, else the first", () => {
  mission.settings = { obstacle_as: "sand,reef,gone" };
  setSetting("selected", "water");
  assert.deepEqual([chosenObstacles(), obstacleClass()], [["reef", "sand"], "reef"]);
  setSetting("selected", "sand");
  assert.deepEqual([obstacleClass(), asksObstacleClass()], ["sand", false]);
  mission.settings = { obstacle_as: "reef" };
  assert.equal(obstacleClass(), "reef"); // sand is none of them
  setSetting("selected", "");
});

test("nobody is asked about obstacles where there is one class of them", async () => {
  await loaded({ model: { ...MODEL, learnt: {} }, classes: [WATER, REEF, UNSURE] });
  assert.equal(asksObstacleClass(), false);
});

test("why nothing is suggested is said, until something is or all is labelled", async () => {
  const why = () => whyNoSuggestions("left", 20);
  const says = async (patches, fault = "") => labelled({ 20: { mine: NONE, says: patches, fault } });
  assert.equal(why(), ""); // not loaded yet
  await says(null);
  assert.match(why(), /is looking at this frame/);
  await says([], "too small");
  assert.equal(why(), "No suggestions: too small");
  await says([[CLEAR, null], [CLEAR, null]]);
  assert.match(why(), /would call clear is not seen/);
  await says([[CLEAR, null], [OBSTACLE, 1]]);
  assert.equal(why(), "");
  setSetting("suggestions", false);
  assert.match(why(), /switched off/);
  setSetting("suggestions", true);
  await labelled({ 20: { mine: ["reef", "water"], says: null } });
  assert.equal(why(), "");
  await says(null);
  mission.blind = true;
  assert.match(why(), /Blind/);
  mission.blind = false;
  mission.model = null;
  assert.match(why(), /no model yet/);
});

test("how sure the page says a model is comes from its own measured patches", () => {
  assert.equal(percentRight(true, 0.5), 80);
  assert.equal(percentRight(true, 1), 97); // a range begins with its lower end
  assert.equal(percentRight(true, 50), 97); // and the last one has no end
  assert.equal(percentRight(false, 0), 99);
  assert.equal(percentRight(false, -1), null);
});

test("the chain before a frame ends where numbers jump and where all is labelled", () => {
  assert.deepEqual(framesFollowed("left", 13), [12, 11]); // 11 is done
  assert.deepEqual(framesFollowed("left", 20), []); // 13 is more than 5 away
  mission.single_pictures = true; // no sequence
  assert.deepEqual(framesFollowed("left", 13), []);
  mission.single_pictures = false;
  setSetting("follow", 0);
  assert.deepEqual(framesFollowed("left", 13), []);
});

test("a suggestion is what the model says, sure from the threshold on", async () => {
  await labelled({ 20: { mine: NONE, says: [[OBSTACLE, 0.4], [CLEAR, 0.6]] } });
  const [first, second] = suggestedLabels("left", 20);
  assert.deepEqual([first.label, first.confident, first.percent], ["reef", false, 80]);
  assert.deepEqual([second.label, second.confident, second.percent], ["water", true, 99]);
  assert.deepEqual(modelObstacles("left", 20), [true, false]);
});

test("what was labelled before is kept against a weak model, but no obstacle is overlooked", async () => {
  await labelled({
    11: { mine: ["sand", "water"], says: [[OBSTACLE, 1], [CLEAR, 1]] },
    12: { mine: NONE, says: [[CLEAR, 1.9], [OBSTACLE, 0.1]] },
  });
  const [kept, seen] = suggestedLabels("left", 12);
  assert.deepEqual([kept.label, kept.against, kept.confident], ["sand", true, false]);
  assert.deepEqual([seen.label, seen.against], ["reef", false]);
  await labelled({ 12: { mine: NONE, says: [[CLEAR, 2], [OBSTACLE, 0.1]] } });
  assert.equal(suggestedLabels("left", 12)[0].label, "water"); // from "follow" on the model counts
});

test("clear is not suggested where nothing is seen, an obstacle is", async () => {
  await labelled({
    11: { mine: ["sand", "water"], says: [[CLEAR, 1], [CLEAR, 1]] },
    12: { mine: NONE, says: [[CLEAR, null], [CLEAR, null]] },
    20: { mine: NONE, says: [[OBSTACLE, 9], [CLEAR, null]] },
  });
  setSetting("confidence", 0);
  const [obstacle, clear] = suggestedLabels("left", 20);
  assert.deepEqual([obstacle.label, obstacle.confident, clear], ["reef", true, null]);
  const [kept, water] = suggestedLabels("left", 12); // what was labelled before is kept
  assert.deepEqual([kept.label, kept.confident, water], ["sand", false, null]);
  assert.equal(hintsOf("left", 12)[1], null);
});

test("a proposal kept from the frame before carries no model and is marked", async () => {
  await labelled({
    11: { mine: ["sand", null], says: [[OBSTACLE, 1], [CLEAR, 1]] },
    12: { mine: NONE, says: [[OBSTACLE, 1], [CLEAR, 1]] },
  });
  const [kept, own] = hintsOf("left", 12);
  assert.deepEqual([kept.label, kept.text, kept.model, kept.kept], ["sand", "→", null, true]);
  assert.deepEqual([own.label, own.text, own.model, own.kept], ["water", "1.00", MODEL.label, false]);
});

test("one key for the rest leaves out what the model calls an obstacle", async () => {
  await labelled({ 20: { mine: NONE, says: [[OBSTACLE, 0.1], [CLEAR, 1]] } });
  assert.deepEqual(restOf("left", 20), { cells: [1], left: 1, waits: false });
  await labelled({ 20: { mine: NONE, says: null } });
  assert.deepEqual(restOf("left", 20), { cells: [], left: 2, waits: true });
  assert.equal(leftWords(0), "");
  assert.match(leftWords(1), /^1 patch stays open/);
});

test("another model's suggestions, or none for the blind, are not shown", async () => {
  await labelled({ 20: { mine: NONE, says: [[OBSTACLE, 0.4], [CLEAR, 0.6]] } });
  mission.model.label = "obstacles 4";
  assert.equal(suggestedLabels("left", 20), null);
  mission.blind = true;
  assert.deepEqual(modelObstacles("left", 20), []);
});
