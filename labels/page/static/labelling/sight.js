// Which patches of a frame are not seen, and why, as the server says when the labels are there.

import { get, onFailure } from "../core/api.js";
import { inView, mission } from "../core/mission.js";
import { labelsChanged } from "../saving/labels.js";

const KEPT = 400;
/** Why each patch is not seen, by frame; null while it is asked for. @type {Map<string, ?string[]>} */
const known = new Map();

/** The model and the masks decide, too. @param {string} camera @param {number} frame */
function nameOf(camera, frame) {
  return `${mission.setup}/${camera}/${frame}`;
}

/** Ask the server, once a frame. @param {string} camera @param {number} frame */
export async function askSight(camera, frame) {
  const name = nameOf(camera, frame);
  if (known.has(name)) return;
  known.set(name, null);
  const asked = { camera, frame, v: mission.pictures };
  const answer = await get("/api/sight", asked).catch(onFailure());
  if (!answer) return void known.delete(name);
  known.set(name, answer.causes);
  if (known.size > KEPT) known.delete([...known.keys()][0]);
  labelsChanged(camera, frame);
}

/** Why patches in view are not seen, by cell; empty while that is not known.
 * @param {string} camera @param {number} frame
 */
export function unseenOf(camera, frame) {
  const causes = known.get(nameOf(camera, frame)) ?? [];
  const cells = inView(camera, causes.keys()).filter((cell) => causes[cell]);
  return new Map(cells.map((cell) => [cell, causes[cell]]));
}

/** The same in words. @param {string} camera @param {number} frame */
export function unseenWords(camera, frame) {
  const causes = [...unseenOf(camera, frame).values()];
  const patches = causes.length === 1 ? "1 patch is" : `${causes.length} patches are`;
  return causes.length ? `${patches} not seen: ${[...new Set(causes)].sort().join(", ")}` : "";
}
