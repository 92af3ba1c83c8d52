"""The state of a run that its parts share: where each is put to work, and what it needs."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, cast

from tokt.features.frames.view_mask import CameraMasks, parse_masks
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import RunConfig
from tokt.inference.frame import Source
from tokt.inference.links.vehicle import VehicleState
from tokt.inference.monitoring.drift import DriftMonitor
from tokt.inference.monitoring.run_counts import RunCounts
from tokt.inference.policy.assembly import Assembly
from tokt.inference.policy.object_naming import ObjectNaming
from tokt.inference.publisher import Observer, ReportPublisher, Sender
from tokt.inference.recording.run_start import new_run_id
from tokt.inference.report import MODEL, START, Event, EventQueue
from tokt.inference.sources.files import MissionSource
from tokt.inference.sources.open import is_camera_source
from tokt.inference.sources.stream import is_stream_source

from .parts import RunParts
from .run_model import RunModel

if TYPE_CHECKING:
    from tokt.inference.monitoring.metrics import RunCollector
    from tokt.inference.monitoring.status_line import StatusLine
    from tokt.inference.recording.recorder import Recorder
    from tokt.inference.recording.run_log import RunLog
    from tokt.inference.runtime import Runtime
    from tokt.inference.sources.cameras.live_source import CameraSource
    from tokt.models.bundle.bundle import Bundle


class RunBeginning(Observer):
    """Keep the events that say how the run began, for who looks on later."""

    def __init__(self) -> None:
        self.events: dict[str, Event] = {}

    def event(self, event: Event) -> None:
        """Keep the start, and the newest model."""
        if event.name in (START, MODEL):
            self.events[event.name] = event


@dataclass(eq=False)
class RunState:
    """A run as far as it is put together; what is closed when it ends is in `opened`."""

    config: RunConfig
    strict: bool  # whether what is missing ends the start
    opened: ExitStack
    events: EventQueue = field(default_factory=EventQueue)
    senders: dict[str, Sender] = field(default_factory=dict)  # by what the user called a receiver
    source: Source | None = None
    assembly: Assembly | None = None
    masks: CameraMasks = CameraMasks()  # noqa: RUF009 - frozen; what is no view
    runtime: Runtime | None = None
    collector: RunCollector | None = None
    status: StatusLine | None = None
    looking: dict[str, Observer] = field(default_factory=dict)  # by the options that ask for them
    heartbeats: int = 0  # before the first frame was waited for
    stopped: bool = False  # whether somebody has ended the run

    def __post_init__(self) -> None:
        config = self.config
        self.parts = RunParts(SYSTEM_CLOCK, self.events.put, self.strict)
        self.opened.callback(self.parts.close)
        self.vehicle = VehicleState(SYSTEM_CLOCK)
        self.counts = RunCounts(SYSTEM_CLOCK)
        self.drift = DriftMonitor(self.events.put)
        self.model = RunModel(config, self.masks_of, self.strict)
        self.run_id = new_run_id(SYSTEM_CLOCK)
        self.naming = ObjectNaming(None, SYSTEM_CLOCK.time)
        self.all_senders: list[Sender] = []
        self.publisher = ReportPublisher(
            senders=self.all_senders,
            clock=SYSTEM_CLOCK,
            limits=config.limits,
            live=self.live,
            place=self.vehicle.place,
            parts_health=lambda: self.parts.health,
        )
        self._beginning = RunBeginning()
        self.observers: list[Observer] = [self._beginning, self.drift, self.counts]

    @property
    def live(self) -> bool:
        """Whether the frames of the source come in real time."""
        source = self.config.source
        if is_stream_source(source.source):
            return False
        return is_camera_source(source.source) or source.rate is not None

    def observe(self, observer: Observer) -> None:
        """Let somebody look on from now on, who is told how the run began."""
        self.opened.callback(observer.close)
        for event in self._beginning.events.values():
            observer.event(event)
        self.observers.append(observer)

    def send_to(self, name: str, sender: Sender) -> None:
        """Send all reports from now on to one more receiver."""
        self.opened.callback(sender.close)
        if name in self.senders:  # the same receiver may be named twice
            name = f"{name} ({len(self.senders) + 1})"
        self.senders[name] = sender
        self.all_senders.append(sender)

    def look_round(self) -> None:
        """Put parts to work, and pass events and heartbeats on, while no loop does it."""
        self.parts.join()
        for event in self.events.take():
            for observer in self.observers:
                observer.event(event)
        for report in self.publisher.heartbeats():
            self.heartbeats += 1
            for observer in self.observers:
                observer.heartbeat(report)

    def share(self) -> None:
        """Let metrics and the status line know what has joined the run."""
        recorder = cast("Recorder | None", self.looking.get("record"))
        if self.status is not None:
            self.status.recorder = recorder
        if self.collector is not None:
            self.collector.recorder = recorder
            self.collector.log = cast("RunLog | None", self.looking.get("log"))
            if is_camera_source(self.config.source.source):
                self.collector.cameras = cast("CameraSource | None", self.source)

    def masks_of(self, model: Bundle | None) -> CameraMasks:
        """Find what is no view in a run of a model; ToktError if the options cannot be meant."""
        texts = self.config.source.mask
        if texts is not None:
            return parse_masks(texts, () if model is None else model.masks)
        return self.masks_beside

    @property
    def masks_beside(self) -> CameraMasks:
        """The mask that lies beside recorded frames."""
        source = self.source
        return source.mission.masks if isinstance(source, MissionSource) else CameraMasks()

    def set_masks(self, masks: CameraMasks) -> None:
        """Take what is no view, for the frames from now on."""
        self.masks = masks
        if self.runtime is not None:
            self.runtime.masks = masks

    def stop(self) -> None:
        """End the run after the frame that is being judged."""
        self.stopped = True
        if self.source is not None:
            self.source.stop()
