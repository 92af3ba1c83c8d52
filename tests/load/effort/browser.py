"""A plan really performed: keys and mouse on the labelling page in a headless browser."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tests.load.page.tab import Tab
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.labels.taxonomy import UNSURE, Taxonomy

from .page import SHEET, Labels, Page, PageAction, PageSuggestions

_SHEET_KEYS = {"accept": "Shift+Enter", "rest": "o", "next": "PageDown"}
_FRAME_KEYS = {"accept": "g", "rest": "o", "next": "d", "copy": "p"}
_SHEET_LINK = "#views a[href^='#/overview']"

_BOXES = """() => [...document.querySelectorAll(".thumb-picture canvas")].map((canvas) => {
  const box = canvas.getBoundingClientRect();
  return [box.left, box.top, box.width, box.height];
})"""
_SHEET_IS_AT = """(frame) => {
  const thumbs = [...document.querySelectorAll(".thumb")];
  return thumbs.length > 0 && !thumbs.some((thumb) => thumb.classList.contains("loading")) &&
    thumbs[0].querySelector(".thumb-number").textContent === String(frame);
}"""
_COPIED = """async (frame) => {
  const { copiesOf } = await import("/static/frame/painting.js");
  return copiesOf("left", frame).length > 0;
}"""
_SUGGESTED = """async () => {
  const { mission } = await import("/static/core/mission.js");
  return !mission.model || mission.model.done === mission.model.total;
}"""
_VALUES = """async (frames) => {
  const { get } = await import("/static/core/api.js");
  const { mission } = await import("/static/core/mission.js");
  const rows = [];
  for (let from = 0; from < frames.length; from += 60) {
    const some = frames.slice(from, from + 60).join(",");
    const answer = await get("/api/labels", { camera: "left", frames: some, suggest: 1 });
    for (const { suggestions: said } of answer.frames) {
      rows.push(said.values.map((v, at) => (mission.model.obstacle[said.classes[at]] ? v : -v)));
    }
  }
  return rows;
}"""


def suggested_values(tab: Tab, numbers: Sequence[int]) -> np.ndarray:
    """The decision values that the page shows, positive for an obstacle.

    Returns
    -------
    array of float64, shape (n_frames, n_cells)
    """
    tab.until(_SUGGESTED)
    return np.array(tab.page.evaluate(_VALUES, list(numbers)), np.float64)


def frames_on_a_sheet(tab: Tab, first: int) -> int:
    """How many frames one page of the contact sheet shows in this window."""
    tab.page.click(_SHEET_LINK)
    tab.until(_SHEET_IS_AT, first)
    return len(tab.page.evaluate(_BOXES))


class Performer:
    """Does on the page what a plan says, and knows where the page is.

    Parameters
    ----------
    tab : Tab
        On the first frame, in the frame view, every suggestion computed.
    numbers : sequence of int
        The mission's frames.
    page : Page
        The page in plain Python, in the same state.
    names : sequence of str
        The classes that a plan's indices mean.
    """

    def __init__(self, tab: Tab, numbers: Sequence[int], page: Page, names: Sequence[str]) -> None:
        self._tab, self._numbers, self._page = tab, numbers, page
        keys = {known.name: known.key for known in Taxonomy.load().classes} | {UNSURE: "u"}
        self._keys = [keys[name] for name in names]
        self._boxes: list[list[float]] = []
        self._chosen = -1

    def perform(self, plan: Sequence[PageAction]) -> None:
        """Perform a plan to its end, and wait until everything is saved."""
        for action in plan:
            self._do(action)
        self._tab.wait_until_saved()

    def _do(self, action: PageAction) -> None:
        before = (self._page.view, self._page.frame)
        press = self._tab.page.keyboard.press
        if action.kind == "choose":
            press(self._keys[action.label])
        elif action.kind in ("paint", "paint_all"):
            self._paint(action)
        elif action.kind == "sheet":
            self._tab.page.click(_SHEET_LINK)
        else:
            press((_SHEET_KEYS if self._page.view == SHEET else _FRAME_KEYS)[action.kind])
        if action.kind == "copy":
            self._tab.until(_COPIED, self._numbers[self._page.frame])
        self._page.perform(action)
        if (self._page.view, self._page.frame) != before:
            self._wait()

    def _wait(self) -> None:
        """Wait until the page shows what it should show by now."""
        self._boxes = []
        number = self._numbers[self._page.frame]
        if self._page.view == SHEET:
            self._tab.until(_SHEET_IS_AT, number)
        else:
            self._tab.until_drawn(number)

    def _paint(self, action: PageAction) -> None:
        mouse, keyboard = self._tab.page.mouse, self._tab.page.keyboard
        if action.kind == "paint_all":
            keyboard.down("Control")
        points = [self._point(action.frame, cell) for cell in action.path]
        mouse.move(*points[0])
        mouse.down()
        for point in points[1:]:
            mouse.move(*point)
        mouse.up()
        if action.kind == "paint_all":
            keyboard.up("Control")

    def _point(self, frame: int, cell: int) -> tuple[float, float]:
        """The middle of a patch, in the window's pixels."""
        if self._page.view != SHEET:
            return self._tab.middle_of(cell)
        if not self._boxes:
            self._boxes = self._tab.page.evaluate(_BOXES)
        left, top, width, height = self._boxes[frame - self._page.frame]
        row, col = divmod(cell, DEFAULT_GRID.cols)
        return (
            left + (col + 0.5) / DEFAULT_GRID.cols * width,
            top + (row + 0.5) / DEFAULT_GRID.rows * height,
        )


def empty_page(
    shape: tuple[int, int], clear: int, sheet: int, says: PageSuggestions | None
) -> Page:
    """The page of a mission that nobody has labelled."""
    labels: Labels = np.full(shape, -1, np.int16)
    return Page(labels, says, clear, sheet)
