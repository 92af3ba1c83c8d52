"""A person at the labelling page in a headless browser, whose keys, clicks and drags are counted.

The page alone knows what a key does and what a suggestion follows: before each stroke it is asked
what its frames hold, as a person would look.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from tests.load.page.tab import Box, Tab, middle_of
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.labels.taxonomy import UNSURE, Taxonomy

Target = Mapping[int, Sequence[str | None]]
"""Labels to be given, by frame, one a patch; None where any will do, or none."""
FREE = None
_ROUNDS = 10
"""What follows a stroke may be wrong then and must be painted, too: more often it never is."""
ACCEPT, REST, NEXT = "accept", "rest", "next"
_SHEET_KEYS = {ACCEPT: "Shift+Enter", REST: "o", NEXT: "PageDown"}
_FRAME_KEYS = {ACCEPT: "g", REST: "o", NEXT: "d"}

_SUGGESTED = """async () => {
  const { mission } = await import("/static/core/mission.js");
  return !mission.model || mission.model.done === mission.model.total;
}"""
_SAVED = """async () => {
  const { state, pending } = await import("/static/saving/saver.js");
  return state() === "saved" && pending() === 0;
}"""
_SHEET = """(first) => {
  const thumbs = [...document.querySelectorAll(".thumb")];
  const waits = thumbs.some((thumb) => thumb.classList.contains("loading"));
  if (waits || thumbs[0]?.dataset.frame !== String(first)) return null;
  return thumbs.map((thumb) => {
    const box = thumb.querySelector("canvas").getBoundingClientRect();
    return [Number(thumb.dataset.frame), [box.left, box.top, box.width, box.height]];
  });
}"""
_LOADED = """async (frames) => {
  const { framesFollowed } = await import("/static/frame/suggest.js");
  const { labelsOf } = await import("/static/saving/labels.js");
  const needed = frames.flatMap((frame) => [frame, ...framesFollowed("left", frame)]);
  return needed.every((frame) => labelsOf("left", frame));
}"""
_HELD = """async (frames) => {
  const { hintsOf } = await import("/static/frame/painting.js");
  const { labelsOf } = await import("/static/saving/labels.js");
  return frames.map((frame) => {
    const hints = hintsOf("left", frame);
    return labelsOf("left", frame).mine.map((own, cell) => [own, hints[cell]?.label ?? null]);
  });
}"""


@dataclass(frozen=True)
class Workflow:
    """How a person works, the same with suggestions and without."""

    name: str
    words: str
    sheet: bool  # on the contact sheet; else in each frame's own view
    drags: bool
    """One stroke through many patches is one action, on the sheet through all its frames at once
    where they are alike; else each patch is a click."""
    unsure: bool  # whether unsure patches, which nothing learns from, must be reproduced too
    asked: float | None = None  # so many times fewer actions with suggestions


class LabelSession:
    """Gives all frames the labels asked for, from a page without any, and counts what it does.

    The tab is in the view of the first frame; the frames of `target` are all that the mission has.
    """

    def __init__(self, tab: Tab, target: Target, way: Workflow, suggested: bool) -> None:
        taxonomy = Taxonomy.load()
        self.actions = 0
        self._tab, self._way = tab, way
        self._target = {frame: np.array(labels, object) for frame, labels in target.items()}
        self._ends = (ACCEPT, REST) if suggested else (REST,)
        self._class_keys = {known.name: known.key for known in taxonomy.classes} | {UNSURE: "u"}
        self._clear = next(name for name in taxonomy.names if not taxonomy.is_obstacle(name))
        self._chosen = ""
        self._boxes: dict[int, Box] = {}

    def run(self) -> int:
        """Label everything and wait until it is saved; the number of actions."""
        self._tab.until(_SUGGESTED)
        if self._way.sheet:
            self._tab.page.click("#views a[href^='#/overview']")
            self.actions += 1
        left = list(self._target)
        while left:
            shown = self._shown(left[0])
            left = left[len(shown) :]
            self._label(shown, bool(left))
        self._tab.until(_SAVED)
        return self.actions

    def _shown(self, first: int) -> list[int]:
        """The frames on show once they are there, as `first` is the first of them."""
        if self._way.sheet:
            self._boxes = dict(self._tab.until(_SHEET, first))
        else:
            self._tab.until_drawn(first)
            self._boxes = {first: self._tab.frame_box()}
        self._tab.until(_LOADED, list(self._boxes))
        return list(self._boxes)

    def _label(self, shown: list[int], more: bool) -> None:
        """Correct what one key would not make right, press that key, and go on."""
        # Accepting comes first: it is as good where both leave the same to be done.
        end = min(self._ends, key=lambda key: self._order(shown, key)[0])
        for _ in range(_ROUNDS):
            _, order = self._order(shown, end)
            if not order:
                break
            for at, label in enumerate(order):
                self._paint(shown, end, label, order[at + 1 :])
        else:
            raise ToktError(f"the page does not keep what is painted in frames {shown}")
        wanted, own, _ = self._seen(shown)
        key = end if ((wanted != FREE) & (own == FREE)).any() else NEXT
        if key != NEXT or more:
            self._press((_SHEET_KEYS if self._way.sheet else _FRAME_KEYS)[key])
        if key == REST and more and not self._way.sheet:
            self._press(_FRAME_KEYS[NEXT])

    def _seen(self, frames: list[int]) -> NDArray[np.object_]:
        """Label wanted, own label and suggestion of each patch, as the page has them now.

        Each of shape (frames, patches).
        """
        held = np.array(self._tab.page.evaluate(_HELD, frames), object)
        return np.stack([[self._target[frame] for frame in frames], held[..., 0], held[..., 1]])

    def _wrong(self, frames: list[int], end: str) -> NDArray[np.object_]:
        """The labels that are wanted where a key would leave others, FREE everywhere else."""
        wanted, own, hint = self._seen(frames)
        left = hint if end == ACCEPT else self._clear
        return np.where(wanted == np.where(own == FREE, left, own), FREE, wanted)

    def _order(self, frames: list[int], end: str) -> tuple[int, Sequence[str]]:
        """In which order painting the classes takes fewest strokes and keys, and how many."""
        wrong = self._wrong(frames, end)

        def actions(order: Sequence[str]) -> int:
            strokes = sum(
                len(self._paths([frame], of_one[None], label, order[at + 1 :]))
                for at, label in enumerate(order)
                for frame, of_one in zip(frames, wrong, strict=True)
            )
            return strokes + len(order) - (order[:1] == (self._chosen,))

        every = permutations(sorted({*wrong.flat} - {FREE}))
        return min((actions(order), order) for order in every)

    def _paint(self, shown: list[int], end: str, label: str, later: Sequence[str]) -> None:
        """Paint a class in all frames where it is missing, or in all at once where they agree."""
        if self._way.drags and len(shown) > 1:
            wrong = self._wrong(shown, end)
            for path in self._paths(shown, wrong, label, later):
                if (wrong[:, path] != FREE).any(axis=1).sum() > 1:
                    self._stroke(shown[0], label, path, in_all=True)
        for frame in shown:
            for path in self._paths([frame], self._wrong([frame], end), label, later):
                self._stroke(frame, label, path)

    def _paths(
        self, frames: list[int], wrong: NDArray[np.object_], label: str, later: Sequence[str]
    ) -> list[list[int]]:
        """The strokes that paint a class where it is wanted in a frame, or in any of several.

        They cross patches that may have this label, or are painted over by a class that comes
        later: in each of the frames.
        """
        need = (wrong == label).any(axis=0)
        if not self._way.drags:
            return [[cell] for cell in np.flatnonzero(need).tolist()]
        may = np.isin([self._target[frame] for frame in frames], (label, FREE))
        may = (may | np.isin(wrong, later)).all(axis=0)
        return drags(np.flatnonzero(need & may).tolist(), np.flatnonzero(may).tolist())

    def _press(self, key: str) -> None:
        self._tab.page.keyboard.press(key)
        self.actions += 1

    def _stroke(self, frame: int, label: str, path: Sequence[int], in_all: bool = False) -> None:
        """A click on a patch, or a drag over several; before it, the class is chosen."""
        if label != self._chosen:
            self._press(self._class_keys[label])
            self._chosen = label
        mouse, keyboard = self._tab.page.mouse, self._tab.page.keyboard
        if in_all:
            keyboard.down("Control")
        points = [middle_of(self._boxes[frame], cell) for cell in path]
        mouse.move(*points[0])
        mouse.down()
        for point in points[1:]:
            mouse.move(*point)
        mouse.up()
        if in_all:
            keyboard.up("Control")
        self.actions += 1


def drags(need: Collection[int], may: Collection[int]) -> list[list[int]]:
    """Paths from patch to patch across edges that reach all of `need` inside `may`, few of them.

    One drag can walk all of a connected area and pass a patch twice, so an area costs one. No hand
    goes exactly through a corner, so patches that only share one are not connected.
    """
    left, paths = {*need, *may}, []
    for cell in sorted(need):
        if cell in left:
            paths.append(_walk(cell, left, need))
    return paths


def _walk(cell: int, left: set[int], need: Collection[int]) -> list[int]:
    """From a patch along each way that leads to a patch in need, and back to it."""
    left.discard(cell)
    path = [cell]
    row, col = divmod(cell, DEFAULT_GRID.cols)
    around = ((row - 1, col), (row, col - 1), (row, col + 1), (row + 1, col))
    for near in (r * DEFAULT_GRID.cols + c for r, c in around if 0 <= c < DEFAULT_GRID.cols):
        if near in left:
            way = _walk(near, left, need)
            path += [*way, cell] if any(one in need for one in way) else []
    return path
