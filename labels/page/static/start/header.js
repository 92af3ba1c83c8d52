// The header: mission, who works here, and whether everything is saved.

import { onFailure } from "../core/api.js";
import { complain } from "../core/controls.js";
import { announce, button, byId, dialogById, el, setText } from "../core/dom.js";
import { mission, onChange, setPerson, who } from "../core/mission.js";
import { showProgress } from "../core/progress.js";
import { lastPerson } from "../core/settings.js";
import { listenAnew } from "../saving/live.js";
import { onState, pending, state, stateReason, tryNow } from "../saving/saver.js";
/** @import { Person, SaveState } from "../types.js" */

/** @type {Record<SaveState, (count: number) => string>} */
const WORDS = {
  saved: () => "All saved",
  saving: (n) => `Saving ${n}…`,
  offline: (n) => `Offline: ${n} waiting`,
  refused: (n) => `Not saved: ${n} waiting`,
};
// A number that changes with every stroke is not worth reading out; a lasting state is.
const READ_OUT_MS = 700;

/** What was read out last, and when it is looked at again. */
const read = { state: /** @type {SaveState} */ ("saved"), timer: 0 };

export function startHeader() {
  byId("try-now").addEventListener("click", tryNow);
  byId("person").addEventListener("click", () => personDialog(become));
  onState(showState);
  onChange(showMission);
  showMission();
  showState();
}

function showMission() {
  byId("mission-name").textContent = mission.mission;
  byId("mission-name").title = `${mission.grid.rows}×${mission.grid.cols} patches a frame`;
  showProgress();
  byId("person").textContent = `Labelling as ${who()}`;
  byId("person").title = "somebody else works here, or blind";
  byId("blind-badge").hidden = !mission.blind;
  document.title = `${mission.mission} · tokt`;
}

function showState() {
  const now = state();
  const box = byId("save-state");
  setText(box, WORDS[now](pending()));
  box.dataset.state = now;
  box.title = stateReason() || "Every action is on the server's disk.";
  byId("try-now").hidden = now === "saved" || now === "saving";
  clearTimeout(read.timer);
  read.timer = setTimeout(readOut, READ_OUT_MS);
}

function readOut() {
  if (state() === read.state) return;
  read.state = state();
  announce(`${WORDS[read.state](pending())}. ${stateReason()}`);
}

/** Ask who works here until somebody said so. */
export async function askPerson() {
  while (!who()) await personDialog(setPerson);
}

/** Let a person say who works here, and wait for `take`; without an answer nothing changes. */
function personDialog(/** @type {(person: Person) => Promise<void>} */ take) {
  const dialog = dialogById("person-dialog");
  const last = lastPerson();
  const hid = who() ? mission.blind : Boolean(last.blind);
  const name = el("input", {
    id: "person-name", value: last.who ?? mission.annotator, maxlength: 60, required: true,
  });
  const hides = el("input", { id: "person-blind", type: "checkbox", checked: hid });
  /** @type {?Person} */
  let chosen = null;
  const choose = (/** @type {Event} */ event) => {
    event.preventDefault();
    // Somebody else who is blind stays so, unless that was meant.
    const isBlind = hides.checked || hid ? hides.checked : undefined;
    if (name.value.trim()) chosen = { who: name.value, blind: isBlind };
    if (chosen) dialog.close();
  };
  const known = mission.annotators.map((one) => button(one, () => (name.value = one)));
  dialog.replaceChildren(
    el("form", { on: { submit: choose } },
      el("h2", { text: who() ? "Who works here" : "Who are you?" }),
      el("p", { text: "Labels are kept under this name." }),
      el("label", { text: "Name ", for: "person-name" }),
      name,
      el("div", { class: "row", role: "group", "aria-label": "known names" }, ...known),
      el("label", { class: "check" }, hides, " Blind: hide what others and the model said"),
      el("div", { class: "row" },
        el("button", { class: "main", text: "Label as this", type: "submit" }),
        who() ? button("Cancel", () => dialog.close()) : null,
      ),
    ),
  );
  dialog.showModal();
  name.select();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => resolve(chosen && take(chosen)), { once: true });
  });
}

async function become(/** @type {Person} */ change) {
  const explain = complain("Not done, or not loaded anew:", { stays: true });
  const showAnew = () => {
    showMission();
    listenAnew();
  };
  await setPerson(change).catch(onFailure(explain)).finally(showAnew);
  announce(`Labelling as ${who()}${mission.blind ? ", blind" : ""}`);
}
