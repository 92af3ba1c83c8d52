"""Frame buffers between a source and the loop: every frame in its turn, or only the latest.

::

    source ──> its thread ──> latest frame ──> loop          live: never a queue
                                  │
                                  └─ one that is overtaken is counted, and told as missed
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

from tokt.inference.frame import Frame, Source

_JOIN_S = 2.0


class FrameBuffer(Protocol):
    """A buffer from which the loop takes its next frame."""

    dropped: int
    """Frames left out as newer ones had come."""
    left_out: int
    """Those of them just before the frame that was taken last."""

    @property
    def ended(self) -> bool:
        """Whether there will be no further frame."""

    def take(self, wait_s: float) -> Frame | None:
        """The next frame, or None if there is none yet, or none any more."""

    def close(self) -> None:
        """Take no further frame."""


class EveryFrame:
    """Every frame, as soon as the loop asks for it.

    Parameters
    ----------
    source : Source
    """

    dropped = 0
    left_out = 0

    def __init__(self, source: Source) -> None:
        self._frames: Iterator[Frame] = iter(source)
        self.ended = False

    def take(self, wait_s: float) -> Frame | None:
        """The next frame, however long it takes."""
        frame = next(self._frames, None)
        self.ended = frame is None
        return frame

    def close(self) -> None:
        """Nothing is left to do."""


class LatestFrameBuffer:
    """The latest frame; older ones that were not taken in time are left out.

    Parameters
    ----------
    source : Source
        Read by a thread of its own.
    """

    def __init__(self, source: Source) -> None:
        self.dropped = 0
        self.left_out = 0
        self._overtaken = 0
        self._source = source
        self._changed = threading.Condition()
        self._frame: Frame | None = None
        self._finished = False
        self._fault: Exception | None = None
        self._thread = threading.Thread(target=self._read, name="tokt frames", daemon=True)
        self._thread.start()

    @property
    def ended(self) -> bool:
        """Whether the source has ended and its last frame was taken; not where it has failed."""
        with self._changed:
            return self._finished and self._frame is None and self._fault is None

    def _read(self) -> None:
        try:
            for frame in self._source:
                self._put(frame)
        except Exception as error:  # noqa: BLE001 - raised again in the loop's thread, by `take`
            self._fault = error
        finally:
            with self._changed:
                self._finished = True
                self._changed.notify()

    def _put(self, frame: Frame) -> None:
        with self._changed:
            overtaken = self._frame
            if overtaken is not None:
                self.dropped += 1
                self._overtaken += 1
                frame = replace(frame, missed=frame.missed + overtaken.missed + 1)
            self._frame = frame
            self._changed.notify()

    def take(self, wait_s: float) -> Frame | None:
        """The latest frame, waiting for one.

        Raises
        ------
        Exception
            What the source raised, once its last frame was taken.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._frame is not None or self._finished, wait_s)
            frame, self._frame = self._frame, None
            self.left_out, self._overtaken = self._overtaken, 0
            if frame is None and self._fault is not None:
                raise self._fault
            return frame

    def close(self) -> None:
        """Stop the source and wait for its thread, though not for ever."""
        self._source.stop()
        self._thread.join(_JOIN_S)


def frame_buffer_for(source: Source) -> FrameBuffer:
    """The buffer that fits a source: the latest frame only where it is live."""
    return LatestFrameBuffer(source) if source.live else EveryFrame(source)
