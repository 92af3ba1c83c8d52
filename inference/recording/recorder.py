"""Record frames around detections while the runtime works, for labelling them later.

::

    loop ──> frames of the last seconds ──(a clip opens)───> queue ──> thread: PNG, disk
             └──────────── never more than memory_mb together ─────┘

The loop only passes frames on: where the disk is slower than the cameras, frames are left out and
counted. The folder holds at most `most_mb`. To make room only what this very run has recorded is
removed, its oldest clips first, as nobody has labelled those yet; what earlier runs left there
is never touched, and once it fills the folder nothing more is recorded, which is said.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.features.common.file_lock import locked
from tokt.inference.clock import Clock
from tokt.inference.events import Event
from tokt.inference.frame import Frame
from tokt.inference.observer import Observer
from tokt.inference.policy.policy import Judgement
from tokt.inference.report import Report

from .clip_trigger import ClipPadding, ClipTrigger
from .disk_budget import DiskBudget, DiskLimits
from .frame_line import event_line
from .recording import RecordingFolder
from .run_start import MODEL, START
from .writer import BEHIND, REPEATED, HeldFrame, RecordingWriter

MAX_MB = 10_000.0
RESERVE_MB = 1_000.0
MEMORY_MB = 400.0
"""Frames in memory, those of the last seconds and those that wait for the disk: some 4 s of two
colour cameras of 1360x1024 at 10 frames a second."""

KEPT_EVENTS = frozenset({START, MODEL})
"""Events that a replay of the recording needs."""
TRIGGER_EVENTS = frozenset({"drift", "shadow_differs"})
"""Events that open a clip."""
RECORDING = "recording"

_LOCK = ".recording.lock"
_LOCK_WAIT_S = 0.3
_TELL_S = 10.0
"""Seconds between two events about faults."""


class Recorder(Observer):
    """Record clips: the frames of the seconds around a detection or a doubt.

    Parameters
    ----------
    folder : Path
        The recording is its ``run`` folder, made with the first frame; made if it is not there.
    run : str
    clock : Clock
    padding : ClipPadding, optional
    disk : DiskLimits, optional
    memory_mb : float
        Megabytes (10^6 bytes) of frames in memory.
    tell : callable, optional
        Takes the events ``recording``: that a clip opens, that frames are left out and why, that
        they are recorded again. Called within `judged`.

    Attributes
    ----------
    clips : int
        How many were opened.

    Raises
    ------
    ToktError
        If the folder cannot be made, or another process records into it.
    """

    def __init__(
        self,
        folder: Path,
        run: str,
        clock: Clock,
        padding: ClipPadding | None = None,
        disk: DiskLimits | None = None,
        memory_mb: float = MEMORY_MB,
        tell: Callable[[Event], None] | None = None,
    ) -> None:
        self.clips = 0
        self._run = run
        self._clock = clock
        self._padding = ClipPadding() if padding is None else padding
        self._memory_bytes = 1e6 * memory_mb
        self._tell = tell
        self._trigger = ClipTrigger(self._padding)
        self._before: deque[tuple[float, HeldFrame | Mapping[str, Any]]] = deque()
        self._before_bytes = 0
        self._seq = self._judged = 0
        self._last_number = -1
        self._told_fault = ""
        self._told_s = -_TELL_S
        limits = DiskLimits(MAX_MB, RESERVE_MB) if disk is None else disk
        self._opened = ExitStack()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._opened.enter_context(locked(folder / _LOCK, _LOCK_WAIT_S))
        except OSError as error:
            raise ToktError(f"cannot record into {folder}: {error.strerror or error}") from None
        recording = RecordingFolder(folder / run, run)
        self._writer = RecordingWriter(recording, run, DiskBudget(folder, limits), clock)

    @property
    def frames(self) -> int:
        """Frames on disk, those removed since included."""
        return self._writer.frames

    @property
    def written_bytes(self) -> int:
        """Bytes of disk that these took."""
        return self._writer.written_bytes

    @property
    def removed_bytes(self) -> int:
        """Bytes of disk that were removed to make room."""
        return self._writer.removed_bytes

    @property
    def dropped(self) -> int:
        """Frames of clips that are not on disk: no memory, no room, or a failing disk."""
        return self._writer.dropped

    @property
    def fault(self) -> str:
        """Why frames are being left out at present, or an empty string."""
        return self._writer.fault

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """Keep the frame, or remember it for a while."""
        self._seq = report.seq
        self._judged += 1
        now = self._clock.monotonic() if frame.arrived is None else frame.arrived
        while self._before and now - self._before[0][0] > self._padding.before_s:
            self._forget_oldest(None)
        keep = self._trigger.should_keep(now, report.verdict)
        bare = Judgement(judgement.verdict, texture_s=judgement.texture_s)
        held = HeldFrame(frame, bare, report, self._judged)
        if frame.number <= self._last_number:
            # It would take an earlier one's name.
            keep = keep and self._writer.leave_out(REPEATED)
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
        line = event_line(self._run, self._seq, event)
        if self._before:
            self._before.append((self._before[-1][0], line))  # keeps its place among the frames
        else:
            self._writer.tell(line)

    def close(self) -> None:
        """Write what waits, for some seconds at most."""
        self._writer.close()
        self._opened.close()

    def _keep(self, held: HeldFrame) -> None:
        flushed = self._trigger.clip if self._trigger.opened else None
        while self._before:
            self._forget_oldest(flushed)
        if self._fits(held):
            self._writer.put(held, self._trigger.clip)
        else:
            self._writer.leave_out(BEHIND)

    def _remember(self, now: float, held: HeldFrame) -> None:
        self._before.append((now, held))
        self._before_bytes += held.memory_bytes
        while self._before and not self._fits():
            self._forget_oldest(None)

    def _forget_oldest(self, clip: int | None) -> None:
        """Pass what waits longest on: events in any case, a frame if there is a clip for it."""
        _, item = self._before.popleft()
        if not isinstance(item, HeldFrame):
            self._writer.tell(item)
            return
        self._before_bytes -= item.memory_bytes
        if clip is not None:
            self._writer.put(item, clip)

    def _fits(self, held: HeldFrame | None = None) -> bool:
        more = 0 if held is None else held.memory_bytes
        in_memory = self._before_bytes + self._writer.held_bytes
        return in_memory + more <= self._memory_bytes

    def _say_fault(self) -> None:
        """Tell that frames are left out, or no more, once it has changed."""
        fault = self._writer.fault
        now = self._clock.monotonic()
        if fault == self._told_fault or now - self._told_s < _TELL_S:
            return
        self._told_fault, self._told_s = fault, now
        words = f"frames are not recorded: {fault}" if fault else "frames are recorded again"
        self._say(words, {"fault": fault, "dropped": self.dropped})

    def _say(self, words: str, fields: dict[str, Any]) -> None:
        if self._tell is not None:
            self._tell(Event(self._clock.time(), RECORDING, words, fields))
