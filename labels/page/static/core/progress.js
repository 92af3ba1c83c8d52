// How far the labelling of a camera's frames is, in the header: views say which camera they show.

import { byId, setText } from "./dom.js";
import { mission } from "./mission.js";

let shown = "";

/** Say how far a camera's frames are: without its name, those of the one shown before. */
export function showProgress(camera = shown) {
  shown = camera;
  const states = mission.states[shown] ?? Object.values(mission.states)[0];
  const done = states.filter((state) => state === "d").length;
  setText(byId("progress"), `${done} of ${states.length} done`);
}
