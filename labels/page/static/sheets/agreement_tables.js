// The numbers of an agreement between two annotators, as labels/agreement.py computes them.

import { classTag, swatch } from "../core/controls.js";
import { button, el } from "../core/dom.js";
/** @import { Agreement, ChoosePair, Pair } from "../types.js" */

const NONE = "–";

/** A share as people read it: "96.2 %". */
function percent(/** @type {?number} */ share) {
  return share === null ? NONE : `${(100 * share).toFixed(1)} %`;
}

function count(/** @type {number} */ value) {
  return value.toLocaleString("en");
}

/** Kappa with three digits; a dash where it is not defined. */
function kappaText(/** @type {?number} */ kappa) {
  return kappa === null ? NONE : kappa.toFixed(3);
}

export function figures(/** @type {Agreement} */ found) {
  const { a, b, blind } = found;
  const unsure = [percent(found.agreement_with_unsure), kappaText(found.kappa_with_unsure)];
  const rows = [
    ["Patches labelled", `${a}: ${count(found.n_a)} · ${b}: ${count(found.n_b)}`],
    ["Of these blind", `${a}: ${count(blind.a)} · ${b}: ${count(blind.b)}`],
    ["Labelled by both", count(found.n_both)],
    ["Same class", `${percent(found.agreement)} of ${count(found.n_both_sure)} both are sure of`],
    ["With unsure as a class", unsure.join(", κ ")],
    ["Obstacle or not, F1", obstacleText(found)],
  ];
  return el("div", { class: "figures" },
    el("p", { class: "kappa" },
      el("span", { text: "Cohen's κ " }),
      el("strong", { text: kappaText(found.kappa) }),
      el("small", { text: kappaMeaning(found) }),
    ),
    el("dl", {}, ...rows.flatMap(([name, text]) => [el("dt", { text: name }), el("dd", { text })])),
  );
}

/** Which class is an obstacle is only known of classes in the taxonomy. */
function obstacleText(/** @type {Agreement} */ { obstacle, unknown }) {
  if (obstacle) return percent(obstacle.f1);
  return `${NONE} (not in the taxonomy: ${unknown.join(", ")})`;
}

function kappaMeaning(/** @type {Agreement} */ { kappa, n_both_sure: sure }) {
  if (sure === 0) return " there is no patch that both are sure of";
  if (kappa === null) return " not defined: all patches are of one class";
  return " 1: always the same; 0: no better than by chance";
}

export function classTable(/** @type {Agreement} */ found) {
  const heads = ["class", found.a, found.b, "both", "F1"];
  return el("table", { class: "numbers" },
    el("caption", { text: "Patches by class" }),
    el("thead", {}, el("tr", {}, ...heads.map(columnHead))),
    el("tbody", {},
      ...Object.entries(found.per_class).map(([name, one]) =>
        el("tr", {},
          el("th", { scope: "row" }, classTag(name)),
          ...[count(one.n_a), count(one.n_b), count(one.n_both), percent(one.f1)].map((text) =>
            el("td", { text }),
          ),
        ),
      ),
    ),
  );
}

function columnHead(/** @type {string} */ text) {
  return el("th", { text, scope: "col" });
}

/** Who said what where: each pair of labels and how often; one that differs is a button that gives
 * it to `choose`, pressed if it is the `chosen` one, whose conflicts are shown.
 * @param {Agreement} found @param {?Pair} chosen @param {ChoosePair} choose
 */
export function confusionTable(found, chosen, choose) {
  const { labels, confusion } = found;
  const head = (/** @type {string} */ name) => {
    const unseen = el("span", { class: "unseen", text: name });
    return el("th", { scope: "col", title: name }, swatch(name), unseen);
  };
  const row = (/** @type {string} */ a, /** @type {number} */ i) =>
    el("tr", {},
      el("th", { scope: "row" }, classTag(a)),
      ...labels.map((b, j) => confusionCell({ a, b }, confusion[i][j], found, chosen, choose)),
    );
  return el("table", { class: "numbers confusion" },
    el("caption", { text: `${found.a} (rows) against ${found.b} (columns)` }),
    el("thead", {}, el("tr", {}, el("td"), ...labels.map(head))),
    el("tbody", {}, ...labels.map(row)),
  );
}

/** @param {Pair} pair @param {number} number @param {Agreement} found
 * @param {?Pair} chosen @param {ChoosePair} choose
 */
function confusionCell({ a, b }, number, found, chosen, choose) {
  if (a === b) return el("td", { class: "same", text: count(number) });
  if (number === 0) return el("td", { class: "nil", text: "0" });
  const pressed = chosen?.a === a && chosen?.b === b;
  const title = `${found.a}: ${a}, ${found.b}: ${b}`;
  return el("td", {},
    button(count(number), () => choose({ a, b }), {
      class: "pair", title: `show the patches that are ${title}`,
      "aria-pressed": String(pressed), "aria-label": `${number} patches ${title}`,
    }),
  );
}
