// The other camera's picture of the same frame, beside the one that is labelled, with its labels:
// to look at. What is painted goes to one picture only, so that no stroke is of the wrong one.

import { say } from "../core/dom.js";
import { maskedCells, mission } from "../core/mission.js";
import { picture, pictureNow } from "../core/pictures.js";
import { labelsOf, prefetch } from "../saving/labels.js";
import { FrameCanvas } from "./frame_canvas.js";
/** @import { FrameShow } from "../types.js" */

/** Shows it, or hides its canvas. */
export class Beside {
  /** @param {FrameShow} show Whose frame it is. @param {HTMLCanvasElement} element */
  constructor(show, element) {
    this.show = show;
    this.element = element;
    this.asked = "";
    this.canvas = new FrameCanvas(element);
    show.canvas.beside = this.canvas;
    element.addEventListener("pointerdown", () =>
      say("This picture is to look at; change the camera to label it."),
    );
  }

  update() {
    const { show, canvas, element } = this;
    const { beside: camera, frame, enhance } = show;
    element.hidden = camera === null;
    if (camera === null) return;
    element.style.order = camera === Object.keys(mission.cameras)[0] ? "-1" : "0";
    element.setAttribute("aria-label", `${camera} frame ${frame}, to look at`);
    const asked = `${camera}/${frame}/${enhance}`;
    const bitmap = pictureNow(camera, frame, enhance);
    const labels = labelsOf(camera, frame);
    const badge = `${camera}: to look at`;
    canvas.set({ bitmap, labels: bitmap && labels, masked: maskedCells(camera), badge });
    if (!labels) prefetch(camera, [frame]);
    if (bitmap || asked !== this.asked) canvas.set({ message: "" });
    if (bitmap || asked === this.asked) return;
    this.asked = asked;
    const come = (/** @type {string} */ message) => {
      if (asked !== this.asked) return; // another one is shown by now
      if (message) canvas.set({ message });
      else this.update();
      this.asked = message ? asked : "";
    };
    picture(camera, frame, enhance).then(
      () => come(""),
      ({ status, message }) => come(status ? `Frame ${frame} cannot be shown: ${message}.` : ""),
    );
  }
}
