// What happens elsewhere: the server's events, heard again by itself after a break.

import { address, onFailure } from "../core/api.js";
import { labelsAreStale } from "./labels.js";
import {
  beginAnew, loadMission, mission, onReload, strangerWords, takeNews,
} from "../core/mission.js";
import { allOwn, noteStranger, setConnected, takeEventHeads, whenIdle } from "./saver.js";
/** @import { ChangeEvent, LiveState, MissionAnswer, StatusEvent } from "../types.js" */

const RETRY_MS = [200, 400, 800, 1500];
// A browser opens six connections to a server: hidden tabs give theirs back.
const HIDDEN_MS = 5000;
const ANSWER_MS = 300;

/** @type {LiveState} */
const live = { source: null, tries: 0, timer: 0, opened: false };

/** Begin to listen. The mission must be loaded. */
export function startListening() {
  open();
  onReload(() => close());
  document.addEventListener("visibilitychange", () => {
    clearTimeout(live.timer);
    if (document.hidden) live.timer = setTimeout(close, HIDDEN_MS);
    else if (!live.source) open();
  });
  window.addEventListener("online", () => live.source || open());
}

/** Listen anew, as the person who works here now. */
export function listenAnew() {
  close();
  open();
}

function close() {
  clearTimeout(live.timer);
  live.source?.close();
  live.source = null;
}

function open() {
  close();
  const source = new EventSource(address("/api/events", { since: mission.event }));
  source.addEventListener("open", heard);
  source.addEventListener("change", (event) => takeChange(JSON.parse(event.data)));
  source.addEventListener("status", (event) => takeStatus(JSON.parse(event.data)));
  source.addEventListener("error", broken);
  live.source = source;
}

function heard() {
  live.tries = 0;
  setConnected(true);
  // After a break the server may be another one: classes, model and faults may be new.
  const take = (/** @type {MissionAnswer} */ answer) => noteStranger(strangerWords(answer));
  // Where it is gone again already, the next event tells.
  if (live.opened) loadMission().then(take).catch(onFailure());
  live.opened = true;
}

function broken() {
  close();
  setConnected(false);
  live.timer = setTimeout(open, RETRY_MS[Math.min(live.tries, RETRY_MS.length - 1)]);
  live.tries += 1;
}

function takeStatus(/** @type {StatusEvent} */ news) {
  if (news.blind === mission.blind) return void takeNews(news);
  // This person began or ended to label blind, in another tab or on another computer.
  beginAnew(news.blind).catch(onFailure()).finally(listenAnew);
}

async function takeChange(/** @type {ChangeEvent} */ news) {
  // It may be about an action of ours whose answer comes in a moment.
  const from = live.source;
  await Promise.race([whenIdle(), new Promise((resolve) => setTimeout(resolve, ANSWER_MS))]);
  // Heard for a person who does not work here any more, or to be heard again after a break.
  if (live.source !== from) return;
  // Put together before our last action was answered: what undo acts on is older than we know.
  if (!(news.event < mission.event)) takeEventHeads(news);
  takeNews(news);
  if (!allOwn(news.since, news.event)) labelsAreStale(news.frames, news.event);
  labelsAreStale(news.noted);
}
