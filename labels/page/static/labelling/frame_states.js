// The states of frames, as every view names and draws them.

/** @import { FrameLook } from "../types.js" */

/** Later ones win a shared pixel. @type {Record<string, FrameLook>} */
export const STATES = {
  u: { words: "unseen", colour: "#66727d", height: 0.14 },
  s: { words: "seen", colour: "#b4bec7", height: 0.34 },
  d: { words: "done", colour: "#4fb3e8", height: 1 },
  p: { words: "part", colour: "#f0b429", height: 0.62 },
  x: { words: "disagreement", colour: "#ff5c8a", height: 1 },
};
