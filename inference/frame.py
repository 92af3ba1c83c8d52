"""A frame, the mark of its pixels that logs carry, and the sources that deliver frames.

A source delivers frames in order, and a frame that cannot be read as a frame with the reason
instead of a picture: it never raises for one, and never leaves one out.
"""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tokt.features.common.arrays import U8

from .reason import NO_FAULT, Fault

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
