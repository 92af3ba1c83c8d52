"""The labelling page in plain Python: what each key, click and drag does to the labels.

The planner tries its plans out on this, and the tests hold it against the real page. Frames are
counted from 0 in the mission's order, classes by their index in the planner's list of names.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

NONE, FREE = -1, -2
"""No label; and in a target: any label will do, or none."""
FRAME, SHEET = "frame", "sheet"
"""The two views: one frame, and the contact sheet of many."""
MAX_FOLLOWED = 32
"""So many frames back the page looks for what a suggestion follows."""
NEAREST = 5
"""A suggestion follows the frame before if its number is no further away."""

Labels = NDArray[np.int16]


@dataclass(frozen=True)
class PageAction:
    """One key press, click or drag.

    Parameters
    ----------
    kind : str
        ``choose`` a class, ``paint`` a patch or along a path, ``rest`` of the frame (or of the
        sheet) is clear water, ``accept`` what is suggested in the frame (or on the sheet),
        ``copy`` the frame before, ``next`` frame (or sheet), ``sheet`` shows the sheet;
        ``paint_all`` paints in all frames of the sheet.
    frame : int
        For ``paint`` and ``paint_all``.
    path : tuple of int
        For these: the patches, one after the other.
    label : int
        For ``choose``.
    """

    kind: str
    frame: int = NONE
    path: tuple[int, ...] = ()
    label: int = NONE


@dataclass(frozen=True)
class Kinds:
    """What the planner's class indices mean.

    Parameters
    ----------
    obstacles : tuple of bool
        For each class whether it is an obstacle; the last one is ``unsure`` and counts as none.
    clear : int
        The class that the page's "rest" key gives, and what a model's "clear" stands for.
    obstacle : int
        What a model's "obstacle" stands for.
    """

    obstacles: tuple[bool, ...]
    clear: int
    obstacle: int

    @property
    def unsure(self) -> int:
        """The index of ``unsure``."""
        return len(self.obstacles) - 1


@dataclass(frozen=True)
class HeldLabels:
    """What holds in a frame: labels, and where there are none what is suggested.

    Parameters
    ----------
    labels : array of int16, shape (n_cells,)
    mine : array of bool, shape (n_cells,)
        Where that goes back to a label.
    """

    labels: Labels
    mine: NDArray[np.bool_]


@dataclass(frozen=True)
class PageSuggestions:
    """What a model says of every patch, and how the page follows what a person said before.

    Parameters
    ----------
    values : array of float64, shape (n_frames, n_cells)
        Positive where the model sees an obstacle.
    numbers : tuple of int
        The frames' numbers: across a gap nothing is followed.
    kinds : Kinds
    keep : float
        What held in the frame before is kept until the value contradicts it by so much; 0 takes
        the model's word alone.
    """

    values: NDArray[np.float64]
    numbers: tuple[int, ...]
    kinds: Kinds
    keep: float

    def of(self, frame: int, before: HeldLabels | None) -> HeldLabels:
        """What is suggested in a frame, as the head of the page's ``suggest.js`` says."""
        values, kinds = self.values[frame], self.kinds
        alarm = values > 0
        said = np.where(alarm, kinds.obstacle, kinds.clear).astype(np.int16)
        gap = frame and self.numbers[frame] - self.numbers[frame - 1]
        if before is None or not self.keep or not 0 < gap <= NEAREST:
            return HeldLabels(said, np.zeros(len(said), bool))
        obstacle, sure = np.array(kinds.obstacles)[before.labels], np.abs(values)
        unsure = before.labels == kinds.unsure
        contradicted = np.where(unsure, sure > self.keep, (obstacle != alarm) & (sure >= self.keep))
        contradicted |= ~before.mine & alarm & ~obstacle
        kept = (before.labels != NONE) & ~contradicted
        return HeldLabels(np.where(kept, before.labels, said), kept & before.mine)


@dataclass
class Page:
    """The state of the page and of the store behind it.

    Parameters
    ----------
    labels : array of int16, shape (n_frames, n_cells)
    suggestions : PageSuggestions or None
    clear : int
        The class that ``rest`` gives.
    sheet_frames : int
        Frames on one page of the contact sheet.
    view : str
        `FRAME` or `SHEET`.
    frame : int
        The frame shown, or the first one of the sheet shown.
    chosen : int
        The class that painting gives.
    """

    labels: Labels
    suggestions: PageSuggestions | None
    clear: int
    sheet_frames: int
    view: str = FRAME
    frame: int = 0
    chosen: int = NONE
    copied: dict[int, Labels] = field(default_factory=dict)

    def clone(self) -> Page:
        """A copy to try things out on."""
        return replace(self, labels=self.labels.copy(), copied=dict(self.copied))

    @property
    def shown(self) -> range:
        """The frames on show."""
        count = self.sheet_frames if self.view == SHEET else 1
        return range(self.frame, min(self.frame + count, len(self.labels)))

    def suggested(self, frame: int) -> Labels | None:
        """What the page suggests for a frame: a copy of the one before, or the model's word."""
        if frame in self.copied:
            return self.copied[frame]
        if self.suggestions is None:
            return None
        held: HeldLabels | None = None
        for number in range(max(0, frame - MAX_FOLLOWED), frame):
            own = self.labels[number] != NONE
            if held is None and not own.any():
                continue  # nothing is followed that goes back to no label
            said = self.suggestions.of(number, held)
            held = HeldLabels(np.where(own, self.labels[number], said.labels), own | said.mine)
            if self.suggestions.numbers[number + 1] - self.suggestions.numbers[number] > NEAREST:
                held = None
        return self.suggestions.of(frame, held).labels

    def perform(self, action: PageAction) -> None:
        """Do what the page does. Raises ValueError for an action that it does not know."""
        kind = action.kind
        if kind == "choose":
            self.chosen = action.label
        elif kind == "paint":
            self.labels[action.frame, list(action.path)] = self.chosen
        elif kind == "paint_all":
            self.labels[self.shown.start : self.shown.stop, list(action.path)] = self.chosen
        elif kind == "rest":
            self._rest()
        elif kind == "accept":
            self._accept()
        elif kind == "copy":
            self.copied[self.frame] = self.labels[self.frame - 1].copy()
        elif kind == "next":
            self._step()
        elif kind == "sheet":
            self.view = SHEET
        else:
            raise ValueError(f"no action {kind!r}")

    def _rest(self) -> None:
        for frame in self.shown:
            self.labels[frame, self.labels[frame] == NONE] = self.clear
        if self.view == SHEET:
            self._step()

    def _accept(self) -> None:
        # What one frame suggests must not yet follow what the others are given by this key.
        suggested = {frame: self.suggested(frame) for frame in self.shown}
        for frame, labels in suggested.items():
            if labels is not None:
                taken = self.labels[frame] == NONE
                self.labels[frame, taken] = labels[taken]
            self.copied.pop(frame, None)
        self._step()

    def _step(self) -> None:
        if self.shown.stop < len(self.labels):
            self.frame = self.shown.stop
