"""Record frames around detections while the runtime works, for labelling them later.

::

    loop ──> frames of the last seconds ──(a clip opens)───> queue ──> thread: PNG, disk
             └──────────── never more than memory_mb together ─────┘

The loop only passes frames on: where the disk is slower than the cameras, frames are left out and
counted. The folder holds at most `most_mb`. To make room only what this very run has recorded is
removed, its oldest clips first, as nobody has labelled those yet; what earlier runs left there
is never touched, and once it fills the folder nothing more is recorded, which is said.
"""

import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tokt.features.common.atomic import locked
from tokt.features.common.errors import ToktError, counted, os_errors_as, os_words
from tokt.features.frames.mask_file import mask_file
from tokt.features.frames.view_mask import write_masks
from tokt.inference.clock import Clock
from tokt.inference.config import RecordingConfig
from tokt.inference.frame import Frame
from tokt.inference.policy.object_naming import NAMED
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import Observer
from tokt.inference.report import MODEL, START, Event, Report

from .clip_trigger import ClipTrigger
from .log import file_id
from .recording import DiskBudget, EncodedFrame, RecordingFolder
from .run_log import event_line, frame_line

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
_LOOK_S = 0.5  # between two looks at a folder that nothing is written to
_NICENESS = 10


@dataclass(frozen=True)
class HeldFrame:
    """A judged frame, as long as it may still be recorded."""

    frame: Frame
    judgement: Judgement  # without its arrays
    report: Report
    judged: int  # how many frames the run had judged with it

    @property
    def memory_bytes(self) -> int:
        """Bytes of memory that it holds."""
        pictures = (self.frame.left, self.frame.right)
        held = sum(picture.nbytes for picture in pictures if picture is not None)
        return held + _BESIDE_PICTURES_BYTES


class RecordingWriter:
    """Write frames in the order they are put, beside the loop.

    Two cores have the loop to run as well: it runs at a lower priority, and OpenCV encodes without
    holding Python's lock.

    `frames` and `written_bytes` are on disk, or were before they were removed to make room
    (`removed_bytes`); those `dropped` did not get there, the last one for the reason in `fault`.
    `held_bytes` of memory have those that wait, and the one that is written.
    """

    def __init__(
        self,
        folder: RecordingFolder,
        run: str,
        budget: DiskBudget,
        clock: Clock,
        make_folder: Callable[[], None],
    ) -> None:
        self.frames = self.written_bytes = self.removed_bytes = self.dropped = 0
        self.fault = self._folder_fault = ""
        self._folder = folder
        self._run = run
        self._budget = budget
        self._make_folder = make_folder
        self._clock = clock
        self._counted_s = clock.monotonic()
        self._queue: deque[tuple[HeldFrame, int] | Mapping[str, Any]] = deque()
        self.held_bytes = 0
        self._changed = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run_thread, name="tokt recorder", daemon=True)
        self._thread.start()

    def put(self, held: HeldFrame, clip: int) -> None:
        """Have a frame written."""
        with self._changed:
            self._queue.append((held, clip))
            self.held_bytes += held.memory_bytes
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
                ready = self._changed.wait_for(lambda: self._queue or self._closing, _LOOK_S)
                if ready and not self._queue:
                    return
                item = self._queue.popleft() if ready else None
            if item is None:
                self._look()
                continue
            if isinstance(item, tuple):
                self._record(*item)
                continue
            try:
                self._folder.tell(item)
            except (ValueError, TypeError) as error:
                self.fault = f"event {item.get('event')} is no JSON: {error}"

    def _look(self) -> None:
        """Notice that the recording was taken away, and make its folder anew."""
        fault = ""
        try:
            self._folder.look()
            self._make_folder()
        except OSError as error:
            fault = os_words(error)
        except ToktError as error:
            fault = str(error)
        if fault or self._folder_fault:
            self.fault = fault
        self._folder_fault = fault

    def _record(self, held: HeldFrame, clip: int) -> None:
        try:
            fault = self._write(held, clip)
        except OSError as error:
            fault = os_words(error)
        except (ValueError, ToktError) as error:
            fault = str(error)
        with self._changed:
            self.fault = fault
            self.dropped += bool(fault)
            self.held_bytes -= held.memory_bytes

    def _write(self, held: HeldFrame, clip: int) -> str:
        """Why the frame is not on disk, or an empty string."""
        frame = held.frame
        sides = {"left": frame.left, "right": frame.right}
        pictures = {side: picture for side, picture in sides.items() if picture is not None}
        line = frame_line(self._run, frame, held.judgement, held.report)
        line["judged"] = held.judged
        self._make_folder()
        encoded = self._folder.encode(frame.number, clip, pictures, line)
        if not self._make_room(encoded):
            return NO_ROOM
        if not self._budget.keeps_reserve(encoded.disk_bytes):
            return RESERVE
        self._folder.write(encoded)
        if frame.masks and not mask_file(self._folder.folder).exists():
            write_masks(self._folder.folder, frame.masks)
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


RESERVE_MB = 1_000.0
MEMORY_MB = 400.0
"""Frames in memory, those of the last seconds and those that wait for the disk: some 4 s of two
colour cameras of 1360x1024 at 10 frames a second."""

KEPT_EVENTS = frozenset({START, MODEL, NAMED})
"""Events that a replay of the recording needs."""
TRIGGER_EVENTS = frozenset({"drift", "shadow_differs"})
"""Events that open a clip."""
RECORDING = "recording"

_LOCK = ".recording.lock"
_LOCK_WAIT_S = 0.3
_TELL_S = 10.0  # seconds between two events about faults


@dataclass(eq=False)
class Recorder(Observer):
    """Record clips: the frames of the seconds around a detection or a doubt.

    `tell` takes the events ``recording``: that a clip opens, that frames are left out and why, that
    they are recorded again. It is called within `judged`. `clips` counts those that were opened.

    Raises ToktError if the folder cannot be made, another process records into it, or a time or a
    size cannot be.
    """

    folder: Path  # made if it is not there; the recording is its `run` folder
    run: str
    clock: Clock
    before_s: float = RecordingConfig.record_before  # as in `ClipTrigger`
    after_s: float = RecordingConfig.record_after
    most_mb: float = RecordingConfig.record_mb  # as in `DiskBudget`
    reserve_mb: float = RESERVE_MB
    memory_mb: float = MEMORY_MB  # 10^6 bytes of frames in memory
    tell: Callable[[Event], None] | None = None

    def __post_init__(self) -> None:
        self.clips = 0
        self._trigger = ClipTrigger(self.before_s, self.after_s)
        self._before: deque[tuple[float, HeldFrame | Mapping[str, Any]]] = deque()
        self._before_bytes = 0
        self._seq = self._judged = 0
        self._last_number = -1
        self._told_fault = ""
        self._told_taken = 0
        self._told_s = -_TELL_S
        budget = DiskBudget(self.folder, self.most_mb, self.reserve_mb)
        self._opened = ExitStack()
        with os_errors_as(f"cannot record into {self.folder}"):
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock_folder()
        budget.count()  # now that nobody else writes
        recording = RecordingFolder(self.folder / self.run, self.run)
        self._recording = recording
        self.writer = RecordingWriter(
            recording, self.run, budget, self.clock, make_folder=self._make_folder
        )

    def _lock_folder(self) -> None:
        lock = self.folder / _LOCK
        self._opened.enter_context(locked(lock, _LOCK_WAIT_S))
        self._lock_id = file_id(lock)

    def _make_folder(self) -> None:
        """Make the folder again, and lock it, where it was taken away."""
        if file_id(self.folder / _LOCK) != self._lock_id:
            self._opened.close()
            self.folder.mkdir(exist_ok=True)
            self._lock_folder()

    @property
    def fault(self) -> str:  # type: ignore[override]
        """Why frames are not recorded at present."""
        return self.writer.fault

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """Keep the frame, or remember it for a while."""
        self._seq = report.seq
        self._judged += 1
        now = self.clock.monotonic() if frame.arrived is None else frame.arrived
        while self._before and now - self._before[0][0] > self.before_s:
            self._forget_oldest(None)
        keep = self._trigger.should_keep(now, report.verdict)
        bare = Judgement(judgement.verdict, texture_s=judgement.texture_s)
        held = HeldFrame(frame, bare, report, self._judged)
        if frame.number <= self._last_number:
            # It would take an earlier one's name.
            keep = keep and self.writer.leave_out(REPEATED)
        elif keep:
            self._keep(held)
        else:
            self._remember(now, held)
        self._last_number = max(self._last_number, frame.number)
        if keep and self._trigger.opened:
            self.clips += 1
            fields = {"moment": self._trigger.clip, "frame": frame.number}
            words = f"recording frames around frame {frame.number}: {self._trigger.cause}"
            self._say(words, {**fields, "cause": self._trigger.cause})
        self._say_fault()

    def heartbeat(self, report: Report) -> None:
        """Note how many reports there were."""
        self._seq = report.seq

    def event(self, event: Event) -> None:
        """Open a clip for some, write others down."""
        if event.name in TRIGGER_EVENTS:
            self._trigger.request(event.name)
        if event.name not in KEPT_EVENTS:
            return
        line = event_line(self.run, self._seq, event)
        if self._before:
            self._before.append((self._before[-1][0], line))  # keeps its place among the frames
        else:
            self.writer.tell(line)

    def close(self) -> None:
        """Write what waits, for some seconds at most."""
        self.writer.close()
        self._opened.close()

    def _keep(self, held: HeldFrame) -> None:
        flushed = self._trigger.clip if self._trigger.opened else None
        while self._before:
            self._forget_oldest(flushed)
        if self._fits(held.memory_bytes):
            self.writer.put(held, self._trigger.clip)
        else:
            self.writer.leave_out(BEHIND)

    def _remember(self, now: float, held: HeldFrame) -> None:
        self._before.append((now, held))
        self._before_bytes += held.memory_bytes
        while self._before and not self._fits():
            self._forget_oldest(None)

    def _forget_oldest(self, clip: int | None) -> None:
        """Pass what waits longest on: events in any case, a frame if there is a clip for it."""
        _, item = self._before.popleft()
        if not isinstance(item, HeldFrame):
            self.writer.tell(item)
            return
        self._before_bytes -= item.memory_bytes
        if clip is not None:
            self.writer.put(item, clip)

    def _fits(self, more: int = 0) -> bool:
        return self._before_bytes + self.writer.held_bytes + more <= 1e6 * self.memory_mb

    def _say_fault(self) -> None:
        """Tell that frames are left out, or no more, once it has changed; and those taken away."""
        if self._recording.taken > self._told_taken:
            taken = self._recording.taken - self._told_taken
            self._told_taken = self._recording.taken
            words = f"the recording was taken away and restarted: {counted(taken, 'frame')} gone"
            self._say(words, {"taken": taken})
        fault = self.writer.fault
        now = self.clock.monotonic()
        if fault == self._told_fault or now - self._told_s < _TELL_S:
            return
        self._told_fault, self._told_s = fault, now
        words = f"frames are not recorded: {fault}" if fault else "frames are recorded again"
        self._say(words, {"fault": fault, "dropped": self.writer.dropped})

    def _say(self, words: str, fields: dict[str, Any]) -> None:
        if self.tell is not None:
            self.tell(Event(self.clock.time(), RECORDING, words, fields))
