// A class as people see it (colour, key and name together), and rows of buttons of classes.

import { inkOn } from "../frame/cell_drawing.js";
import { button, el } from "./dom.js";
import { classes, colourOf, signOf } from "./mission.js";

/** Patch of colour with the class's key in it, so that colour is never the only sign. */
export function swatch(name) {
  const attrs = { "aria-hidden": "true" };
  const mark = el("span", { class: "swatch", text: signOf(name), attrs });
  mark.style.backgroundColor = colourOf(name);
  mark.style.color = inkOn(colourOf(name));
  return mark;
}

/** Swatch and name. */
export function classTag(name) {
  return el("span", { class: "class-tag" }, swatch(name), el("span", { text: name }));
}

/**
 * A button for each class that can be given.
 * @param {(name: string) => void} choose
 */
export function classButtons(choose) {
  return given().map((one) =>
    fill(
      button("", () => choose(one.name), {
        class: "class-button",
        title: `${one.description || one.name} (key ${one.key})`,
      }),
      classTag(one.name),
    ),
  );
}

function fill(element, ...children) {
  element.append(...children);
  return element;
}

/** Classes of the taxonomy and `unsure`; names only found in the store have no key. */
function given() {
  return classes().filter((one) => one.key);
}
