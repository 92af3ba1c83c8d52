"""The newest picture of a stream: what its reader puts, and its process sends on."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING

from av import VideoFrame

from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.reason import NO_FAULT, Fault
from tokt.inference.sources.cameras.messages import end_unless_called_again

if TYPE_CHECKING:
    from tokt.features.common.arrays import U8

_SILENT_S = 0.7  # without a reading, after which a stream is lost: less than `live_source` waits
_HUNG_S = 10.0  # in one call of a library's, after which the process is ended
_SILENT_GAPS = 3  # of the time between two readings


class StreamLostError(Exception):
    """A stream that has ended or cannot be had, in words; it is tried again."""


@dataclass(frozen=True)
class Reading:
    """One moment of a stream: its picture, or why there is none.

    Times are in seconds. An array is gray (height, width) or in BGR order (height, width, 3).
    """

    picture: VideoFrame | U8 | None
    arrived: float  # or would have, had nothing held it up: `SYSTEM_CLOCK.monotonic`
    fault: Fault = NO_FAULT
    taken_s: float | None = None  # by the sender's clock of any zero
    captured_t: float | None = None  # since 1970, where the sender tells its time of day


class NewestReading:
    """One place: a reading that nobody has taken gives way to the next one, and is counted."""

    def __init__(self, stopped: threading.Event | None = None) -> None:
        self._changed = threading.Condition()
        self._reading: Reading | None = None
        self._taken_s = -math.inf
        self._count = 0
        self.stopped = stopped or threading.Event()
        self.last_put = SYSTEM_CLOCK.monotonic()
        self._gaps_s = 0.0, 0.0
        self.lost = ""  # why the stream is being looked for again

    def put(self, reading: Reading) -> None:
        """Take the next one; not a picture that comes after one taken later, which was shown."""
        taken_s = reading.taken_s
        if taken_s is not None:
            if self._taken_s - 1.0 < taken_s < self._taken_s:
                return
            self._taken_s = taken_s
        with self._changed:
            self._count += 1
            self._reading, self.lost, now = reading, "", SYSTEM_CLOCK.monotonic()
            self._gaps_s = self._gaps_s[1], now - self.last_put
            self.last_put = now
            self._changed.notify()

    def take(self, wait_s: float) -> tuple[int, Reading] | None:
        """The newest and its number, waiting for one; None if there is none yet."""
        with self._changed:
            self._changed.wait_for(lambda: self._reading is not None, wait_s)
            reading, self._reading = self._reading, None
            return None if reading is None else (self._count, reading)

    def silent_s(self, now: float) -> float:
        """Seconds for which nothing has come; 0 while the next one may still be on its way."""
        silent_s = now - self.last_put
        return silent_s if silent_s > max(_SILENT_S, _SILENT_GAPS * min(self._gaps_s)) else 0.0

    def alive(self) -> None:
        """The reader has not hung; asked for by it, on the process's first thread."""
        end_unless_called_again(_HUNG_S)
