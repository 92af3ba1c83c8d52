// What the pointer does on the frame's canvas: strokes, rectangles, heads, pan and zoom.

import { cellsBetween, cellsOfColumn, cellsOfRow, cellsOnLine } from "../core/patch_grid.js";
/** @import { FrameCanvas, Gesture, Hit, Host, PointerGestures, PointerTool } from "../types.js" */

const WHEEL_STEP = 1.0015;
const LEFT = 0;
const MIDDLE = 1;
const RIGHT = 2;

/** Listen to the pointer over a canvas. @returns {PointerGestures} */
export function listenToPointer(/** @type {FrameCanvas} */ view, /** @type {Host} */ host) {
  const { canvas } = view;
  /** @type {?Gesture} */
  let gesture = null;

  const start = (/** @type {PointerEvent} */ event) => {
    if (gesture) return;
    if (event.button === MIDDLE || (event.button === LEFT && host.panning())) {
      gesture = panGesture(view, event);
      host.panned();
    } else if (event.button === LEFT || event.button === RIGHT) {
      gesture = host.canPaint() ? paintGesture(view, host, event) : null;
    }
    if (!gesture) return;
    event.preventDefault();
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
  };
  const move = (/** @type {PointerEvent} */ event) => {
    if (!gesture) host.hover(view.hit(event.clientX, event.clientY).cell);
    else for (const part of parts(event)) gesture.move(part);
  };
  const end = (/** @type {PointerEvent} */ event) => {
    gesture?.move(event);
    complete();
  };
  const cancel = () => {
    gesture = null;
    view.set({ stroke: null });
  };
  const complete = () => {
    const done = gesture;
    cancel();
    done?.finish?.();
  };
  const wheel = (/** @type {WheelEvent} */ event) => {
    event.preventDefault();
    const { left, top } = canvas.getBoundingClientRect();
    const factor = WHEEL_STEP ** -(event.deltaMode ? event.deltaY * 30 : event.deltaY);
    view.viewport.zoomBy(factor, event.clientX - left, event.clientY - top);
    view.invalidate();
  };

  canvas.addEventListener("pointerdown", start);
  canvas.addEventListener("pointermove", move);
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", cancel);
  canvas.addEventListener("pointerleave", () => gesture || host.hover(-1));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", wheel, { passive: false });
  return { cancel, complete, busy: () => gesture !== null };
}

/** A fast pointer moves several times between two events. */
function parts(/** @type {PointerEvent} */ event) {
  const all = event.getCoalescedEvents?.() ?? [];
  return all.length ? all : [event];
}

/** @param {FrameCanvas} view @param {PointerEvent} first @returns {Gesture} */
function panGesture(view, first) {
  let { clientX, clientY } = first;
  return {
    move(/** @type {PointerEvent} */ event) {
      view.viewport.pan(event.clientX - clientX, event.clientY - clientY);
      ({ clientX, clientY } = event);
      view.invalidate();
    },
  };
}

/** @param {FrameCanvas} view @param {Host} host @param {PointerEvent} event */
function paintGesture(view, host, event) {
  const hit = view.hit(event.clientX, event.clientY);
  const tool = toolOf(event);
  if (hit.head) {
    const { row, col } = hit.head;
    const cells = row === undefined ? cellsOfColumn(col ?? 0) : cellsOfRow(row);
    const kind = row === undefined ? "column" : "row";
    return showing(view, host, tool, new Set(cells), kind, () => {});
  }
  if (event.shiftKey && hit.cell >= 0) {
    const cells = new Set([hit.cell]);
    return showing(view, host, tool, cells, "rectangle", (to) => {
      if (to.cell < 0) return;
      cells.clear();
      for (const cell of cellsBetween(hit.cell, to.cell)) cells.add(cell);
    });
  }
  const cells = new Set(hit.cell >= 0 ? [hit.cell] : []);
  let from = hit;
  return showing(view, host, tool, cells, "paint", (to) => {
    for (const cell of cellsOnLine(from, to)) cells.add(cell);
    from = to;
  });
}

/** @param {FrameCanvas} view @param {Host} host @param {PointerTool} tool
 * @param {Set<number>} cells @param {string} kind @param {(to: Hit) => void} take
 * @returns {Gesture}
 */
function showing(view, host, tool, cells, kind, take) {
  const show = () => view.set({ stroke: { cells, label: host.labelOf(tool) } });
  show();
  return {
    move(/** @type {PointerEvent} */ event) {
      take(view.hit(event.clientX, event.clientY));
      show();
    },
    finish() {
      if (cells.size) host.finish([...cells], tool, kind);
    },
  };
}

/** @param {PointerEvent} event @returns {PointerTool} */
function toolOf(event) {
  if (event.altKey) return "confirm";
  return event.button === RIGHT ? "unsure" : "chosen";
}
