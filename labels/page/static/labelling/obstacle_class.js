// Which classes a model's obstacles are: the question to a person, and the button in the drawer.

import { onFailure, post } from "../core/api.js";
import { classTag, complain } from "../core/controls.js";
import { backAfterMouse, button, dialogById, el, say } from "../core/dom.js";
import { mission } from "../core/mission.js";
import { asksObstacleClass, chosenObstacles, obstacleClass, obstacleClasses } from "./suggest.js";

let isPutOff = false; // until somebody answers, or the page is loaded again

/** For a model that only knows "obstacle": which classes that is in these frames. */
export function obstacleButton() {
  return backAfterMouse(button("", () => ask(), { class: "obstacles", "aria-haspopup": "dialog" }));
}

/** What is written on it. */
export function obstacleWords() {
  return chosenObstacles().join(", ") || obstacleClass();
}

/** Why the obstacles of the model were not accepted; "" where they may be. */
export function putOffWords() {
  const left = isPutOff && asksObstacleClass();
  return left ? "You put off which obstacles these are: the settings say it (Obstacle is)." : "";
}

/** Ask which of several classes are obstacles, if nobody said so; whether it is asked now. */
export function askObstacleClass() {
  if (!asksObstacleClass() || isPutOff) return false;
  if (!dialogById("question").open) ask("Nothing is accepted yet: press Enter again.");
  return true;
}

function ask(then = "") {
  const dialog = dialogById("question");
  const learnt = mission.model?.learnt ?? {};
  const before = chosenObstacles();
  const boxes = obstacleClasses().map((value) =>
    el("input", { type: "checkbox", value, checked: before.includes(value), on: { change: check } }),
  );
  const chosen = () => boxes.filter(({ checked }) => checked).map(({ value }) => value);
  const close = (/** @type {boolean} */ putsOff) => {
    isPutOff = putsOff;
    dialog.close();
  };
  const done = button("These", () => {
    setObstacleClasses(chosen());
    close(false);
    if (then) say(then);
  }, { class: "main" });
  function check() {
    done.disabled = !chosen().length;
  }
  check();
  const answers = boxes.map((box) => {
    const count = learnt[box.value]?.toLocaleString("en");
    const text = count ? `${count} patches learnt` : "not learnt";
    return el("label", {}, box, classTag(box.value), el("span", { class: "count", text }));
  });
  dialog.replaceChildren(
    el("h2", { text: "What are the obstacles of this dive?" }),
    el("p", { text: `${mission.model?.label} tells obstacles from open water, not which ones they are.` }),
    el("div", { class: "answers" }, ...answers),
    el("p", {
      text: "Of several, an accepted patch takes the class that it has in the frame before, else the " +
        "one that you paint with, else the first. The settings let you choose again.",
    }),
    done,
    " ",
    button("Later", () => close(true), { title: "Accept only what is suggested as clear for now" }),
  );
  dialog.showModal();
}

async function setObstacleClasses(/** @type {string[]} */ names) {
  const explain = complain("Not kept:", { stays: true });
  // All pages hear of it as an event, this one too: events come in order, an answer may not.
  const setting = { name: "obstacle_as", value: names.join(",") };
  await post("/api/settings", setting).catch(onFailure(explain));
}
