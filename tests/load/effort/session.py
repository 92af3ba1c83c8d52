"""A person at the labelling page in a headless browser, whose keys, clicks and drags are counted.

The page alone knows what a key does and what a suggestion follows: before each stroke it is asked
what its frames hold, as a person would look.
"""

from collections.abc import Collection, Mapping, Sequence
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
_KEYS = {ACCEPT: "Shift+Enter", REST: "o", NEXT: "PageDown"}

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
    const { left, top, width, height } = thumb.querySelector("canvas").getBoundingClientRect();
    return [Number(thumb.dataset.frame), [left, top, width, height]];
  });
}"""
_LOADED = """async (frames) => {
  const { framesFollowed } = await import("/static/labelling/suggest.js");
  const { labelsOf } = await import("/static/saving/labels.js");
  const needed = frames.flatMap((frame) => [frame, ...framesFollowed("left", frame)]);
  return needed.every((frame) => labelsOf("left", frame));
}"""
_HELD = """async (frames) => {
  const { hintsOf } = await import("/static/labelling/painting.js");
  const { labelsOf } = await import("/static/saving/labels.js");
  return frames.map((frame) => {
    const hints = hintsOf("left", frame);
    return labelsOf("left", frame).mine.map((own, cell) => [own, hints[cell]?.label ?? null]);
  });
}"""
_AGAINST = """async (frames) => {
  const { mission } = await import("/static/core/mission.js");
  const { labelsOf, prefetch } = await import("/static/saving/labels.js");
  await prefetch("left", frames);
  return frames.map((frame) => {
    const { mine, suggestions } = labelsOf("left", frame);
    return mine.map((own, cell) => mission.model.obstacle[suggestions.classes[cell]] ? own : null);
  });
}"""


class LabelSession:
    """Gives all frames the labels asked for, from a page without any, and counts what it does.

    The frames of `target` are all that the mission has. The person works in the overview: one
    stroke through many patches is one action, through all its frames at once where they are alike.
    """

    def __init__(self, tab: Tab, target: Target, suggested: bool) -> None:
        taxonomy = Taxonomy.load()
        self.actions = 0
        self.against = 0  # patches made clear by no stroke on them, where the model says obstacle
        self._tab, self._suggested = tab, suggested
        self._target = {frame: np.array(labels, object) for frame, labels in target.items()}
        self._class_keys = {known.name: known.key for known in taxonomy.classes}
        self._clear = next(name for name in taxonomy.names if not taxonomy.is_obstacle(name))
        self._chosen = ""
        self._boxes: dict[int, Box] = {}
        self._stroked: set[tuple[int, int]] = set()

    def run(self) -> None:
        self._tab.until(_SUGGESTED)
        self._tab.page.click("#views a[href^='#/overview']")
        self.actions += 1
        left = list(self._target)
        while left:
            shown = self._shown(left[0])
            left = left[len(shown) :]
            self._label(shown, bool(left))
        self._tab.until(_SAVED)
        if self._suggested:
            self.against = self._made_clear()

    def _made_clear(self) -> int:
        frames = list(self._target)
        held = self._tab.page.evaluate(_AGAINST, frames)
        return sum(
            own == self._clear and (frame, cell) not in self._stroked
            for frame, labels in zip(frames, held, strict=True)
            for cell, own in enumerate(labels)
        )

    def _shown(self, first: int) -> list[int]:
        self._boxes = dict(self._tab.until(_SHEET, first))
        self._tab.until(_LOADED, list(self._boxes))
        return list(self._boxes)

    def _label(self, shown: list[int], more: bool) -> None:
        """Correct what one key would not make right, press that key, and go on."""
        end = ACCEPT if self._suggested else REST
        for _ in range(_ROUNDS):
            if self._suggested:
                self._correct(shown)
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
            self._press(_KEYS[key])

    def _correct(self, shown: list[int]) -> None:
        """Correct obstacles frame after frame: what is said of one is suggested in the next."""
        for frame in shown:
            for label, path in self._plan(frame):
                self._stroke(frame, label, path)

    def _plan(self, frame: int) -> list[tuple[str, list[int]]]:
        """The fewest strokes that correct a frame but for clear patches.

        A stroke may cross patches that are painted over by a class that comes later: those that
        are wrong, or also those that are right and become wrong by it.
        """
        target, wrong = self._target[frame], self._wrong([frame], ACCEPT)[0]
        plans = []
        for crossed in (wrong, target):
            names = sorted({*crossed} - {FREE, self._clear}) if (wrong != FREE).any() else []
            for order in permutations(names):
                left, plan = wrong.copy(), []
                for at, label in enumerate(order):
                    may = np.isin(target, (label, FREE)) | np.isin(crossed, order[at + 1 :])
                    cells = np.flatnonzero(left == label).tolist()
                    for path in drags(cells, np.flatnonzero(may).tolist()):
                        left[path] = target[path]
                        plan.append((label, path))
                    left[left == label] = FREE
                keys = len({*order} - {UNSURE, self._chosen})
                plans.append((len(plan) + keys, len(plans), plan))
        return min(plans)[2]

    def _seen(self, frames: list[int]) -> NDArray[np.object_]:
        """Label wanted, own label and suggestion, as the page has them: (3, frames, patches)."""
        held = np.array(self._tab.page.evaluate(_HELD, frames), object)
        return np.stack([[self._target[frame] for frame in frames], held[..., 0], held[..., 1]])

    def _wrong(self, frames: list[int], end: str) -> NDArray[np.object_]:
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
            chosen = [label for label in order if label != UNSURE]  # the right button paints unsure
            return strokes + len(chosen) - (chosen[:1] == [self._chosen])

        every = permutations(sorted({*wrong.flat} - {FREE}))
        return min((actions(order), order) for order in every)

    def _paint(self, shown: list[int], end: str, label: str, later: Sequence[str]) -> None:
        """Paint a class in all frames where it is missing, or in all at once where they agree."""
        if len(shown) > 1:
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
        may = np.isin([self._target[frame] for frame in frames], (label, FREE))
        may = (may | np.isin(wrong, later)).all(axis=0)
        return drags(np.flatnonzero(need & may).tolist(), np.flatnonzero(may).tolist())

    def _press(self, key: str) -> None:
        self._tab.page.keyboard.press(key)
        self.actions += 1

    def _stroke(self, frame: int, label: str, path: Sequence[int], in_all: bool = False) -> None:
        """A click on a patch, or a drag over several; before it, the class is chosen."""
        if label not in (self._chosen, UNSURE):
            self._press(self._class_keys[label])
            self._chosen = label
        mouse, keyboard = self._tab.page.mouse, self._tab.page.keyboard
        button = "right" if label == UNSURE else "left"
        if in_all:
            keyboard.down("Control")
        points = [middle_of(self._boxes[frame], cell) for cell in path]
        mouse.move(*points[0])
        mouse.down(button=button)
        for point in points[1:]:
            mouse.move(*point)
        mouse.up(button=button)
        if in_all:
            keyboard.up("Control")
        self.actions += 1
        painted = self._boxes if in_all and label != self._clear else [frame]
        self._stroked |= {(one, cell) for one in painted for cell in path}


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
