// The bar under the picture: which frame this is, where to go, filter, and the strip's legend.

import { backAfterMouse, button, el, focusView } from "../core/dom.js";
import { frameIndex, frames, mission, setSetting } from "../core/mission.js";
import { countPassing, filterChoices, filterName } from "./steps.js";
import { STATES } from "./timeline.js";

/**
 * Build the bar.
 * @param {Object<string, Function>} commands
 * @param {(command: string) => string} keyFor
 * @returns {{root: HTMLElement, show: (camera: string, frame: number) => void}}
 */
export function buildBar(commands, keyFor) {
  const withKey = (text, name, title) => {
    const made = button(text, commands[name], { title });
    made.append(" ", el("kbd", { text: keyFor(name) }));
    return made;
  };
  const number = el("input", {
    attrs: { type: "number", "aria-label": "Frame number", class: "frame-number" },
    on: {
      change: () => number.value && commands.goTo(Number(number.value)),
      // Leaving it is what changes it.
      keydown: ({ key }) => key === "Enter" && focusView(),
    },
  });
  const place = el("span", { class: "place" });
  const camera = withKey("", "camera", "Left or right camera");
  camera.prepend(el("span", { class: "camera-name" }));
  const filter = buildFilter();
  const matches = el("span", { class: "matches" });
  const legend = el("div", { class: "legend", attrs: { "aria-label": "States of frames" } });
  const root = el(
    "div",
    { class: "frame-bar" },
    withKey("◀", "previous", "Frame before"),
    number,
    withKey("▶", "next", "Next frame"),
    place,
    camera,
    withKey("Next unlabelled", "unlabelled"),
    withKey("Next uncertain", "uncertain", "Where the model is least sure and has seen least"),
    el("label", { class: "pick" }, el("span", { text: "Filter" }), filter),
    matches,
    el("span", { class: "spring" }),
    legend,
  );
  const show = (where, frame) => {
    const list = frames(where);
    if (document.activeElement !== number) number.value = frame;
    place.textContent = `${frameIndex(where, frame) + 1} of ${list.length}`;
    camera.hidden = Object.keys(mission.cameras).length < 2;
    root.querySelector(".camera-name").textContent = where;
    showFilters(filter);
    matches.textContent = filterName() === "all" ? "" : `${countPassing(where)} frames match`;
    showLegend(legend, where);
  };
  return { root, show };
}

function buildFilter() {
  const change = () => setSetting("filter", filter.value);
  const filter = el("select", { class: "filter", on: { change } });
  return backAfterMouse(filter);
}

// Classes come when somebody uses them first, and go with who works here.
function showFilters(filter) {
  const choices = filterChoices();
  const text = JSON.stringify(choices);
  if (filter.dataset.shown !== text) {
    filter.dataset.shown = text;
    filter.replaceChildren(
      ...choices.map(([value, words]) => el("option", { text: words, attrs: { value } })),
    );
  }
  filter.value = filterName();
}

function showLegend(root, camera) {
  const counts = {};
  for (const state of mission.states[camera]) counts[state] = (counts[state] ?? 0) + 1;
  const text = JSON.stringify([counts, camera]);
  if (root.dataset.shown === text) return;
  root.dataset.shown = text;
  root.replaceChildren(
    ...Object.entries(STATES).map(([state, { words }]) =>
      el(
        "span",
        { class: "legend-item" },
        el("i", { class: `legend-mark state-${state}`, attrs: { "aria-hidden": "true" } }),
        `${words} ${counts[state] ?? 0}`,
      ),
    ),
  );
}
