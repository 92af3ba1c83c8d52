"""From "reproduce these labels" to the shortest list of page actions it finds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from .page import FRAME, FREE, NONE, SHEET, Labels, Page, PageAction, PageSuggestions
from .strokes import clicks, drags

_MAX_ORDERS = 24
Order = tuple[int, ...]
_Painted = list[tuple[int, PageAction]]
"""Class and ``paint`` action of each click or drag."""


@dataclass(frozen=True)
class LabellingTask:
    """Labels to reproduce.

    Parameters
    ----------
    target : array of int16, shape (n_frames, n_cells)
        Class indices; `FREE` where nobody minds.
    grid : (int, int)
        Rows and columns.
    clear : int
        The class that the page's "rest" key gives.
    sheet_frames : int
        Frames on one page of the contact sheet.
    """

    target: Labels
    grid: tuple[int, int]
    clear: int
    sheet_frames: int


@dataclass(frozen=True)
class Tools:
    """What of the page a person uses.

    Parameters
    ----------
    drags : bool
        One stroke through many patches counts as one action; without, each patch is a click.
    copying : bool
        Copy the labels of the frame before, and paint the same patches in all frames shown.
    sheet : bool
        Work on the contact sheet; without, in the frame's own view only.
    """

    drags: bool
    copying: bool
    sheet: bool


class ActionPlanner:
    """Finds the actions for one task: frame by frame or sheet by sheet, whichever is shorter.

    It is greedy from one frame or sheet to the next, and tries all orders of painting the
    classes. A rectangle of one class lies inside one connected area, which a drag paints just as
    well, so there is no action for it.
    """

    def __init__(self, task: LabellingTask, tools: Tools) -> None:
        self._task, self._tools = task, tools

    def plan(self, suggestions: PageSuggestions | None) -> list[PageAction]:
        """Actions that give the target's labels, from a page without any."""
        ways = [self._frame_by_frame(self._page(FRAME, suggestions))]
        if self._tools.sheet:
            ways.append(self._sheet_by_sheet(self._page(SHEET, suggestions)))
        return min(ways, key=len)

    def _page(self, view: str, suggestions: PageSuggestions | None) -> Page:
        labels = np.full(self._task.target.shape, NONE, np.int16)
        return Page(labels, suggestions, self._task.clear, self._task.sheet_frames, view)

    def _sheet_by_sheet(self, page: Page) -> list[PageAction]:
        way: list[PageAction] = [PageAction("sheet")]
        count, size = len(self._task.target), self._task.sheet_frames
        for first in range(0, count, size):
            step = [] if page.frame == first else [PageAction("next")]
            frames = range(first, min(first + size, count))
            best = min(self._ways_of(page, frames, step), key=len)
            for action in best:
                page.perform(action)
            way += best
        return way

    def _frame_by_frame(self, page: Page) -> list[PageAction]:
        way: list[PageAction] = []
        for frame in range(len(self._task.target)):
            step = [] if page.frame == frame else [PageAction("next")]
            best = min(self._ways_of(page, range(frame, frame + 1), step), key=len)
            for action in best:
                page.perform(action)
            way += best
        return way

    def _ways_of(
        self, page: Page, frames: range, step: list[PageAction]
    ) -> Iterator[list[PageAction]]:
        """All ways to label these frames that are considered, with what the page shows or not."""
        plain = tuple(step)
        # In the frame's view accepting goes on to the next frame, so it comes first among equals.
        begun: list[tuple[tuple[PageAction, ...], tuple[str, ...]]] = []
        if page.suggestions is not None:
            begun.append((plain, ("accept", "rest")))
        begun.append((plain, ("rest",)))
        if self._tools.copying and page.view == FRAME and frames.start:
            begun.append(((*plain, PageAction("copy")), ("accept", "rest")))
        alike = (False, True) if self._tools.copying and len(frames) > 1 else (False,)
        for order in self._orders(frames, page.chosen):
            for start, keys in begun:
                for paint_alike in alike:
                    yield self._way(page, frames, start, order, keys, paint_alike)

    def _orders(self, frames: range, chosen: int) -> Iterator[Order]:
        """Orders of painting to try: all of them for a few classes, else one."""
        present = [int(label) for label in np.unique(self._task.target[frames]) if label != FREE]
        first = sorted(present, key=lambda label: (label != chosen, label))
        every = list(permutations(first))
        yield from every if len(every) <= _MAX_ORDERS else [tuple(first)]

    def _way(
        self,
        page: Page,
        frames: range,
        start: tuple[PageAction, ...],
        order: Order,
        keys: tuple[str, ...],
        alike: bool,
    ) -> list[PageAction]:
        """One way: all of one class, then the next class, then a key for what is left."""
        trial = page.clone()
        for action in start:
            trial.perform(action)
        painted: _Painted = self._paint_alike(trial, frames, order) if alike else []
        for frame in frames:
            holds = self._would_hold(trial, frame, "accept" in keys)
            for label, action in self._strokes(frame, holds, order):
                trial.labels[frame, list(action.path)] = label
                painted.append((label, action))
        painted.sort(key=lambda stroke: order.index(stroke[0]))
        return [*start, *_with_choices(painted, page.chosen), *self._fill(trial, frames, keys)]

    def _paint_alike(self, page: Page, frames: range, order: Order) -> _Painted:
        """Strokes over patches of one class in all frames shown, painted in all at once."""
        painted: _Painted = []
        target = self._task.target[frames]
        for label in order:
            may = ((target == label) | (target == FREE)).all(axis=0)
            need = may & (target == label).any(axis=0) & (label != self._task.clear)
            for path in self._paths(need, may):
                painted.append((label, PageAction("paint_all", frames.start, path)))
                page.labels[frames.start : frames.stop, list(path)] = label
        return painted

    def _strokes(self, frame: int, holds: Labels, order: Order) -> _Painted:
        """What must be painted where `holds` is not the target, class after class."""
        target = self._task.target[frame]
        wrong = (holds != target) & (target != FREE)
        found: _Painted = []
        for place, label in enumerate(order):
            # Patches that a later class covers anyway may be crossed.
            covered = wrong & np.isin(target, order[place + 1 :])
            may = (target == label) | (target == FREE) | covered
            paths = self._paths(wrong & (target == label), may)
            found += [(label, PageAction("paint", frame, path)) for path in paths]
        return found

    def _paths(self, need: np.ndarray, may: np.ndarray) -> list[tuple[int, ...]]:
        grid = self._task.grid
        if not self._tools.drags:
            return clicks(need.reshape(grid))
        return drags(need.reshape(grid), may.reshape(grid))

    def _would_hold(self, page: Page, frame: int, accepted: bool) -> Labels:
        """What a frame ends with if nothing is painted any more: suggestions, then water."""
        labels = page.labels[frame]
        suggested = page.suggested(frame) if accepted else None
        if suggested is not None:
            labels = np.where(labels == NONE, suggested, labels)
        return np.where(labels == NONE, self._task.clear, labels).astype(np.int16)

    def _fill(self, page: Page, frames: range, keys: tuple[str, ...]) -> list[PageAction]:
        """The keys that are needed after painting, each only where it changes something."""
        target = self._task.target[frames]
        way: list[PageAction] = []
        for key in keys:
            missing = (page.labels[frames] != target) & (target != FREE)
            if missing.any():
                way.append(PageAction(key))
                page.perform(way[-1])
        return way


def _with_choices(painted: _Painted, chosen: int) -> list[PageAction]:
    """The strokes with a class key before each change of class."""
    way: list[PageAction] = []
    for label, action in painted:
        if label != chosen:
            way.append(PageAction("choose", label=label))
            chosen = label
        way.append(action)
    return way
