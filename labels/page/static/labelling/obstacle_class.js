// Which class a model's obstacles are: the question to a person, and the choice in the drawer.

import { onFailure, post } from "../core/api.js";
import { choice, classTag, complain } from "../core/controls.js";
import { backAfterMouse, button, dialogById, el } from "../core/dom.js";
import { mission } from "../core/mission.js";
import { asksObstacleClass, obstacleClass, obstacleClasses } from "./suggest.js";

/** For a model that only knows "obstacle": which class that is in these frames. */
export function obstacleChoice() {
  const select = choice(obstacleClasses(), obstacleClass());
  select.addEventListener("change", () => setObstacleClass(select.value));
  return backAfterMouse(select);
}

async function setObstacleClass(/** @type {string} */ value) {
  const explain = complain("Not kept:", { stays: true });
  // All pages hear of it as an event, this one too: events come in order, an answer may not.
  await post("/api/settings", { name: "obstacle_as", value }).catch(onFailure(explain));
}

/** Ask which of several learnt classes are obstacles, if nobody said so; whether it is asked. */
export function askObstacleClass() {
  const dialog = dialogById("question");
  if (!mission.model || !asksObstacleClass()) return false;
  if (dialog.open) return true;
  const { learnt, label } = mission.model;
  const choose = (/** @type {string} */ name) => {
    dialog.close();
    setObstacleClass(name);
  };
  const answers = obstacleClasses().map((name) => {
    const text = learnt[name] ? `${learnt[name].toLocaleString("en")} patches learnt` : "not learnt";
    return button("", () => choose(name), {}, classTag(name), el("span", { class: "count", text }));
  });
  dialog.replaceChildren(
    el("h2", { text: "What are the obstacles of this dive?" }),
    el("p", { text: `${label} tells obstacles from open water, not which ones they are.` }),
    el("div", { class: "answers" }, ...answers),
  );
  dialog.showModal();
  return true;
}
