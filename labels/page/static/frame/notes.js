// Notes on patches and frames: their words, and the dialog in which one is written.

import { onFailure, post } from "../core/api.js";
import { button, el, focusView, part, say } from "../core/dom.js";
import { who } from "../core/mission.js";
import { labelsAreStale } from "../saving/labels.js";
import { cellName } from "../core/patch_grid.js";
/** @import { Note } from "../types.js" */

/** The notes of a frame that are on a patch, or on the frame, each in words. */
export function noteWords(/** @type {Note[]} */ notes, /** @type {?number} */ cell) {
  const here = notes.filter((note) => note.cell === null || note.cell === cell);
  return here.map((note) => {
    const where = note.cell === null ? " on the frame" : "";
    const whose = note.who === who() ? "" : ` of ${note.who}`;
    return `note${where}${whose}: ${note.text}`;
  });
}

/** Let a person write a note; an empty one takes it back. `notes`: all of the frame.
 * @param {string} camera @param {number} frame @param {?number} cell @param {Note[]} notes
 */
export function writeNote(camera, frame, cell, notes) {
  const here = notes.filter((note) => note.cell === cell);
  const field = el("textarea", { id: "note-text", maxlength: 2000, rows: 5 });
  field.value = here.find((note) => note.who === who())?.text ?? "";
  const failed = el("p", { role: "alert" });
  const save = async (/** @type {Event} */ event) => {
    event.preventDefault();
    const body = { camera, frame, cell, text: field.value.trim() };
    const answer = await post("/api/notes", body).catch(
      onFailure(({ message }) => void (failed.textContent = `Not saved: ${message}.`)),
    );
    if (!answer) return;
    dialog.close();
    labelsAreStale([[camera, frame]]);
    say(body.text ? "The note is saved." : "There is no note of yours here.");
  };
  const place = `${camera} frame ${frame}${cell === null ? "" : `, ${cellName(cell)}`}`;
  const others = here.filter((note) => note.who !== who());
  /** @type {HTMLDialogElement} */
  const dialog = el("dialog", { "aria-label": "Note" },
    el("form", { on: { submit: save } },
      el("h2", { text: "Note" }),
      ...others.map((note) => el("p", { text: `${note.who}: ${note.text}` })),
      el("label", { text: place, for: field.id }),
      field,
      failed,
      el("div", { class: "row" },
        el("button", { class: "main", text: "Save", type: "submit" }),
        button("Cancel", () => dialog.close()),
      ),
    ),
  );
  field.addEventListener("keydown", (event) => {
    if (event.key === "Enter" && event.ctrlKey) part(dialog, "form").requestSubmit();
  });
  dialog.addEventListener("close", () => {
    dialog.remove();
    focusView();
  });
  document.body.append(dialog);
  dialog.showModal();
}
