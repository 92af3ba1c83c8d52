// The bar of Mask mode: it saves the mask of a camera, gives it up, and finds what never moves.

import { get, onFailure, post } from "../core/api.js";
import { complain } from "../core/controls.js";
import { button, el, say, setAttribute, setText } from "../core/dom.js";
import { loadMission, maskedCells, mission } from "../core/mission.js";
import { patchesAre } from "../saving/saver.js";
import { drawMask, drawnMask, endDraft, unsaved } from "./mask_draft.js";
import { page, view } from "./frame_state.js";

const LOOK_MS = 300;
const NOTHING = "There is nothing to save.";
const FIND = "Find what never moves";
const WHAT = "Click or drag over what is no view in any frame: a clock, a rim, the vehicle itself.";

/** Build the bar; `changed`: another mask, or another tool, is to be shown. */
export function buildMaskBar(/** @type {() => void} */ changed) {
  const words = el("span", { role: "status" });
  const save = button("Save mask", saveMask, { class: "main" });
  const cancel = button("Cancel", () => {
    endDraft(page().show.camera, true);
    view.tool = "paint";
    changed();
  });
  const find = button(FIND, () => findMarks(changed, find), {
    title: "Look for text and edges that stay where they are in all frames",
  });
  const options = { class: "bar mask-bar", role: "group", "aria-label": "Mask", hidden: true };
  const root = el("div", options, words, save, cancel, find);
  window.addEventListener("beforeunload", warn);
  const show = () => {
    const { camera } = page().show;
    const open = unsaved(camera).length;
    root.hidden = view.tool !== "mask";
    const count = drawnMask(camera).size;
    const many = `${patches(count)} masked${open ? `, ${open} not saved` : ""}.`;
    setText(words, `${camera} camera: ${count || open ? many : WHAT}`);
    setAttribute(save, "aria-disabled", open ? null : "true");
    setAttribute(save, "title", open ? "Save it (Enter)" : NOTHING);
    setText(page().root.querySelector("[data-command=mask]"), open ? "Mask *" : "Mask");
  };
  return { root, show };
}

function patches(/** @type {number} */ count) {
  return count ? patchesAre(count) : "no patches are";
}

function warn(/** @type {Event} */ event) {
  if (Object.keys(mission.cameras).some((camera) => unsaved(camera).length)) event.preventDefault();
}

/** Save the mask of the camera that is shown. All pages then hear of it. */
export async function saveMask() {
  const { camera } = page().show;
  if (!unsaved(camera).length) return say(NOTHING);
  const explain = onFailure(complain("The mask is not saved:"));
  const answer = await post("/api/mask", { camera, cells: [...drawnMask(camera)] }).catch(explain);
  if (!answer) return;
  await loadMission().catch(explain);
  endDraft(camera);
  say(`Saved: ${patches(maskedCells(camera).size)} masked in all ${camera} frames.`);
  if (view.page) page().mask.show();
}

/** Let the server look through the dive, and draw what it finds.
 * @param {() => void} changed @param {HTMLElement} find The button.
 */
async function findMarks(changed, find) {
  const { camera } = page().show;
  const explain = onFailure(complain("Nothing was looked for:"));
  showLooking(find, true);
  const begun = await post("/api/fixed_marks", { camera }).catch(explain);
  const found = begun && (await marksOf(camera, explain));
  showLooking(find, false);
  if (!found) return;
  const fresh = found.filter((cell) => !drawnMask(camera).has(cell));
  drawMask(camera, fresh, true);
  if (view.page) changed();
  if (fresh.length) {
    const show = fresh.length === 1 ? "1 patch shows" : `${fresh.length} patches show`;
    say(`${show} text or edges that never move: save to mask them.`, { stays: true });
  } else if (found.length) say("What never moves is masked already.");
  else say("Nothing was found that never moves.");
}

function showLooking(/** @type {HTMLElement} */ find, /** @type {boolean} */ on) {
  setText(find, on ? "Looking…" : FIND);
  setAttribute(find, "aria-disabled", on ? "true" : null);
}

/** @param {string} camera @param {(error: unknown) => void} explain */
async function marksOf(camera, explain) {
  for (;;) {
    await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
    const answer = await get("/api/fixed_marks", { camera }).catch(explain);
    if (!answer || answer.cells) return answer?.cells;
  }
}
