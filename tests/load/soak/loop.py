"""The program that is soaked: the runtime with all that `tokt run` can have around it.

Run as ``python -m tests.load.soak.loop FOLDER``. ``FOLDER/loop.json`` says what it does
(`LoopPlan`); it says on standard output when it is ready, and at the end what it came to;
``FOLDER/loop.npz`` then holds the times of all frames. The last frame is judged once standard input
has ended.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.inference.clock import SYSTEM_CLOCK, Clock
from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.monitoring.drift import DriftMonitor
from tokt.inference.monitoring.metrics import Metrics, MetricSources
from tokt.inference.monitoring.reload import ModelReloader
from tokt.inference.monitoring.run_counts import RunCounts
from tokt.inference.monitoring.status_line import StatusLine
from tokt.inference.outputs.udp import UdpSender
from tokt.inference.policy.assembly import Assembly, assemble
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import Observer, Sender
from tokt.inference.recording.clip_trigger import ClipPadding
from tokt.inference.recording.log import LogRotation
from tokt.inference.recording.recorder import Recorder
from tokt.inference.recording.recording import DiskLimits
from tokt.inference.recording.run_log import RunLog, new_run_id
from tokt.inference.report import Event, EventQueue, Report
from tokt.inference.runtime import Runtime
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import TEXTURE, Detection
from tokt.models.bundle.bundle import Bundle
from tokt.models.store.last_good import load_running
from tokt.models.store.store import Store

from .plan import FrameKind, plan
from .source import SoakSource

PARTS = ("log", "record", "drift", "metrics", "status", "reload")
"""What is around the loop; the counts and the two senders always are."""

STORE, LOG, RECORD, STATUS = "store", "log/run.jsonl", "record", "status.txt"
_AROUND = ClipPadding(0.02, 0.02)
"""Seconds; at a soak's pace as many frames as two seconds have at a camera's."""
_RESERVE_MB = 200.0
_GONE_S = 0.5


@dataclass(frozen=True)
class LoopPlan:
    """What the loop is given, and what is around it.

    Parameters
    ----------
    frames : int
    v1_port, v2_port : int
        Of the receiver on 127.0.0.1.
    rest_s, pause_every_s, pause_s : float
        As in `SoakSource`.
    log_mb, log_keep : float, int
        Size of a log file, and how many older ones are kept.
    record_mb : float
        Of the disk, for recordings.
    parts : tuple of str
        All of `PARTS`, or some: the others are left away.
    """

    frames: int
    v1_port: int
    v2_port: int
    rest_s: float
    pause_every_s: float
    pause_s: float
    log_mb: float
    log_keep: int
    record_mb: float
    parts: tuple[str, ...] = PARTS


class Failing:
    """A detector that raises where the plan says so.

    Parameters
    ----------
    detector : TextureDetector
    kinds : array of uint8, shape (frames,)
    """

    method = TEXTURE

    def __init__(self, detector: TextureDetector, kinds: NDArray[np.uint8]) -> None:
        self._detector = detector
        self._kinds = kinds

    def detect(self, frame: Frame) -> Detection:
        """What the detector says, unless it is to fail."""
        if self._kinds[frame.number] == FrameKind.FAILING:
            raise RuntimeError(f"frame {frame.number} is one to fail on")
        return self._detector.detect(frame)


class Stamps(Observer):
    """When each frame's datagrams were out, and between which frames what else happened.

    Parameters
    ----------
    frames : int
    clock : Clock

    Attributes
    ----------
    sent : array of float64, shape (frames,)
        The clock's `monotonic`; 0 where a frame was never judged.
    happened : list of (name, number of the last frame before it)
    """

    def __init__(self, frames: int, clock: Clock) -> None:
        self.sent = np.full(frames, 0.0)  # in memory from the start, as the source's
        self.happened: list[tuple[str, int]] = []
        self._clock = clock
        self._number = -1

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """The datagrams are out: it is the first to be told."""
        self.sent[frame.number] = self._clock.monotonic()
        self._number = frame.number

    def event(self, event: Event) -> None:
        """Something else happened."""
        self.happened.append((event.name, self._number))


def soak(folder: Path, asked: LoopPlan) -> dict[str, Any]:
    """Judge all frames of the plan; what it came to, as plain JSON."""
    kinds = plan(asked.frames)
    clock, events = SYSTEM_CLOCK, EventQueue()
    source = SoakSource(kinds, clock, asked.rest_s, asked.pause_every_s, asked.pause_s)
    stamps = Stamps(asked.frames, clock)
    with ExitStack() as opened:
        ports = {"v1": (asked.v1_port, 1), "v2": (asked.v2_port, 2)}  # the receiver counts on it
        senders = {
            name: opened.enter_context(closing(UdpSender("127.0.0.1", port, version)))
            for name, (port, version) in ports.items()
        }
        store = Store(folder / STORE)
        bundle, _ = load_running(store)
        assembly = assemble("texture", lambda: bundle, None)
        around = _Around(asked, folder, senders, events, clock, opened)
        watch = around.watch(store, bundle, assembly, kinds)
        runtime = Runtime(
            *(source, assembly.policy, list(senders.values()), clock),
            observers=[stamps, *around.observers, source],
            limits=Limits(),
            events=events,
            between=tuple if watch is None else watch.exchange,
        )
        parent = os.getppid()
        threading.Thread(target=_wait_for_the_end, args=(source, parent), daemon=True).start()
        gc.freeze()
        print(json.dumps({"metrics_port": around.metrics_port}), flush=True)
        summary = runtime.run()
    np.savez(folder / "loop.npz", arrived=source.arrived, sent=stamps.sent)
    return {
        "summary": summary.to_json(),
        "pauses": source.pauses,
        "sent": {name: sender.sent for name, sender in senders.items()},
        "refused": {name: sender.failed for name, sender in senders.items()},
        "happened": stamps.happened,
        **around.to_json(),
    }


def _wait_for_the_end(source: SoakSource, parent: int) -> None:
    """Let the last frame be given once the bench says so, and none any more if it has died."""
    sys.stdin.read()
    source.may_end.set()
    # Its pipe is closed a moment before it is gone.
    time.sleep(_GONE_S)
    if os.getppid() != parent:
        source.stop()


class _Around:
    """What looks on, as `tokt run` opens it."""

    def __init__(
        self,
        asked: LoopPlan,
        folder: Path,
        senders: Mapping[str, Sender],
        events: EventQueue,
        clock: Clock,
        opened: ExitStack,
    ) -> None:
        run, parts = new_run_id(clock), asked.parts
        self.counts = RunCounts(clock)
        self.log = self.recorder = None
        self.drift = DriftMonitor(events.put)
        self.metrics_port: int | None = None
        self._opened, self._clock = opened, clock
        self._reloads = "reload" in parts
        if "log" in parts:
            self.log = RunLog(folder / LOG, run, LogRotation(asked.log_mb, asked.log_keep))
        if "record" in parts:
            disk = DiskLimits(asked.record_mb, _RESERVE_MB)
            self.recorder = Recorder(folder / RECORD, run, clock, _AROUND, disk, tell=events.put)
        everybody: list[Observer | None] = [self.log, self.recorder]
        everybody += [self.drift if "drift" in parts else None, self.counts]
        if "status" in parts:
            stream = opened.enter_context((folder / STATUS).open("w"))
            everybody.append(StatusLine(self.counts, clock, stream, self.recorder))
        self.observers = [one for one in everybody if one is not None]
        for observer in self.observers:
            opened.callback(observer.close)
        if "metrics" in parts:
            watched = MetricSources(senders, self.log, self.recorder, None, self.drift)
            metrics = Metrics("127.0.0.1", 0, self.counts, watched, clock)
            opened.callback(metrics.close)
            self.metrics_port = metrics.port

    def watch(
        self, store: Store, bundle: Bundle, assembly: Assembly, kinds: NDArray[np.uint8]
    ) -> ModelReloader | None:
        """Put a detector that fails now and then into the policy, and into its place the next."""
        slot = assembly.texture
        assert slot is not None, "policy texture has a slot"

        def put(bundle: Bundle) -> None:
            slot.put(Failing(TextureDetector(bundle), kinds))
            self.drift.set_model(bundle)

        put(bundle)
        if not self._reloads:
            return None
        watch = ModelReloader(store, bundle, assembly.misfit, put, self._clock)
        watch.start()
        self._opened.callback(watch.close)
        return watch

    def to_json(self) -> dict[str, Any]:
        """What they came to."""
        recorder, state = self.recorder, self.drift.state
        return {
            "counted": {"frames": self.counts.frames, "heartbeats": self.counts.heartbeats},
            "log_lines_failed": None if self.log is None else self.log.failed,
            "recorded": recorder
            and {
                "frames": recorder.frames,
                "dropped": recorder.dropped,
                "moments": recorder.clips,
                "written_mb": recorder.written_bytes / 1e6,
                "removed_mb": recorder.removed_bytes / 1e6,
            },
            "drift": asdict(state),
        }


def main(arguments: Sequence[str]) -> None:
    """Run as the program."""
    folder = Path(arguments[0])
    asked = json.loads((folder / "loop.json").read_text())
    print(json.dumps(soak(folder, LoopPlan(**{**asked, "parts": tuple(asked["parts"])}))))


if __name__ == "__main__":
    main(sys.argv[1:])
