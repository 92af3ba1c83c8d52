"""A frame, checks of its shape, the mark of its pixels that logs carry, and what a source is.

A source delivers frames in order, and a frame that cannot be read as a frame with the reason
instead of a picture: it never raises for one, and never leaves one out.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.extractors.frame_pictures import FramePictures, SharedPictures
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.features.frames.view_mask import CameraMasks, ViewMask

from .reason import NO_FAULT, Fault, Reason

MANY_MISSED = 1_000_000
"""Frames missed, where nobody knows how many."""

MARK_STEP_ROWS = 32
"""Rows from one that `pixel_mark` looks at to the next: 0.07 ms for 1360x1024 in colour, 0.03 ms
gray, where the loop can spare less than 0.1 ms."""


@dataclass(frozen=True)
class Frame:
    """One moment of the mission, as the cameras gave it."""

    number: int
    t: float  # seconds since 1970 (UTC) when the source delivered it
    # Shape (height, width) or (height, width, 3); None where there is no picture.
    left: U8 | None
    right: U8 | None
    left_fault: Fault = NO_FAULT  # why there is none; empty where there is one
    right_fault: Fault = NO_FAULT
    missed: int = 0  # frames between the one delivered before and this one that were not delivered
    # Whether `t` tells frames' times apart as they were taken: live, or replayed at a rate. As fast
    # as they can be read they only tell how fast the disk is.
    timed: bool = False
    # The clock's `monotonic` when it reached this process: what its age is counted from, as the
    # time of day may be set back. None where it has no age.
    arrived: float | None = None
    # Seconds since 1970 (UTC) when it was taken, by the clock of the camera or of its server; None
    # where that does not tell.
    captured_t: float | None = None
    # What is no view of the pictures, which are as the cameras gave them.
    masks: CameraMasks | None = None
    file: str | None = None  # the left picture's file name, where it came out of a file of its own
    # What was made of its pictures so far, for whoever looks at them next.
    shared: SharedPictures = field(default_factory=SharedPictures, repr=False, compare=False)

    def pictures(self, side: str, grid: Grid, threads: int = 1) -> FramePictures:
        """Pictures of one side, ``"left"`` or ``"right"``, which has one, on a grid."""
        return self.shared.of(getattr(self, side), grid, threads)

    def small_gray(self, side: str) -> U8 | None:
        """One side in gray, `DEFAULT_GRID` wide; None where it has no picture of a camera's shape.

        Masks cover it as they do in `covered`.
        """
        picture = getattr(self.covered, side)
        if picture is None or shape_fault(picture):
            return None
        pictures = self.covered.pictures(side, DEFAULT_GRID)
        return pictures.rounded if pictures.of_a_camera else None

    @cached_property
    def _covered(self) -> Frame:
        assert self.masks is not None
        left, right = (
            picture
            if picture is None or mask is None or shape_fault(picture)
            else mask.cover(picture)
            for picture, mask in ((self.left, self.masks.left), (self.right, self.masks.right))
        )
        return replace(self, left=left, right=right)

    @property
    def covered(self) -> Frame:
        """The frame as detectors look at it: what is no view is covered in its pictures."""
        # A frame that kept itself would keep its pictures until garbage is collected.
        return self._covered if self.masks else self

    def mask(self, side: str) -> ViewMask | None:
        """What is no view on one side, ``"left"`` or ``"right"``."""
        return None if self.masks is None else self.masks.of(side)


class Source(Protocol):
    """Something that delivers frames."""

    @property
    def live(self) -> bool:
        """Whether frames come in real time.

        The loop then judges the latest and leaves out those that it has no time for; otherwise it
        judges every one.
        """

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order, until there are no more or `stop` was called."""

    def stop(self) -> None:
        """Deliver no further frame; may be called from a signal handler."""


def pixel_mark(picture: U8) -> str:
    """A short checksum by which a log tells later whether a picture's pixels are still the same.

    CRC-32 over the shape and every 32nd row, from the 16th on, as eight hexadecimal digits. A
    picture of uint8, shape (height, width) or (height, width, 3), that was stored anew, resized or
    exchanged has another mark; one in which a few pixels were painted over may not.
    """
    first = min(MARK_STEP_ROWS // 2, len(picture) // 2)
    rows = np.ascontiguousarray(picture[first::MARK_STEP_ROWS])
    return f"{zlib.crc32(rows.data, zlib.crc32(repr(picture.shape).encode())):08x}"


def shape_fault(frame: U8) -> Fault:
    """Why an array is no picture, uint8 (height, width) or (height, width, 3); or nothing."""
    picture = frame.ndim == 2 or (frame.ndim == 3 and frame.shape[2] == 3)
    if frame.dtype != np.uint8 or not picture or 0 in frame.shape:
        words = (
            f"the frame is {frame.dtype} of shape {frame.shape}: no picture of 8 bits (uint8), "
            "gray (height, width) or BGR (height, width, 3)"
        )
        return Fault(Reason.WRONG_SIZE, words)
    return NO_FAULT


def pair_shape_fault(frame: Frame, frame_size: tuple[int, int]) -> Fault:
    """Why a pair cannot be matched: a picture is missing, or not of the calibration's size.

    Empty where it can. The size is width, height in pixels.
    """
    if frame.left is None:
        return frame.left_fault or Fault(Reason.MISSING, "there is no left frame")
    if frame.right is None:
        return frame.right_fault or Fault(Reason.MISSING, "there is no right frame")
    for side, picture in (("left", frame.left), ("right", frame.right)):
        fault = shape_fault(picture)
        if fault:
            return fault.about(side)
        height, width = picture.shape[:2]
        if (width, height) != frame_size:
            expected = "x".join(map(str, frame_size))
            words = f"the {side} frame is {width}x{height}, the calibration is for {expected}"
            return Fault(Reason.WRONG_SIZE, words)
    return NO_FAULT
