// The bar and the tools of the overview: which frames are shown, and what one key does to all of
// them.

import { allow, pager, sizeButtons } from "../core/controls.js";
import { button, el } from "../core/dom.js";
import { reachable } from "../core/keys.js";
import { chosenClass, frames, mission, selectClass, setSetting, setting } from "../core/mission.js";
import { blindFrames } from "../labelling/blind_list.js";
import { buildDrawer } from "../labelling/drawer.js";
import { filterSelect } from "../labelling/filters.js";
import { buildToolbar } from "../labelling/toolbar.js";
import { suggesting } from "./thumb.js";
/** @import { BarCommands, Tally } from "../types.js" */

/** @type {Record<string, string>} */
const KEYS = { acceptNext: "Enter", acceptAll: "Shift+Enter", rest: "o" };

/** The bar, the toolbar and the drawer. */
export class OverviewBar {
  constructor(/** @type {BarCommands} */ does) {
    this.range = el("span", { class: "overview-range" });
    this.words = el("span", { class: "overview-words", role: "status" });
    const words = "which frames are shown";
    this.filter = filterSelect(words, `${words} (/)`);
    const commands = {
      acceptNext: () => does.accept(false),
      acceptAll: () => does.accept(true),
      rest: does.rest,
    };
    this.tools = buildToolbar(commands, selectClass, (name) => reachable(KEYS[name]), [], [
      ["acceptNext", "Accept and next", ""],
      ["rest", "", ""],
      ["acceptAll", "Accept all", ""],
    ]);
    this.drawer = buildDrawer();
    const single = Object.keys(mission.cameras).length < 2;
    const other = () => button("other camera", does.otherCamera, { title: "the other camera (s)" });
    this.element = el("div", { class: "bar" },
      single ? null : other(),
      this.filter,
      pager(does.turn, this.range),
      sizeButtons(does.resize),
      this.words,
    );
  }

  nextFilter() {
    const { filter } = this;
    filter.selectedIndex = (filter.selectedIndex + 1) % filter.options.length;
    setSetting("filter", filter.value);
  }

  /** Say what is shown (`range`: which frames) and what the buttons would do. */
  show(/** @type {string} */ range, /** @type {Tally} */ { strong, weak, open, waiting }) {
    this.range.textContent = range;
    const all = strong + weak;
    const shown = "of the frames shown";
    /** @type {Record<string, [count: number, what: string]>} */
    const does = {
      acceptNext: [strong, `Accept ${strong} sure suggestions ${shown}, and go on`],
      acceptAll: [all, `Accept all ${all} suggestions ${shown}, and go on`],
      rest: [open, `Label ${open} patches ${shown} that have no label, but for obstacles`],
    };
    const none = "No patch of the frames shown is left for it.";
    for (const made of this.tools.root.getElementsByTagName("button")) {
      const [count, what] = does[made.dataset.command ?? ""] ?? [];
      if (what) allow(made, count || waiting ? "" : none, what);
    }
    this.tools.show(chosenClass());
    const said = `${strong} of ${all} suggestions sure, ${open} patches open.`;
    this.drawer.show(said);
    this.words.textContent = advice(waiting, said);
  }
}

/** Which frames are shown, and how many of the camera's. @param {string} camera @param {number[]} shown */
export function rangeWords(camera, shown) {
  return `${camera} frames ${shown[0]} to ${shown.at(-1)}: ${shown.length} of ${frames(camera).length}`;
}

function advice(/** @type {number} */ waiting, /** @type {string} */ said) {
  if (mission.blind) {
    const listed = blindFrames().length > 0;
    const only = listed ? ` Only the frames that ${setting("blindOf")} labelled.` : "";
    return `Blind: no suggestions, and nothing of what others said.${only}`;
  }
  if (!mission.model) return "No model yet: paint; Settings say more.";
  if (!suggesting()) return "Suggestions are switched off.";
  if (waiting > 0) return `Frames that are still being loaded: ${waiting}.`;
  return `${said} Dashed: sure; “?”: unsure.`;
}
