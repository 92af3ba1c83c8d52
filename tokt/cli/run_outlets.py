"""Open what `tokt run` sends its verdicts to, and who looks on.

What not every run asks for is imported where it is opened: after a crash each import is time in
which nothing is said.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from ..features.errors import ToktError
from ..inference.assemble import Stereo
from ..inference.clock import SYSTEM_CLOCK
from ..inference.drift import DriftMonitor
from ..inference.event_queue import EventQueue
from ..inference.log import JsonLines, Rotation
from ..inference.observer import Observer
from ..inference.run_counts import RunCounts
from ..inference.run_log import RunLog, new_run_id
from ..inference.sources import Source
from ..inference.status_line import StatusLine
from ..inference.udp import (
    DEFAULT_HOST,
    DEFAULT_PORT,
    Sender,
    UdpSender,
    parse_receiver,
    version_of,
)
from .run_asked import Asked

if TYPE_CHECKING:
    from ..inference.mavlink import MavlinkOptions
    from ..inference.metrics import Metrics
    from ..inference.recorder import Recorder
    from ..inference.shadow import Shadow

Word = TypeVar("Word", bound=StrEnum)


def open_senders(asked: Asked, pairs: Stereo | None, opened: ExitStack) -> dict[str, Sender]:
    """Every receiver's sender, by what the user called it; closed with `opened`."""
    version = version_of(asked.format_)
    senders: dict[str, Sender] = {}

    def keep(text: str, sender: Sender) -> None:
        opened.callback(sender.close)
        # The same receiver may be named twice.
        senders[text if text not in senders else f"{text} ({len(senders) + 1})"] = sender

    for text in asked.udp or [f"{DEFAULT_HOST}:{DEFAULT_PORT}"]:
        keep(text, UdpSender(*parse_receiver(text, version)))
    if asked.mavlink:
        from ..inference.mavlink import MavlinkSender, parse_device

        options = _mavlink_options(asked, pairs)
        for text in asked.mavlink:
            keep(text, MavlinkSender(*parse_device(text), options, SYSTEM_CLOCK))
    return senders


def _mavlink_options(asked: Asked, pairs: Stereo | None) -> MavlinkOptions:
    from ..inference.lens import lens_of
    from ..inference.mavlink import MavlinkOptions, Messages, WhenUnknown

    return MavlinkOptions(
        lens_of(asked.camera_fov_deg, None if pairs is None else pairs.calibration),
        asked.mavlink_assumed_m,
        asked.mavlink_system,
        asked.mavlink_component,
        _one_of(Messages, asked.mavlink_messages, "--mavlink-messages"),
        _one_of(WhenUnknown, asked.mavlink_unknown, "--mavlink-unknown"),
    )


def _one_of(words: type[Word], text: str, option: str) -> Word:
    if text not in list(words):
        raise ToktError(f"{option} is {' or '.join(words)}, not {text!r}")
    return words(text)


@dataclass(frozen=True)
class Onlookers:
    """Who looks on.

    Parameters
    ----------
    observers : list of Observer
        In the order in which they are told.
    log : RunLog or None
    recorder : Recorder or None
    drift : DriftMonitor
    counts : RunCounts
    """

    observers: list[Observer]
    log: RunLog | None
    recorder: Recorder | None
    drift: DriftMonitor
    counts: RunCounts

    def show(self, opened: ExitStack) -> None:
        """From now on, show how the run goes; who writes to the terminal now writes across it."""
        status = StatusLine(self.counts, SYSTEM_CLOCK, recorder=self.recorder)
        opened.callback(status.close)
        self.observers.append(status)


def open_onlookers(
    asked: Asked,
    pairs: Stereo | None,
    senders: dict[str, Sender],
    source: Source,
    events: EventQueue,
    opened: ExitStack,
) -> Onlookers:
    """Everybody that was asked for; closed with `opened`."""
    run = new_run_id(SYSTEM_CLOCK)
    rotation = Rotation(asked.log_max_mb, asked.log_keep)
    drift, counts = DriftMonitor(events.put), RunCounts(SYSTEM_CLOCK)
    observers: list[Observer] = []

    def keep(observer: Observer) -> None:
        observers.append(observer)
        opened.callback(observer.close)

    log = recorder = None
    if asked.log is not None:
        keep(log := RunLog(asked.log, run, rotation, asked.log_values))
    if asked.record is not None:
        keep(recorder := _recorder(asked, asked.record, run, events))
    keep(drift)
    keep(counts)
    if asked.metrics is not None:
        metrics = _metrics(asked.metrics, senders, source, counts, log, recorder, drift)
        opened.callback(metrics.close)
    if asked.shadow is not None and asked.shadow_log is not None:
        # After the others: in a replay without a rate it waits for its challenger.
        lines = JsonLines(asked.shadow_log, rotation)
        keep(_shadow(asked, asked.shadow, pairs, source, lines, run, events))
    return Onlookers(observers, log, recorder, drift, counts)


def _recorder(asked: Asked, folder: Path, run: str, events: EventQueue) -> Recorder:
    from ..inference.disk_budget import DiskLimits
    from ..inference.moments import Around
    from ..inference.recorder import RESERVE_MB, Recorder

    around = Around(asked.record_before, asked.record_after)
    disk = DiskLimits(asked.record_mb, RESERVE_MB)
    return Recorder(folder, run, SYSTEM_CLOCK, around, disk, tell=events.put)


def _metrics(
    address: str,
    senders: dict[str, Sender],
    source: Source,
    counts: RunCounts,
    log: RunLog | None,
    recorder: Recorder | None,
    drift: DriftMonitor,
) -> Metrics:
    from ..inference.cameras.live_source import CameraSource
    from ..inference.metrics import Metrics, Watched, parse_metrics

    cameras = source if isinstance(source, CameraSource) else None
    watched = Watched(senders, log, recorder, cameras, drift)
    return Metrics(*parse_metrics(address), counts, watched, SYSTEM_CLOCK)


def _shadow(
    asked: Asked,
    model: Path,
    pairs: Stereo | None,
    source: Source,
    lines: JsonLines,
    run: str,
    events: EventQueue,
) -> Shadow:
    from ..inference.run_models import model_named
    from ..inference.shadow import Shadow
    from ..inference.shadow_process import Challenger

    challenger = Challenger.of(model_named(model), asked.policy, pairs, asked.threads)
    live, tell = source.live, events.put
    return Shadow(challenger, lines, run, live=live, clock=SYSTEM_CLOCK, tell=tell)
