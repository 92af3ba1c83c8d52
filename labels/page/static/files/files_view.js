// The view of files and models: labels in and out, a backup, and what the other commands of tokt do
// with these labels.

import { address, get, onFailure, post, send } from "../core/api.js";
import { choice, complain } from "../core/controls.js";
import { button, el, say } from "../core/dom.js";
import { mission, onChange, onReload, who } from "../core/mission.js";
import { addView, go } from "../core/router.js";
import { classEditor } from "./class_editor.js";
/** @import { Child, Choice, Imported, Read } from "../types.js" */

const ANY = "as the file says";
const EVERYBODY = "everybody";
const LEAVE_OUT = "leave out";

/** @type {{parts: ?{root: HTMLElement, job: HTMLElement}}} The elements while the view is shown. */
const view = { parts: null };

function show(/** @type {HTMLElement} */ root) {
  const job = el("div", { class: "job", role: "status" });
  view.parts = { root, job };
  root.replaceChildren(
    el("section", { class: "files", tabindex: -1, "data-home": true, "aria-label": "files" },
      card("Export labels", ...exporting()),
      card("Import labels", ...importing()),
      mission.blind ? "" : card("Backup",
        el("p", { text: "All labels and notes of the workspace, in one checked file." }),
        link("Download a backup", address("/api/backup")),
      ),
      card("Model and audit", ...jobs(), job),
      card("Classes", classEditor()),
    ),
  );
  showJob();
}

function card(/** @type {string} */ title, /** @type {Child[]} */ ...children) {
  return el("section", { class: "card" }, el("h2", { text: title }), ...children);
}

function field(/** @type {string} */ words, /** @type {Child} */ control) {
  return el("label", { class: "field" }, el("span", { text: words }), control);
}

function link(/** @type {string} */ text, /** @type {string} */ href) {
  return el("a", { class: "button main", text, href, download: "" });
}

function lines(/** @type {string[]} */ texts) {
  return el("ul", {}, ...texts.map((text) => el("li", { text })));
}

// ---- Labels out

function exporting() {
  const form = choice(Object.entries(mission.formats), "csv", { on: { change: check } });
  const people = mission.blind ? [who()] : [EVERYBODY, ...mission.annotators];
  const whose = choice(people, mission.blind ? who() : EVERYBODY, { on: { change: check } });
  /** @type {HTMLInputElement} */
  const full = el("input", { type: "checkbox", checked: true, on: { change: check } });
  const told = el("div", { role: "status" });
  const download = link("Download", "#");
  const slow = "The folder of patches is being made; the browser saves it when it is there.";
  download.addEventListener("click", () => form.value === "patches" && say(slow));
  async function check() {
    const only = whose.value === EVERYBODY ? null : whose.value;
    const wanted = { format: form.value, only, full: full.checked ? 1 : null };
    download.href = address("/api/export", wanted);
    const request = get("/api/export", { ...wanted, check: 1 });
    const answer = await request.catch(onFailure(({ message }) => message)) ?? "";
    download.hidden = typeof answer === "string";
    if (typeof answer === "string") return told.replaceChildren(el("p", { text: answer }));
    const words = `${answer.labels.toLocaleString("en")} labels of ${mission.mission}.`;
    told.replaceChildren(el("p", { text: words }), lines(answer.lost));
  }
  check();
  return [
    field("Format", form),
    field("Labels of", whose),
    el("label", { class: "check" }, full, " with who, when, and from which model (CSV)"),
    told,
    download,
  ];
}

// ---- Labels in

function importing() {
  const on = { change: () => read({}) };
  const file = el("input", { type: "file", on });
  const files = Object.entries(mission.formats).filter(([name]) => name !== "patches");
  const form = choice([["", ANY], ...files], "", { on });
  const annotator = el("input", { maxlength: 60, placeholder: ANY, on });
  const folder = el("input", { maxlength: 60, placeholder: mission.mission, on });
  const cameras = Object.keys(mission.cameras);
  const camera = choice(cameras, cameras[0], { on });
  const told = el("div", { role: "status" });
  /** What the file's classes are here: {theirs: ours}; ours is "" for those to leave out. */
  async function read(/** @type {Record<string, string>} */ named, apply = false) {
    const chosen = file.files?.[0];
    if (!chosen) return;
    const params = { name: chosen.name, format: form.value || null, apply: apply ? 1 : null };
    Object.assign(params, { annotator: annotator.value.trim() || null, camera: camera.value });
    Object.assign(params, { folder: folder.value.trim() || null });
    const map = Object.entries(named).map(([theirs, ours]) => `${theirs}=${ours}`);
    told.replaceChildren(el("p", { text: apply ? "Importing …" : "Reading …" }));
    const request = send("/api/import", { ...params, map }, chosen);
    const answer = await request.catch(onFailure(({ message }) => message)) ?? "";
    if (typeof answer === "string") told.replaceChildren(el("p", { class: "bad", text: answer }));
    else if (answer.unknown.length) told.replaceChildren(...asking(answer.unknown, named, read));
    else told.replaceChildren(...found(answer, () => read(named, true)));
  }
  return [
    field("File", file),
    field("Format", form),
    field("Labels by", annotator),
    field("Folder in it", folder),
    cameras.length > 1 ? field("Camera, if it names none", camera) : null,
    told,
  ];
}

/** @param {string[]} unknown @param {Record<string, string>} named @param {Read} read */
function asking(unknown, named, read) {
  const given = mission.classes.filter(({ key }) => key).map(({ name }) => name);
  /** @type {Choice[]} */
  const ours = [["", LEAVE_OUT], ...given];
  const rows = unknown.map((theirs) => ({ theirs, control: choice(ours, "") }));
  const pairs = () => rows.map(({ theirs, control }) => [theirs, control.value]);
  return [
    el("p", { text: "The file has classes that this workspace does not have. What are they here?" }),
    ...rows.map(({ theirs, control }) => field(theirs, control)),
    button("Go on", () => read({ ...named, ...Object.fromEntries(pairs()) }), { class: "main" }),
  ];
}

/** @param {Imported} told @param {() => void} apply */
function found({ applied, annotators, labels, here, lost, ...counts }, apply) {
  /** @type {[count: number, words: string][]} */
  const kinds = [
    [counts.new, "new"], [counts.changed, "changed"], [counts.unchanged, "known already"],
    [counts.settled, "settled"],
  ];
  const some = kinds.filter(([count]) => count);
  const told = some.map(([count, kind]) => `${count.toLocaleString("en")} ${kind}`);
  const words = `${labels.toLocaleString("en")} labels by ${annotators.join(", ")}`;
  const other = here < labels ? [`${labels - here} of other missions or grids`] : [];
  const head = `${applied ? "Imported" : "The file has"} ${words}: ${told.join(", ")}.`;
  return [
    el("p", { text: head }),
    lines([...other, ...lost]),
    applied ? "" : button(`Import ${labels.toLocaleString("en")} labels`, apply, { class: "main" }),
  ];
}

// ---- What the other commands do

function jobs() {
  const start = (/** @type {{what: string}} */ body) => async () => {
    const answer = await post("/api/job", body).catch(onFailure(complain()));
    if (answer) mission.job = answer.job;
    showJob();
  };
  const model = mission.model
    ? `Suggestions come from ${mission.model.label}.`
    : "There is no model yet: train one of your labels, and it suggests the rest.";
  return [
    el("p", { text: mission.blind ? "Not while you label blind." : model }),
    button("Train a model of these labels", start({ what: "model" }), {
      class: "main", disabled: mission.blind,
      title: "Takes minutes. It needs six labelled frames: water in three of them, obstacles in three.",
    }),
    button("Look for labels that may be wrong", start({ what: "audit" }), {
      disabled: mission.blind,
      title: "Models that did not learn a frame judge its labels; nothing is changed.",
    }),
  ];
}

function cancelJob() {
  return post("/api/job/cancel", {}).catch(onFailure(complain()));
}

/** @type {Record<string, string>} */
const SAID = { done: "is ready", failed: "failed", cancelled: "was cancelled" };

async function showJob() {
  const here = view.parts;
  const { job } = mission;
  if (!here || !job) return;
  const name = job.what === "audit" ? "The audit" : "The model";
  const { what = "", done = 0, total = 0 } = job.progress ?? {};
  const running = job.state === "running";
  const doing = what ? `${what}, ${done} of ${total}` : "begins";
  const answer = await get("/api/job").catch(onFailure());
  if (here !== view.parts || job !== mission.job) return; // there is news by now
  const result = (job.state === "done" && answer?.job?.result) || [];
  here.job.replaceChildren(
    el("p", { class: job.state === "failed" ? "bad" : "" ,
      text: running
        ? `${name}: step ${job.step} of ${job.steps}, ${doing}.`
        : `${name} ${SAID[job.state]}${job.error ? `: ${job.error}` : "."}`,
    }),
    ...(result.length ? [lines(result)] : []),
    ...(running && total ? [el("progress", { max: total, value: done, "aria-label": what })] : []),
    ...(running ? [button("Cancel", cancelJob)] : []),
    ...(job.state === "done" && job.what === "audit" ? [button("Look at them", () => go("#/audit"))] : []),
    el("details", {}, el("summary", { text: "What it printed" }),
      el("pre", { text: answer?.job?.lines.join("\n") ?? "" })),
  );
}

function hide() {
  view.parts = null;
}

addView("files", { title: "Files and models", show, hide, keys: [] });

onChange((what) => {
  if (view.parts && what === "all") show(view.parts.root);
  else if (view.parts && what === "status") showJob();
});
onReload(() => view.parts?.root.replaceChildren()); // another person's files
