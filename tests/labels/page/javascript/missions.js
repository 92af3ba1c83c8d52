// A small mission as the server describes it, for the tests of the page's pure functions.

import { loadMission, setSetting } from "../../../../labels/page/static/core/mission.js";

export const WATER = { name: "water", obstacle: false, color: "#3fa7d6", key: "1", description: "" };
export const REEF = { name: "reef", obstacle: true, color: "#000080", key: "2", description: "hard" };
export const SAND = { name: "sand", obstacle: true, color: "#d2b48c", key: "3", description: "" };
export const UNSURE = { name: "unsure", obstacle: null, color: "#e6e6e6", key: "u", description: "" };

export const MODEL = {
  label: "obstacles 3", classes: ["obstacle", "clear"], obstacle: [true, false],
  learnt: { reef: 200, sand: 10 }, right: [[1, 0, 1, 80], [1, 1, null, 97], [0, 0, null, 99]],
  done: 9, total: 9,
};

/** Load a mission of two cameras and a grid of 3 rows and 4 columns; `change`: what differs. */
export async function loaded(change = {}) {
  const answer = {
    mission: "dive", pictures: "v1", grid: { rows: 3, cols: 4, width: null },
    cameras: {
      left: { ranges: [[10, 13], [20, 22]], count: 7 }, right: { ranges: [[10, 11]], count: 2 },
    },
    classes: [WATER, REEF, SAND, UNSURE], annotator: "ann", blind: false, annotators: ["ann"],
    model: null, fault: "", setup: "s", event: 5, states: { left: "ddspusu", right: "du" },
    given: {}, counts: {}, undo: { undo: null, redo: null }, described: false, settings: {},
    job: null, depths: [[0, 2], [2, 4]], carries: false, single_pictures: false, formats: {},
    ...change,
  };
  answers({ "/api/mission": answer });
  await loadMission();
  for (const [name, value] of Object.entries({ filter: "all", follow: 2, confidence: 0.5 })) {
    setSetting(name, value);
  }
  return answer;
}

/** Let requests be answered, by path; what is asked for beside them is not there. */
export function answers(byPath) {
  globalThis.fetch = async (url) => {
    const path = url.split("?")[0];
    const found = byPath[path];
    if (!found) return Response.json({ error: `no ${path}` }, { status: 404 });
    return Response.json(typeof found === "function" ? found(new URL(url, "http://x")) : found);
  };
}
