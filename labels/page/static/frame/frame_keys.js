// The table of the frame view's keys: what dispatches them, the overlay and the buttons read it.

import { labelKeys, reachable } from "../core/keys.js";
import { arrowKeys } from "../core/patch_grid.js";
/** @import { HeldCommands, KeyEntry, KeyRow } from "../types.js" */

const NEXT = "Frames";
const PAINT = "Painting";
const SEE = "Seeing";

/** Commands with a release are held or tapped. @type {KeyRow[]} */
const TABLE = [
  ["next", ["d", ".", "PageDown"], NEXT, "next frame (of the filter)"],
  ["previous", ["a", ",", "PageUp"], NEXT, "frame before"],
  ["next10", ["D", "Shift+PageDown"], NEXT, "ten frames on"],
  ["previous10", ["A", "Shift+PageUp"], NEXT, "ten frames back"],
  ["first", ["Home"], NEXT, "first frame"],
  ["last", ["End"], NEXT, "last frame"],
  ["unlabelled", ["n"], NEXT, "next frame without a label of mine"],
  ["unlabelledBack", ["N"], NEXT, "the one before without a label"],
  ["uncertain", ["q"], NEXT, "next uncertain frame: where the model is least sure"],
  ["disagreement", ["x"], NEXT, "next frame with a disagreement"],
  ["type", ["f"], NEXT, "type a frame number"],
  ["camera", ["s"], NEXT, "left or right camera"],
  ["beside", ["w"], SEE, "left and right side by side: the second one is to look at"],
  ["play", ["k"], NEXT, "play, and stop; what labels stops it too and labels nothing"],
  ["paint", ["Space"], PAINT, "paint the cursor's patch or the rectangle"],
  ["move", arrowKeys(), PAINT, "move the cursor"],
  ["extend", arrowKeys("Shift+"), PAINT, "span a rectangle; a class key then paints it"],
  ["row", ["r"], PAINT, "paint the cursor's row"],
  ["rest", ["o"], PAINT, "the rest of this frame is clear (the class that is no obstacle)"],
  ["copy", ["p"], PAINT, "same as the frame before, to be accepted"],
  ["carry", ["P"], PAINT, "the obstacles of the left camera, to be accepted"],
  ["accept", ["Enter"], PAINT, "accept the copies and the sure suggestions; save the mask"],
  ["acceptAll", ["Shift+Enter"], PAINT, "accept all suggestions"],
  ["acceptNext", ["g", "Ctrl+Enter"], PAINT, "accept as Enter does; next frame not done"],
  ["confirm", ["c"], PAINT, "tool: painting accepts single suggestions (also Alt+click)"],
  ["erase", ["e"], PAINT, "tool: painting takes my labels back"],
  ["mask", ["M"], PAINT, "tool: painting masks what is no view in any frame, and back"],
  ["takeBack", ["Delete", "Backspace"], PAINT, "take back the label at the cursor"],
  ["note", ["t"], PAINT, "write a note on the patch; without one, on the frame"],
  ["escape", ["Escape"], PAINT, "give up: stroke, rectangle, Mask mode, then copies"],
  ["raw", ["h"], SEE, "raw frame: tap to switch, hold to look"],
  ["blink", ["b"], SEE, "frame before: hold to look, tap to blink"],
  ["grid", ["l"], SEE, "grid lines"],
  ["outlines", ["v"], SEE, "labels and suggestions"],
  ["suggestions", ["m"], SEE, "suggestions of the model"],
  ["zoomIn", ["+", "="], SEE, "zoom in (also the wheel)"],
  ["zoomOut", ["-"], SEE, "zoom out"],
  ["fit", ["0"], SEE, "whole frame"],
  ["pan", arrowKeys("Ctrl+"), SEE, "move the picture (also Space+drag, middle button)"],
];

// For the overlay only.
const POINTER_HELP = [
  ["Click, drag", "paint patches"],
  ["Shift+drag", "paint a rectangle"],
  ["Row or column head", "paint the row or column"],
  ["Right click", "unsure, whatever class is chosen"],
  ["Alt+click", "accept a single suggestion or copy"],
  ["Wheel on the strip", "fewer or more frames there (also +, -, 0 on it); sideways: move it"],
];

/** The view's keys. @returns {KeyEntry[]} */
export function frameKeys(/** @type {HeldCommands} */ commands) {
  const rows = TABLE.map(([name, keys, group, does]) => {
    const run = commands[name];
    return { keys, group, does, run, release: run.release };
  });
  const pointer = POINTER_HELP.map(([what, does]) => ({ keys: [what], group: "Pointer", does }));
  return [...rows, ...labelKeys, ...pointer];
}

export function keyForCommand(/** @type {string} */ command) {
  const keys = TABLE.find(([name]) => name === command)?.[1] ?? [""];
  return keys.find((key) => reachable(key) === key) ?? reachable(keys[0]);
}
