"""The case of a whole run: what a frame costs in `tokt run` with its default options and a log."""

import socket
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Frame
from tokt.inference.monitoring.drift import DriftMonitor
from tokt.inference.monitoring.fixed_marks_watch import FixedMarksWatch
from tokt.inference.monitoring.run_counts import RunCounts
from tokt.inference.outputs.udp import UdpSender
from tokt.inference.policy.assembly import assemble
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import Observer
from tokt.inference.recording.run_log import RunLog
from tokt.inference.report import Report
from tokt.inference.runtime import Runtime
from tokt.inference.verdict import CLEAR, Verdict
from tokt.models.bundle.bundle import Bundle

from .cases import Picture
from .paired_timing import BASELINE, OURS, Result, in_turns, result
from .process_cases import FPS

NAME = "run.default"


@dataclass
class PictureSource:
    """A source that gives each of some pictures once, as fast as they are taken."""

    pictures: Sequence[Picture]
    live = False

    def __iter__(self) -> Iterator[Frame]:
        """Frames whose times are those of a camera of `FPS`."""
        for place, picture in enumerate(self.pictures):
            yield Frame(place, place / FPS, picture.frame, None, timed=True)

    def stop(self) -> None:
        """Nothing: there are few pictures."""


class _Verdicts(Observer):
    """Keep what is said of each frame."""

    def __init__(self) -> None:
        self.kept: list[Verdict] = []

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """Keep one verdict."""
        self.kept.append(report.verdict)


@dataclass(frozen=True)
class DefaultRun:
    """The run of a model, with its log and its receiver."""

    bundle: Bundle
    port: int  # of 127.0.0.1, of the receiver
    log: Path

    def texture_alone(self, pictures: Sequence[Picture]) -> list[Verdict]:
        """Verdicts of policy ``texture``, and nothing else."""
        policy = assemble("texture", lambda: self.bundle, None, moving=None).policy
        return [policy.judge(frame).verdict for frame in PictureSource(pictures)]

    def whole(self, pictures: Sequence[Picture]) -> list[Verdict]:
        """Verdicts of a run: checks, texture, flow, publisher, datagram and log."""
        drift, verdicts = DriftMonitor(lambda _: None), _Verdicts()
        drift.set_model(self.bundle)
        policy = assemble("texture", lambda: self.bundle, None).policy
        with (
            closing(UdpSender("127.0.0.1", self.port, 2)) as sender,
            closing(RunLog(self.log, "bench")) as log,
        ):
            marks = FixedMarksWatch(SYSTEM_CLOCK, lambda _: None)
            observers = [log, drift, RunCounts(SYSTEM_CLOCK), marks, verdicts]
            source = PictureSource(pictures)
            Runtime(source, policy, [sender], SYSTEM_CLOCK, observers).run()
        return verdicts.kept


def measure_default_run(bundle: Bundle, pictures: Sequence[Picture], rounds: int) -> Result:
    """Time the run of some frames in a row, `rounds` times; the times are of one frame."""
    with (
        tempfile.TemporaryDirectory(prefix="tokt-bench-") as folder,
        socket.socket(type=socket.SOCK_DGRAM) as receiver,
    ):
        receiver.bind(("127.0.0.1", 0))
        run = DefaultRun(bundle, receiver.getsockname()[1], Path(folder, "run.jsonl"))
        both = zip(run.texture_alone(pictures), run.whole(pictures), strict=True)
        exact = not any(ours.status == CLEAR != alone.status for alone, ours in both)
        calls = {BASELINE: run.texture_alone, OURS: run.whole}
        times = in_turns(calls, [pictures], rounds)
    a_frame = {way: seconds / len(pictures) for way, seconds in times.items()}
    extras = {
        "of": "one decoded frame in a run: checks, texture, flow, publisher, datagram and log",
        "baseline_is": "tokt itself: the texture detector alone",
        "frames": len(pictures),
    }
    return result(NAME, a_frame, exact, extras)
