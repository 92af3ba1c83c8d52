// Labelling a second time without seeing the first: beginning, going on, and comparing.

import { onFailure } from "../core/api.js";
import { choice, complain } from "../core/controls.js";
import { button, el, say } from "../core/dom.js";
import { listenAnew } from "../saving/live.js";
import { mission, setPerson, setSetting, setting, stateOf, who } from "../core/mission.js";
import { go } from "../core/router.js";
import { blindFrames, loadBlindList, nextBlindFrame } from "../labelling/blind_list.js";
/** @import { Place } from "../types.js" */

/** @type {Record<string, {sign: string, text: string}>} */
const SIGNS = {
  u: { sign: "○", text: "unseen" },
  s: { sign: "◔", text: "seen" },
  p: { sign: "◑", text: "part labelled" },
  d: { sign: "●", text: "done" },
};

const WHY_BLIND =
  "A second person labels the same frames without seeing the first one's labels or any " +
  "suggestion. Only then does agreement say something about the labels.";

/** The form that begins a blind labelling; `of`: whose frames are proposed. */
export function blindForm(/** @type {{of: string, onCancel?: () => void}} */ { of, onCancel }) {
  const whose = choice(mission.annotators, of, { id: "blind-of" });
  const name = el("input", { id: "blind-who", required: true, maxlength: 60, autocomplete: "off" });
  if (who() !== of) name.value = who();
  const begin = (/** @type {Event} */ event) => {
    event.preventDefault();
    beginBlind(whose.value, name.value.trim());
  };
  return el("form", { class: "blind-form", on: { submit: begin } },
    el("h2", { text: "Label a second time, blind" }),
    el("p", { text: WHY_BLIND }),
    el("label", { text: "Frames that were labelled by", for: "blind-of" }),
    whose,
    el("label", { text: "Your name (another one)", for: "blind-who" }),
    name,
    el("div", { class: "bar" },
      el("button", { class: "main", text: "Begin, or go on", type: "submit" }),
      onCancel ? button("Cancel", onCancel) : null,
    ),
  );
}

/** Work blind from now on, as `name`, on the frames of `of`. */
async function beginBlind(/** @type {string} */ of, /** @type {string} */ name) {
  if (!name) return;
  if (name === of) {
    const words = "labelled these frames first; the second labelling needs another person's name.";
    return say(`${of} ${words}`, { bad: true });
  }
  setSetting("blindOf", of);
  await changePerson(async () => {
    await setPerson({ who: name, blind: true });
    await loadBlindList();
    continueBlind();
  });
}

/** Open the next frame of the list that is not done. */
export function continueBlind() {
  const next = nextBlindFrame();
  if (next) go(`#/label/${next.camera}/${next.frame}`);
  else say("All frames of the list are done.");
}

/** Show everything again and compare. */
async function endBlind() {
  const pair = [setting("blindOf"), who()].map(encodeURIComponent);
  await changePerson(async () => {
    await setPerson({ blind: false });
    go(`#/agreement/${pair.join("/")}`);
  });
}

async function changePerson(/** @type {() => Promise<void>} */ change) {
  const explain = complain("That did not work:");
  await change().catch(onFailure(explain)).finally(listenAnew);
}

/** How far a blind labelling is; `fault`: why there is no list, "" where there is. */
export function blindProgress(/** @type {string} */ fault) {
  const list = blindFrames();
  const done = list.filter(({ camera, frame }) => stateOf(camera, frame) === "d").length;
  const of = setting("blindOf");
  const words = list.length
    ? `${who()} labels the frames that ${of} labelled: ${done} of ${list.length} are done.`
    : fault || "No list of frames was chosen: label any frame.";
  const more = list.length > done;
  const end = of && of !== who() ? "End blind labelling and compare" : "End blind labelling";
  return el("section", { class: "blind-progress" },
    el("h2", { text: "Blind labelling" }),
    el("p", { text: words, role: "status" }),
    el("p", { text: "What others said and what the model suggests is hidden until you end this." }),
    el("div", { class: "bar" },
      more ? button("Continue", continueBlind, { class: "main", title: "Enter" }) : null,
      button(end, endBlind),
    ),
    el("div", { class: "blind-frames" }, ...list.map(frameLink)),
  );
}

function frameLink(/** @type {Place} */ { camera, frame }) {
  const { sign, text } = SIGNS[stateOf(camera, frame)] ?? SIGNS.u;
  const href = `#/label/${camera}/${frame}`;
  const name = `${camera} ${frame}`;
  return el("a", { text: `${sign} ${name}`, href, title: text, "aria-label": `${name}, ${text}` });
}
