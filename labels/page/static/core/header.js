// The header: mission, who works here, and whether everything is saved.

import { onFailure } from "./api.js";
import { announce, button, el, say } from "./dom.js";
import { blind, mission, onChange, setPerson, who } from "./mission.js";
import { listenAnew } from "./live.js";
import { onState, pending, state, stateReason, tryNow } from "../saving/saver.js";

const WORDS = {
  saved: () => "All saved",
  saving: (n) => `Saving ${n}…`,
  offline: (n) => `Offline: ${n} waiting`,
  refused: (n) => `Not saved: ${n} waiting`,
};
// A number that changes with every stroke is not worth reading out; a lasting state is.
const READ_OUT_MS = 700;

let readTimer = 0;
let lastRead = "saved";

/** Fill the header and keep it up to date. */
export function startHeader() {
  byId("try-now").addEventListener("click", tryNow);
  byId("person").addEventListener("click", openPersonDialog);
  onState(showState);
  onChange(showMission);
  showMission();
  showState();
}

function byId(id) {
  return document.getElementById(id);
}

function showMission() {
  byId("mission-name").textContent = mission.mission;
  byId("mission-name").title = `${mission.grid.rows}×${mission.grid.cols} patches a frame`;
  byId("person").textContent = who();
  byId("person").setAttribute("aria-label", `Annotator ${who()}: change`);
  byId("blind-badge").hidden = !blind();
  document.title = `${mission.mission} · tokt`;
}

function showState() {
  const now = state();
  const box = byId("save-state");
  const text = WORDS[now](pending());
  if (box.textContent !== text) box.textContent = text;
  box.dataset.state = now;
  box.title = stateReason() || "Every action is on the server's disk.";
  byId("try-now").hidden = now === "saved" || now === "saving";
  clearTimeout(readTimer);
  readTimer = setTimeout(readOut, READ_OUT_MS);
}

function readOut() {
  if (state() === lastRead) return;
  lastRead = state();
  announce(`${WORDS[lastRead](pending())}. ${stateReason()}`);
}

function openPersonDialog() {
  const dialog = byId("person-dialog");
  const name = el("input", {
    id: "person-name", value: who(), list: "person-names", maxlength: 60, required: true,
  });
  const hides = el("input", { id: "person-blind", type: "checkbox", checked: blind() });
  const choose = async (event) => {
    event.preventDefault();
    const chosen = name.value.trim();
    if (!chosen) return;
    dialog.close();
    await become(chosen, hides.checked);
  };
  dialog.replaceChildren(
    el("form", { on: { submit: choose } },
      el("h2", { text: "Who works here" }),
      el("label", { text: "Annotator ", for: "person-name" }),
      name,
      el("datalist", { id: "person-names" },
        ...mission.annotators.map((value) => el("option", { value })),
      ),
      el("label", { class: "check" }, hides, " Blind: hide what others and the model said"),
      el("div", { class: "row" },
        el("button", { class: "main", text: "Work as this", type: "submit" }),
        button("Cancel", () => dialog.close()),
      ),
    ),
  );
  dialog.showModal();
  name.select();
}

async function become(name, isBlind) {
  const change = async () => {
    if (isBlind !== blind() || name !== who()) await setPerson({ who: name, blind: isBlind });
    announce(`Working as ${who()}${blind() ? ", blind" : ""}`);
  };
  const explain = ({ message }) => say(`Not loaded anew: ${message}`, { bad: true });
  const showAnew = () => {
    showMission();
    listenAnew();
  };
  await change().catch(onFailure(explain)).finally(showAnew);
}
