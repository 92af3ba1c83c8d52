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

from .clock import Clock
from .disk_budget import DiskBudget
from .frame_line import frame_line
from .policy import Judgement
from .recording import Encoded, RecordedFrame, RecordingFolder
from .report import Report
from .sources import Frame

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
class Shot:
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
        """What it holds of the memory."""
        pictures = (self.frame.left, self.frame.right)
        held = sum(picture.nbytes for picture in pictures if picture is not None)
        return held + _BESIDE_PICTURES_BYTES

    def recorded(self, run: str, moment: int) -> RecordedFrame:
        """What goes to disk."""
        sides = {"left": self.frame.left, "right": self.frame.right}
        pictures = {side: picture for side, picture in sides.items() if picture is not None}
        line = frame_line(run, self.frame, self.judgement, self.report)
        return RecordedFrame(self.frame.number, moment, pictures, {**line, "judged": self.judged})


class RecordingWriter:
    """Write shots in the order they are put, beside the loop.

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
        Shots that did not get there.
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
        self._queue: deque[tuple[Shot, int] | Mapping[str, Any]] = deque()
        self._held_bytes = 0
        self._changed = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run_thread, name="tokt recorder", daemon=True)
        self._thread.start()

    @property
    def held_bytes(self) -> int:
        """Memory of the shots that wait, and of the one that is written."""
        return self._held_bytes

    def put(self, shot: Shot, moment: int) -> None:
        """Have a shot written."""
        with self._changed:
            self._queue.append((shot, moment))
            self._held_bytes += shot.memory_bytes
            self._changed.notify()

    def leave_out(self, fault: str) -> bool:
        """Count a shot that cannot be put; always False."""
        with self._changed:
            self.dropped += 1
            self.fault = fault
        return False

    def tell(self, line: Mapping[str, Any]) -> None:
        """Have an event's line written before the next shot's."""
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

    def _record(self, shot: Shot, moment: int) -> None:
        try:
            fault = self._write(shot, moment)
        except OSError as error:
            fault = error.strerror or str(error)
        except ValueError as error:
            fault = str(error)
        with self._changed:
            self.fault = fault
            self.dropped += bool(fault)
            self._held_bytes -= shot.memory_bytes

    def _note(self, line: Mapping[str, Any]) -> None:
        try:
            self._folder.tell(line)
        except (ValueError, TypeError) as error:
            self.fault = f"event {line.get('event')} is no JSON: {error}"

    def _write(self, shot: Shot, moment: int) -> str:
        """Why the shot is not on disk, or an empty string."""
        encoded = self._folder.encode(shot.recorded(self._run, moment))
        if not self._make_room(encoded):
            return NO_ROOM
        if not self._budget.keeps_reserve(encoded.disk_bytes):
            return RESERVE
        self._folder.write(encoded)
        self._budget.used_bytes += encoded.disk_bytes
        self.frames += 1
        self.written_bytes += encoded.disk_bytes
        return ""

    def _make_room(self, encoded: Encoded) -> bool:
        """Whether the folder may hold one more, once older moments of this run have gone."""
        lacking = self._budget.lacking(encoded.disk_bytes)
        if lacking <= 0:
            return True
        spare = _SPARE_PART * self._budget.most_bytes
        freed = self._folder.remove_oldest(lacking + spare, encoded.moment)
        self._budget.used_bytes -= freed
        self.removed_bytes += freed
        now = self._clock.monotonic()
        if freed < lacking and now - self._counted_s > _COUNT_S:
            self._counted_s = now
            self._budget.count()
            self._budget.used_bytes += self._folder.lines_bytes  # they count twice
        return self._budget.lacking(encoded.disk_bytes) <= 0
