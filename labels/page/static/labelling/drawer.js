// The drawer of settings beside the views in which patches are labelled.

import { nothingYet } from "../core/controls.js";
import { backAfterMouse, el, setText } from "../core/dom.js";
import { mission, setSetting, setting } from "../core/mission.js";
import { obstacleChoice } from "./obstacle_class.js";
import { needsObstacleClass, obstacleClass, percentRight } from "./suggest.js";

/**
 * Build the drawer of settings, with `more` of the view: {root, show(said)}; `said`: of the
 * suggestions that are shown.
 */
export function buildDrawer(...more) {
  const model = el("div", { class: "model" });
  const root = el("aside", { class: "drawer", "aria-label": "Settings" },
    slider("enhance", "Contrast", 0, 100, 5),
    slider("tint", "Tint of labels", 0, 60, 5),
    ...more,
    model,
  );
  const show = (said) => {
    root.hidden = !setting("drawer");
    for (const input of root.querySelectorAll("[data-setting]")) showSlider(input);
    showModel(model, said);
  };
  return { root, show };
}

/** A slider of a setting, with its value. */
function slider(name, label, min, max, step) {
  const output = el("output");
  const input = el("input", {
    type: "range", min, max, step, value: setting(name), "data-setting": name,
    on: { input: () => setSetting(name, Number(input.value)) },
  });
  const made = el("label", { class: "slider" }, el("span", { text: label }), input, output);
  showSlider(backAfterMouse(input));
  return made;
}

function showSlider(input) {
  const name = input.dataset.setting;
  const value = String(setting(name));
  if (input.value !== value) input.value = value;
  const percent = name === "confidence" && mission.model ? surePercent() : null;
  setText(input.nextElementSibling, percent === null ? value : `${percent} %`);
  if (percent !== null) input.parentElement.title = `decision value ${value}`;
}

// The least of both sides: what is as sure as that was right so often in training.
function surePercent() {
  const sides = [false, true].map((side) => percentRight(side, setting("confidence")));
  return sides.includes(null) ? null : Math.min(...sides);
}

const NO_MODEL =
  "No model yet. It would suggest a class for each patch, and you would only mend what is wrong. " +
  "It learns from some twenty labelled frames, with water and obstacles.";

function showModel(root, said) {
  const { model } = mission;
  if (mission.blind || !model) {
    if (mission.blind) setText(root, "Blind: suggestions are hidden.");
    else if (!root.querySelector("a")) {
      root.replaceChildren(nothingYet(NO_MODEL, "Train a model", "#/files"));
    }
    return;
  }
  if (!root.querySelector("select")) root.replaceChildren(...modelParts());
  const progress = model.done < model.total ? ` · ${model.done}/${model.total} frames` : "";
  setText(root.querySelector(".model-name"), `${model.label}${progress}`);
  setText(root.querySelector(".model-said"), said);
  root.querySelector("input").checked = setting("suggestions");
  const select = root.querySelector("select");
  select.parentElement.hidden = !needsObstacleClass();
  if (select.value !== obstacleClass()) select.value = obstacleClass();
}

function modelParts() {
  const shown = el("input", {
    type: "checkbox", on: { change: () => setSetting("suggestions", shown.checked) },
  });
  return [
    el("label", { class: "check" },
      backAfterMouse(shown), " Suggestions of ", el("b", { class: "model-name" }),
    ),
    slider("confidence", "Sure from", 0, 3, 0.05),
    slider("follow", "Keep from before", 0, 5, 0.25),
    el("label", { class: "pick" }, el("span", { text: "Obstacle is" }), obstacleChoice()),
    el("p", { class: "model-said" }),
  ];
}
