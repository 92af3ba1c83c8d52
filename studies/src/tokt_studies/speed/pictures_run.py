"""A whole run of pictures in memory, as `tokt run` puts it together; needs nothing of training."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from tokt.features.common.arrays import U8
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Frame
from tokt.inference.monitoring.drift import DriftMonitor
from tokt.inference.monitoring.fixed_marks_watch import FixedMarksWatch
from tokt.inference.monitoring.run_counts import RunCounts
from tokt.inference.outputs.udp import UdpSender
from tokt.inference.policy.assembly import assemble
from tokt.inference.policy.object_model import ObjectModel
from tokt.inference.policy.object_tracker import ObjectTracker
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import Observer
from tokt.inference.recording.run_log import RunLog
from tokt.inference.report import Report
from tokt.inference.runtime import Runtime
from tokt.inference.verdict import Verdict
from tokt.models.bundle.bundle import Bundle

FPS = 15.0
"""Of the mission's cameras."""


@dataclass
class PictureSource:
    """A source that gives each of some pictures once, as fast as they are taken."""

    pictures: Iterable[U8]
    live = False

    def __iter__(self) -> Iterator[Frame]:
        """Frames whose times are those of a camera of `FPS`."""
        for place, picture in enumerate(self.pictures):
            yield Frame(place, place / FPS, picture, None, timed=True)

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
    """The run of a model, with its log and its receiver; and more, where that is asked for."""

    bundle: Bundle
    port: int  # of 127.0.0.1, of the receiver
    log: Path
    held: ObjectModel | None = None  # an object to hold in the picture
    others: Sequence[Observer] = ()  # told after those of each run

    def texture_alone(self, pictures: Iterable[U8]) -> list[Verdict]:
        """Verdicts of policy ``texture``, and nothing else."""
        policy = assemble("texture", lambda: self.bundle, None, moving=None).policy
        return [policy.judge(frame).verdict for frame in PictureSource(pictures)]

    def whole(self, pictures: Iterable[U8]) -> list[Verdict]:
        """Verdicts of a run: checks, texture, flow, publisher, datagram and log."""
        drift, verdicts = DriftMonitor(lambda _: None), _Verdicts()
        drift.set_model(self.bundle)
        policy = assemble("texture", lambda: self.bundle, None).policy
        if self.held is not None:
            policy.tracker = ObjectTracker(self.held)
        with (
            closing(UdpSender("127.0.0.1", self.port, 2)) as sender,
            closing(RunLog(self.log, "bench")) as log,
        ):
            marks = FixedMarksWatch(SYSTEM_CLOCK, lambda _: None)
            observers = [log, drift, RunCounts(SYSTEM_CLOCK), marks, verdicts, *self.others]
            source = PictureSource(pictures)
            Runtime(source, policy, [sender], SYSTEM_CLOCK, observers).run()
        return verdicts.kept
