"""The state of a run that its parts share: where each is put to work, and what it needs."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tokt.features.frames.view_mask import CameraMasks, parse_masks
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import RunConfig
from tokt.inference.frame import Source
from tokt.inference.links.vehicle import VehicleState
from tokt.inference.monitoring.drift import DriftMonitor
from tokt.inference.monitoring.run_counts import CountingParts, RunCounts
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
    from tokt.models.bundle.bundle import Bundle


class StartEvents(Observer):
    """Keep the start and the newest model events for observers that join later."""

    def __init__(self) -> None:
        self.events: dict[str, Event] = {}

    def event(self, event: Event) -> None:
        """Keep the start, and the newest model."""
        if event.name in (START, MODEL):
            self.events[event.name] = event


@dataclass(eq=False)
class RunState:
    """State of a run that is being put together; `opened` closes its resources."""

    config: RunConfig
    strict: bool  # whether what is missing ends the start
    opened: ExitStack
    events: EventQueue = field(default_factory=EventQueue)
    senders: dict[str, Sender] = field(default_factory=dict)  # by what the user called a receiver
    source: Source | None = None
    assembly: Assembly | None = None
    counting: CountingParts = field(default_factory=CountingParts)
    stereo_fault: str = ""  # why the calibration could not be read as the run began
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
        self.publisher = ReportPublisher(
            senders=self.senders.values(),
            clock=SYSTEM_CLOCK,
            limits=config.limits,
            live=self.live,
            place=self.vehicle.place,
            parts_health=lambda: self.parts.health,
            first_at_once=not self.strict,  # a restart has been silent already
        )
        self._start_events = StartEvents()
        self.observers: list[Observer] = [self._start_events, self.drift, self.counts]

    @property
    def live(self) -> bool:
        """Whether the frames of the source come in real time."""
        source = self.config.source
        if is_stream_source(source.source):
            return False
        return is_camera_source(source.source) or source.rate is not None

    def observe(self, observer: Observer) -> None:
        """Add an observer, and pass it the start and model events that it missed."""
        self.opened.callback(observer.close)
        for event in self._start_events.events.values():
            observer.event(event)
        self.observers.append(observer)

    def send_to(self, name: str, sender: Sender) -> None:
        """Send all reports from now on to one more receiver."""
        self.opened.callback(sender.close)
        if name in self.senders:  # the same receiver may be named twice
            name = f"{name} ({len(self.senders) + 1})"
        self.senders[name] = sender

    def poll(self) -> None:
        """Put parts to work and pass events and heartbeats on, before there is a loop for it."""
        self.parts.join()
        for event in self.events.take():
            for observer in self.observers:
                observer.event(event)
        for report in self.publisher.heartbeats():
            self.heartbeats += 1
            for observer in self.observers:
                observer.heartbeat(report)

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

    def stop(self) -> None:
        """End the run after the frame that is being judged."""
        self.stopped = True
        if self.source is not None:
            self.source.stop()
