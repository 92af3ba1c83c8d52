import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { labelKeys, reachable } from "../../../../labels/page/static/core/keys.js";
import { frameKeys, keyForCommand } from "../../../../labels/page/static/frame/frame_keys.js";
import { REEF, loaded } from "./missions.js";

beforeEach(() => loaded());

test("every command of the frame view has keys of its own", () => {
  const commands = new Proxy({}, { get: (_, name) => () => name });
  const rows = frameKeys(commands).filter(({ group }) => group !== "Pointer");
  const keys = rows.flatMap((row) => row.keys);
  assert.deepEqual(keys, [...new Set(keys)]);
  assert.ok(rows.every(({ run, does }) => run && does));
  assert.ok(labelKeys.every((row) => rows.includes(row)));
});

test("a key that a class takes is reached with Alt", async () => {
  assert.deepEqual([reachable("n"), keyForCommand("next"), keyForCommand("copy")], ["n", "d", "p"]);
  await loaded({ classes: [{ ...REEF, key: "d" }, { ...REEF, name: "b", key: "p" }] });
  assert.deepEqual([reachable("n"), keyForCommand("next"), keyForCommand("copy")], ["n", ".", "Alt+p"]);
});
