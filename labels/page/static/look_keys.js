// Keys for how pictures look, the same in every view that shows pictures.

import { setSetting, setting } from "./mission.js";

const STEP = 10;

function enhance(by) {
  setSetting("enhance", Math.max(0, Math.min(100, setting("enhance") + by)));
}

function otherPalette() {
  setSetting("palette", setting("palette") === "taxonomy" ? "contrast" : "taxonomy");
}

const row = (key, does, run) => ({ keys: [key], does, run, group: "Seeing" });

/** @type {KeyEntry[]} */
export const lookKeys = [
  row("[", "less contrast", () => enhance(-STEP)),
  row("]", "more contrast", () => enhance(STEP)),
  row("k", "colours: taxonomy, or high contrast", otherPalette),
];
