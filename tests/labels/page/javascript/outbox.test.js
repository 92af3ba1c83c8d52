import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import {
  closeConflicts, dequeue, enqueue, framesOf, noteConflicts, setAside, takeBack, uniqueKey,
  unwritten, waiting, waitingFor,
} from "../../../../labels/page/static/saving/outbox.js";
import { allOwn, changesOf, patchesAre } from "../../../../labels/page/static/saving/saver.js";
import { loaded } from "./missions.js";

const change = (camera, frame, cells) => ({ camera, frame, label: "reef", model: null, cells, base: cells.map(() => null) });
const entry = (key, ...changes) => ({ key, who: "ann", mission: "dive", source: "human", changes });

beforeEach(() => loaded());

test("entries are sent in order, those of an earlier page before all others", () => {
  const [a, b, c] = [entry("a", change("left", 10, [0])), entry("b", change("left", 10, [1])), entry("c", change("left", 11, [1]))];
  enqueue(a);
  enqueue(b);
  enqueue(c, { first: true });
  assert.deepEqual(waiting(), [c, a, b]);
  assert.deepEqual(waitingFor("left", 10), [a, b]);
  dequeue(a);
  assert.deepEqual([waiting(), waitingFor("left", 10)], [[c, b], [b]]);
  dequeue(b);
  dequeue(c);
  assert.deepEqual([waiting(), waitingFor("left", 10), waitingFor("left", 11)], [[], [], []]);
});

test("a frame that an entry changes twice is named once", () => {
  const one = entry("a", change("left", 10, [0]), change("right", 10, [0]), change("left", 10, [3]));
  assert.deepEqual(framesOf(one), [["left", 10], ["right", 10]]);
});

test("what the server refused stays until somebody decides", () => {
  const one = entry("a", change("left", 10, [0]));
  setAside(one, "unknown class");
  assert.deepEqual([unwritten().aside, one.refusal], [[one], "unknown class"]);
  takeBack(one);
  assert.deepEqual(unwritten().aside, []);
});

test("of two things said of a patch and not written only the newer is a conflict", () => {
  const cell = { camera: "left", frame: 10, cell: 3 };
  noteConflicts(entry("a"), [{ ...cell, theirs: "sand", yours: "reef" }]);
  noteConflicts(entry("b"), [{ ...cell, theirs: "sand", yours: "water" }, { ...cell, cell: 4, theirs: null, yours: "reef" }]);
  const { conflicts } = unwritten();
  assert.deepEqual(conflicts.map((one) => [one.cell, one.yours]), [[3, "water"], [4, "reef"]]);
  closeConflicts([...conflicts]);
  assert.deepEqual(unwritten().conflicts, []);
});

test("patches become one change for each frame, label and model", () => {
  const patch = (frame, cell, label, model = null) => ({ camera: "left", frame, cell, label, model, base: null });
  const changes = changesOf([
    patch(10, 0, "reef"), patch(11, 0, "reef"), patch(10, 1, "reef"), patch(10, 2, "sand"), patch(10, 3, "reef", "m"),
  ]);
  assert.deepEqual(changes.map(({ frame, label, cells }) => [frame, label, cells]), [
    [10, "reef", [0, 1]], [11, "reef", [0]], [10, "sand", [2]], [10, "reef", [3]],
  ]);
  assert.deepEqual(changes[0].base, [null, null]);
});

test("events are this page's own only where its own actions made all of them", () => {
  assert.equal(allOwn(4, 4), true);
  assert.equal(allOwn(4, 5), false);
});

test("words and keys", () => {
  assert.deepEqual([patchesAre(1), patchesAre(2300)], ["1 patch is", "2,300 patches are"]);
  assert.match(uniqueKey(), /^[0-9a-f]{32}$/);
  assert.notEqual(uniqueKey(), uniqueKey());
});
