// Starts the page: the mission first, then the views, the keys and what keeps everything saved.

import "../frame/frame_view.js";
import { whereStopped } from "../labelling/steps.js";
import { ApiError } from "../core/api.js";
import { byId, el } from "../core/dom.js";
import { askPerson, startHeader } from "./header.js";
import { addGlobalKeys, listen, toggleHelp } from "../core/keys.js";
import { startListening } from "../saving/live.js";
import { loadMission } from "../core/mission.js";
import { startNotices } from "../saving/notices.js";
import { addLaterView, loadLaterViews, startRouting } from "../core/router.js";
import { startSaving } from "../saving/saver.js";
import { stepBack, stepForward } from "../labelling/toolbar.js";

const RETRY_MS = 1000;
const LOAD_LATER_MS = 3000;

async function start() {
  try {
    await loadMission();
    await askPerson();
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    const text = `The mission cannot be shown: ${error.message}. Trying again…`;
    byId("view").replaceChildren(el("p", { class: "loading", text }));
    setTimeout(start, RETRY_MS);
    return;
  }
  startSaving();
  startHeader();
  startNotices();
  startListening();
  addGlobalKeys([
    { keys: ["Ctrl+Z", "z"], does: "undo, and go to the frame it changed", run: stepBack },
    { keys: ["Ctrl+Shift+Z", "Ctrl+Y", "Z"], does: "redo", run: stepForward },
  ]);
  byId("help-button").addEventListener("click", toggleHelp);
  listen();
  // Only what most visits begin with is loaded at once.
  /** @param {string} view @returns {(again: string) => Promise<unknown>} */
  const later = (view) => (again) => import(`../${view}_view.js${again}`);
  addLaterView("overview", "Overview", later("overview/overview"));
  addLaterView("sheet", "Review sheet", later("sheets/sheet"));
  addLaterView("audit", "", later("sheets/audit"));
  addLaterView("agreement", "Agreement", later("sheets/agreement"));
  addLaterView("files", "Files and models", later("files/files"));
  startRouting(`#/label/${whereStopped().join("/")}`);
  setTimeout(loadLaterViews, LOAD_LATER_MS);
}

start();
