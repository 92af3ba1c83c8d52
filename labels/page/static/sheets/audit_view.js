// Label audit: patches whose label a model that did not learn it contradicts, the worst first.
// Each is confirmed or relabelled by a person; nothing changes by itself.

import { get } from "../core/api.js";
import { AuditSheet } from "./audit_sheet.js";
import { el, soon } from "../core/dom.js";
import { lookAtShapes } from "../core/frame_shape.js";
import { onLabels } from "../saving/labels.js";
import { lookKeys } from "../core/keys.js";
import { blind, mission, onChange, onReload, onSetting } from "../core/mission.js";
import { addView, go } from "../core/router.js";
import { selectionKeys } from "./tile_grid.js";

const LEARN_MS = 1000;
const NONE =
  "There is no audit of this mission. “tokt labels audit DATASET” makes one; then press r.";

let parts = null; // the elements on show; null while another view is
let sheet = null; // an AuditSheet; null while there is nothing to show
let name = "";
let event = 0; // up to which the decisions are known
let asked = 0;
let timer = 0;
const places = new Map(); // audit -> where the person was, to come back to

async function show(root, [wanted]) {
  leave();
  parts = build();
  root.replaceChildren(parts.root);
  parts.root.focus();
  const here = parts;
  await lookAtShapes();
  if (here === parts) await load(wanted);
}

function leave() {
  if (sheet) places.set(name, sheet.place());
  asked += 1;
  clearTimeout(timer);
  sheet?.close();
  sheet = null;
  parts = null;
}

function build() {
  const tabs = el("nav", { class: "sheet-tabs", attrs: { "aria-label": "audits" } });
  const words = el("p", { class: "sheet-words", attrs: { role: "status" } });
  const body = el("div", { class: "audit-body" });
  const root = el(
    "section",
    { class: "sheet tiles-view", attrs: { "aria-label": "label audit", tabindex: -1 } },
    tabs,
    el("div", { class: "bar" }, words),
    body,
  );
  return { root, tabs, words, body };
}

async function load(wanted) {
  const mine = (asked += 1);
  if (blind()) return void (parts.words.textContent = "Not while labelling blind.");
  parts.words.textContent = "Loading ...";
  try {
    const { audits } = await get("/api/audits");
    if (mine !== asked) return;
    const chosen = audits.find((one) => one.name === wanted) ?? audits[0];
    name = chosen?.name ?? "";
    showTabs(audits);
    if (!chosen) return void (parts.words.textContent = NONE);
    event = mission.event;
    const audit = await get("/api/audit", { name });
    if (mine === asked) showAudit(audit);
  } catch (error) {
    if (error.name !== "ApiError") throw error;
    if (mine === asked) parts.words.textContent = `It could not be loaded: ${error.message}.`;
  }
}

function showTabs(audits) {
  const back = el("a", { class: "tab", text: "‹ by class", attrs: { href: "#/sheet" } });
  const tabs = audits.map((one) => {
    const attrs = { href: `#/audit/${encodeURIComponent(one.name)}`, title: one.fault || one.of };
    const tab = el("a", { class: "tab", attrs }, el("span", { text: `Audit ${one.name}` }));
    if (one.name === name) tab.setAttribute("aria-current", "page");
    tab.append(el("span", { class: "count", text: one.patches.toLocaleString("en") }));
    return tab;
  });
  parts.tabs.replaceChildren(back, ...tabs);
}

function showAudit(audit) {
  const { of, rule, total, patches } = audit;
  const shown = patches.length < total ? ` The worst ${patches.length} of ${total}.` : "";
  parts.words.textContent = `${of}: ${rule}${shown}`;
  const place = sheet?.place() ?? places.get(name);
  sheet?.close();
  sheet = new AuditSheet({ patches, place, onOpen: open });
  parts.body.replaceChildren(sheet.element);
  sheet.start();
  sheet.grid.focus();
}

/** Labels changed somewhere, maybe in frames that are not shown: tiles stay where they are. */
function learnSoon() {
  if (!sheet || event === mission.event) return;
  clearTimeout(timer);
  timer = setTimeout(learn, LEARN_MS);
}

async function learn() {
  const mine = asked;
  event = mission.event;
  try {
    const { patches } = await get("/api/audit", { name });
    if (mine === asked) sheet.learn(patches);
  } catch (error) {
    if (error.name !== "ApiError") throw error;
    // The page says that the server is away; what was decided meanwhile is learnt with the next.
  }
}

function open({ camera, frame, cell }) {
  go(`#/label/${camera}/${frame}/${cell}`);
}

/** A row of the table that only works while an audit is shown. */
function row(keys, does, run) {
  return { keys, does, run: () => (sheet ? run(sheet) : false) };
}

addView("audit", {
  title: "Label audit",
  under: "sheet",
  show,
  hide: leave,
  classKeys: (label) => sheet?.decide(() => label),
  keys: [
    { keys: ["class key"], does: "the selected patches are of this class" },
    row(["y"], "the label is right", (it) => it.confirm()),
    row(["n"], "the label is wrong, the suggestion right", (it) => it.takeSuggestion()),
    row(["Delete", "Backspace"], "take the decision back", (it) => it.takeBack()),
    row(["Enter"], "open the frame of the patch", (it) => it.openCurrent()),
    row(["/"], "filter: open, decided, all", (it) => it.nextWhich()),
    row(["d", "PageDown"], "next page", (it) => it.turn(1)),
    row(["a", "PageUp"], "previous page", (it) => it.turn(-1)),
    { keys: ["r"], does: "load it anew", run: () => load(name) },
    ...lookKeys,
    ...selectionKeys(() => sheet?.grid),
  ],
});

onLabels(soon(() => sheet?.refresh()));
onChange((what) => {
  if (parts && !sheet && what === "all") load(name);
  else learnSoon();
});
onReload(() => {
  places.clear();
  if (parts) load(name);
});
onSetting((what) => {
  if (sheet && ["enhance", "palette"].includes(what)) sheet.redraw();
});
