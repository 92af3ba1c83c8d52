// The drawer of settings beside the views in which patches are labelled.

import { nothingYet } from "../core/controls.js";
import { backAfterMouse, el, part, setAttribute, setText } from "../core/dom.js";
import { mission, setSetting, setting } from "../core/mission.js";
import { obstacleButton, obstacleWords } from "./obstacle_class.js";
import { needsObstacleClass, percentRight } from "./suggest.js";
/** @import { Child, NumberSetting } from "../types.js" */

export function buildDrawer(/** @type {Child[]} */ ...more) {
  const model = el("div", { class: "model" });
  const root = el("aside", { class: "drawer", "aria-label": "Settings" },
    slider("enhance", "Contrast", 0, 100, 5),
    slider("tint", "Tint of labels", 0, 60, 5),
    ...more,
    model,
  );
  /** @param {string} said Of the suggestions that are shown. */
  const show = (said) => {
    root.hidden = !setting("drawer");
    for (const slider of root.querySelectorAll(".slider")) showSlider(slider);
    showModel(model, said);
  };
  return { root, show };
}

/** @type {(name: NumberSetting, label: string, min: number, max: number, step: number, title?: string)
 * => Node} */
function slider(name, label, min, max, step, title = "") {
  const input = el("input", {
    type: "range", min, max, step, value: setting(name), "data-setting": name,
  });
  input.addEventListener("input", () => setSetting(name, Number(input.value)));
  const made = el("label", { class: "slider", title },
    el("span", { text: label }), backAfterMouse(input), el("output"),
  );
  showSlider(made);
  return made;
}

function showSlider(/** @type {Element} */ slider) {
  const input = part(slider, "input");
  const name = /** @type {NumberSetting} */ (input.dataset.setting);
  const value = String(setting(name));
  if (input.value !== value) input.value = value;
  const percent = name === "confidence" && mission.model ? surePercent() : null;
  setText(part(slider, "output"), percent === null ? value : `${percent} %`);
  if (percent !== null) setAttribute(slider, "title", `decision value ${value}`);
}

// The least of both sides: what is as sure as that was right so often in training.
function surePercent() {
  const [clear, obstacle] = [false, true].map((side) => percentRight(side, setting("confidence")));
  return clear === null || obstacle === null ? null : Math.min(clear, obstacle);
}

const NO_MODEL =
  "No model yet. It would suggest a class for each patch, and you would only mend what is wrong. " +
  "It learns from six labelled frames or more: water in three of them, obstacles in three. " +
  "Or start tokt label with --model waters, which comes with tokt.";

function showModel(/** @type {HTMLElement} */ root, /** @type {string} */ said) {
  const { model } = mission;
  if (mission.blind || !model) {
    if (mission.blind) setText(root, "Blind: suggestions are hidden.");
    else if (!root.querySelector("a")) {
      root.replaceChildren(nothingYet(NO_MODEL, "Train a model", "#/files"));
    }
    return;
  }
  if (!root.querySelector("button")) root.replaceChildren(...modelParts());
  const progress = model.done < model.total ? ` · ${model.done}/${model.total} frames` : "";
  setText(part(root, "b"), `${model.label}${progress}`);
  setText(part(root, "p"), said);
  part(root, "input").checked = setting("suggestions");
  const obstacles = part(root, "button");
  setAttribute(obstacles.closest(".pick"), "hidden", !needsObstacleClass());
  setText(obstacles, obstacleWords());
}

function modelParts() {
  const shown = el("input", { type: "checkbox" });
  shown.addEventListener("change", () => setSetting("suggestions", shown.checked));
  return [
    el("label", { class: "check" },
      backAfterMouse(shown), " Suggestions of ", el("b", { class: "model-name" }),
    ),
    slider("confidence", "Sure from", 0, 3, 0.05),
    slider("follow", "Keep from before", 0, 5, 0.25, "What you said in the frame before is kept " +
      "until the model contradicts it by this decision value; 0 keeps nothing"),
    el("div", { class: "pick" }, el("span", { text: "Obstacle is" }), obstacleButton()),
    el("p", { class: "model-said" }),
  ];
}
