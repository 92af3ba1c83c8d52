"""The thread that writes a recording: PNGs, room on the disk, lines.

Two cores have the loop to run as well: it runs at a lower priority, and OpenCV encodes without
holding Python's lock.
"""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tokt.inference.clock import Clock
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import Judgement
from tokt.inference.report import Report

from .disk_budget import DiskBudget
from .frame_line import frame_line
from .recording import EncodedFrame, RecordedFrame, RecordingFolder

BEHIND = "the disk is slower than the frames that are to be recorded"
NO_ROOM = "the folder is full of earlier recordings: copy them ashore and remove them"
REPEATED = "the source gives numbers to frames that earlier ones have"
RESERVE = "the disk has less than its reserve free"

_BESIDE_PICTURES_BYTES = 4000
_SPARE_PART = 0.05
"""Of the folder, made free at once, so that the lines are not written anew for every frame."""
_COUNT_S = 60.0
_CLOSE_S = 20.0
_LAST_S = 2.0
_NICENESS = 10


@dataclass(frozen=True)
class HeldFrame:
    """A judged frame, as long as it may still be recorded.

    Parameters
    ----------
    frame : Frame
    judgement : Judgement
        Without its arrays.
    report : Report
    judged : int
        How many frames the run had judged with it.
    """

    frame: Frame
    judgement: Judgement
    report: Report
    judged: int

    @property
    def memory_bytes(self) -> int:
        """Bytes of memory that it holds."""
        pictures = (self.frame.left, self.frame.right)
        held = sum(picture.nbytes for picture in pictures if picture is not None)
        return held + _BESIDE_PICTURES_BYTES

    def recorded(self, run: str, clip: int) -> RecordedFrame:
        """The frame as it goes to disk."""
        sides = {"left": self.frame.left, "right": self.frame.right}
        pictures = {side: picture for side, picture in sides.items() if picture is not None}
        line = frame_line(run, self.frame, self.judgement, self.report)
        return RecordedFrame(self.frame.number, clip, pictures, {**line, "judged": self.judged})


class RecordingWriter:
    """Write frames in the order they are put, beside the loop.

    Parameters
    ----------
    folder : RecordingFolder
    run : str
    budget : DiskBudget
    clock : Clock

    Attributes
    ----------
    frames : int
        On disk, those removed since included.
    written_bytes, removed_bytes : int
        What they took of the disk, and what was removed to make room.
    dropped : int
        Frames that did not get there.
    fault : str
        Why the last one did not; empty when one does.
    """

    def __init__(self, folder: RecordingFolder, run: str, budget: DiskBudget, clock: Clock) -> None:
        self.frames = self.written_bytes = self.removed_bytes = self.dropped = 0
        self.fault = ""
        self._folder = folder
        self._run = run
        self._budget = budget
        self._clock = clock
        self._counted_s = clock.monotonic()
        self._queue: deque[tuple[HeldFrame, int] | Mapping[str, Any]] = deque()
        self._held_bytes = 0
        self._changed = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run_thread, name="tokt recorder", daemon=True)
        self._thread.start()

    @property
    def held_bytes(self) -> int:
        """Memory of the frames that wait, and of the one that is written."""
        return self._held_bytes

    def put(self, held: HeldFrame, clip: int) -> None:
        """Have a frame written."""
        with self._changed:
            self._queue.append((held, clip))
            self._held_bytes += held.memory_bytes
            self._changed.notify()

    def leave_out(self, fault: str) -> bool:
        """Count a frame that cannot be put; always False."""
        with self._changed:
            self.dropped += 1
            self.fault = fault
        return False

    def tell(self, line: Mapping[str, Any]) -> None:
        """Have an event's line written before the next frame's."""
        with self._changed:
            self._queue.append(line)
            self._changed.notify()

    def close(self) -> None:
        """Write what waits, though not for ever."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(_CLOSE_S)
        with self._changed:
            self.dropped += sum(isinstance(item, tuple) for item in self._queue)
            self._queue.clear()
        self._thread.join(_LAST_S)

    def _run_thread(self) -> None:
        if sys.platform == "linux":
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._queue or self._closing)
                if not self._queue:
                    return
                item = self._queue.popleft()
            if isinstance(item, tuple):
                self._record(*item)
            else:
                self._note(item)

    def _record(self, held: HeldFrame, clip: int) -> None:
        try:
            fault = self._write(held, clip)
        except OSError as error:
            fault = error.strerror or str(error)
        except ValueError as error:
            fault = str(error)
        with self._changed:
            self.fault = fault
            self.dropped += bool(fault)
            self._held_bytes -= held.memory_bytes

    def _note(self, line: Mapping[str, Any]) -> None:
        try:
            self._folder.tell(line)
        except (ValueError, TypeError) as error:
            self.fault = f"event {line.get('event')} is no JSON: {error}"

    def _write(self, held: HeldFrame, clip: int) -> str:
        """Why the frame is not on disk, or an empty string."""
        encoded = self._folder.encode(held.recorded(self._run, clip))
        if not self._make_room(encoded):
            return NO_ROOM
        if not self._budget.keeps_reserve(encoded.disk_bytes):
            return RESERVE
        self._folder.write(encoded)
        self._budget.used_bytes += encoded.disk_bytes
        self.frames += 1
        self.written_bytes += encoded.disk_bytes
        return ""

    def _make_room(self, encoded: EncodedFrame) -> bool:
        """Whether the folder may hold one more, once older clips of this run have gone."""
        lacking = self._budget.lacking(encoded.disk_bytes)
        if lacking <= 0:
            return True
        spare = _SPARE_PART * self._budget.most_bytes
        freed = self._folder.remove_oldest(lacking + spare, encoded.clip)
        self._budget.used_bytes -= freed
        self.removed_bytes += freed
        now = self._clock.monotonic()
        if freed < lacking and now - self._counted_s > _COUNT_S:
            self._counted_s = now
            self._budget.count()
            self._budget.used_bytes += self._folder.lines_bytes  # they count twice
        return self._budget.lacking(encoded.disk_bytes) <= 0
