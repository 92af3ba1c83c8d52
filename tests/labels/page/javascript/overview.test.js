import assert from "node:assert/strict";
import { test } from "node:test";
import { rangeWords } from "../../../../labels/page/static/overview/overview_bar.js";
import { loaded } from "./missions.js";

test("frames are named by their numbers, and counted apart from them", async () => {
  await loaded();
  assert.equal(rangeWords("left", [10, 13, 22]), "left frames 10 to 22: 3 of 7");
});
