"""Marks that never move, such as a burned-in clock, told with the words that mask them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tokt.features.common.arrays import Bools
from tokt.features.frames.fixed_marks import FixedMarks
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.view_mask import CAMERAS, boxes_of, mask_options
from tokt.inference.clock import Clock
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import Observer
from tokt.inference.report import Event, Report
from tokt.inference.verdict import OBSTACLE

FEWEST_PICTURES = 40
"""Of 30 or more in a row of the sea trial none has marks, wherever they begin."""
STEP_S = 0.5
"""Seconds between two pictures that are looked at, where frames have times."""


class FixedMarksWatch(Observer):
    """Tell where marks never move: the event is ``fixed_marks``, once for each patch.

    `tell` is given the event; its fields are the camera, the boxes as `ViewMask` has them, and how
    many of the frames were called an obstacle up to then.
    """

    def __init__(self, clock: Clock, tell: Callable[[Event], None]) -> None:
        self._clock, self._tell = clock, tell
        self._marks = {camera: FixedMarks() for camera in CAMERAS}
        none = np.zeros((DEFAULT_GRID.rows, DEFAULT_GRID.cols), bool)
        self._told: dict[str, Bools] = {camera: none for camera in CAMERAS}
        self._frames = self._obstacles = 0
        self._last_s = -STEP_S

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """Look at the frame's pictures where it is time to; what is masked is covered in them."""
        self._frames += 1
        self._obstacles += report.verdict.status == OBSTACLE
        if frame.timed and 0 <= frame.t - self._last_s < STEP_S:
            return
        self._last_s = frame.t
        for camera, marks in self._marks.items():
            gray = frame.small_gray(camera)
            if gray is None:
                continue
            marks.add(gray)
            if marks.count % FEWEST_PICTURES == 0:
                self._tell_new(camera, marks.patches(DEFAULT_GRID))

    def _tell_new(self, camera: str, marked: Bools) -> None:
        new = marked & ~self._told[camera]
        if not new.any():
            return
        self._told[camera] = marked | self._told[camera]
        boxes = boxes_of(self._told[camera])
        words = (
            f"edges in {int(new.sum())} patches of the {camera} view have never moved, and "
            f"{self._obstacles} of {self._frames} frames were called an obstacle. Mask them if "
            f"they are a clock, a rim or a part of the vehicle: {mask_options(boxes, camera)}"
        )
        fields = {
            "camera": camera,
            "boxes": [list(box) for box in boxes],
            "obstacles": self._obstacles,
            "frames": self._frames,
        }
        self._tell(Event(self._clock.time(), "fixed_marks", words, fields))
