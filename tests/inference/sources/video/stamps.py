"""A file in which one process notes when a picture went into the encoder, and others read it.

Of the standard library alone: the system's Python, which has GStreamer, runs it too.
"""

import mmap
import struct
from pathlib import Path

NUMBERS = 1 << 20
_ENTRY = struct.Struct("d")


class Stamps:
    """The monotonic time of each picture's number, which is the same clock for all processes."""

    def __init__(self, path: Path | str) -> None:
        path = Path(path)
        if not path.exists():
            with path.open("wb") as made:
                made.truncate(NUMBERS * _ENTRY.size)
        with path.open("r+b") as opened:
            self._map = mmap.mmap(opened.fileno(), 0)

    def note(self, number: int, at: float) -> None:
        """Picture `number` goes into the encoder."""
        _ENTRY.pack_into(self._map, number % NUMBERS * _ENTRY.size, at)

    def of(self, number: int) -> float | None:
        """When it did; None if it has not yet."""
        at: float = _ENTRY.unpack_from(self._map, number % NUMBERS * _ENTRY.size)[0]
        return at or None

    def last(self) -> int:
        """The last number that went in, -1 before the first; numbers are noted in order."""
        low, high = -1, NUMBERS - 1
        while low < high:
            middle = (low + high + 1) // 2
            low, high = (middle, high) if self.of(middle) else (low, middle - 1)
        return low
