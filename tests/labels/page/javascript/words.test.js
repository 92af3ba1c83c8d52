import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

const STATIC = new URL("../../../../labels/page/static/", import.meta.url);

test("what training needs is said as training demands it", () => {
  for (const file of ["files/files_view.js", "labelling/drawer.js"]) {
    const text = readFileSync(new URL(file, STATIC), "utf8");
    assert.match(text, /six labelled frames.*: water in three of them, obstacles in three/);
  }
});
