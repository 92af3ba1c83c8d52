"""Senders and observers of a run, opened as its description says.

What not every run asks for is imported where it is opened: after a crash each import is time in
which nothing is said.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, TypeVar

from tokt.features.common.errors import ToktError
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import RunConfig
from tokt.inference.frame import Source
from tokt.inference.monitoring.drift import DriftMonitor
from tokt.inference.monitoring.run_counts import RunCounts
from tokt.inference.monitoring.status_line import StatusLine
from tokt.inference.outputs.udp import (
    DEFAULT_HOST,
    DEFAULT_PORT,
    UdpSender,
    parse_receiver,
    version_of,
)
from tokt.inference.policy.assembly import StereoSetup
from tokt.inference.publisher import Observer, Sender
from tokt.inference.recording.log import JsonLines, LogRotation
from tokt.inference.recording.run_log import RunLog, new_run_id
from tokt.inference.report import EventQueue

if TYPE_CHECKING:
    from tokt.inference.outputs.mavlink import MavlinkOptions
    from tokt.inference.recording.recorder import Recorder

Word = TypeVar("Word", bound=StrEnum)


def open_senders(
    config: RunConfig, pairs: StereoSetup | None, opened: ExitStack
) -> dict[str, Sender]:
    """Every receiver's sender, by what the user called it; closed with `opened`."""
    version = version_of(config.outputs.format)
    senders: dict[str, Sender] = {}

    def keep(text: str, sender: Sender) -> None:
        opened.callback(sender.close)
        # The same receiver may be named twice.
        senders[text if text not in senders else f"{text} ({len(senders) + 1})"] = sender

    for text in config.outputs.udp or [f"{DEFAULT_HOST}:{DEFAULT_PORT}"]:
        keep(text, UdpSender(*parse_receiver(text, version)))
    if config.outputs.mavlink:
        from tokt.inference.outputs.mavlink import MavlinkSender, parse_device

        options = _mavlink_options(config, pairs)
        for text in config.outputs.mavlink:
            keep(text, MavlinkSender(*parse_device(text), options, SYSTEM_CLOCK))
    return senders


def _mavlink_options(config: RunConfig, pairs: StereoSetup | None) -> MavlinkOptions:
    from tokt.inference.outputs.mavlink import MavlinkOptions, Messages, WhenUnknown, lens_of

    wanted = config.outputs
    return MavlinkOptions(
        lens_of(wanted.camera_fov_deg, None if pairs is None else pairs.calibration),
        *(wanted.mavlink_assumed_m, wanted.mavlink_system, wanted.mavlink_component),
        _one_of(Messages, wanted.mavlink_messages, "--mavlink-messages"),
        _one_of(WhenUnknown, wanted.mavlink_unknown, "--mavlink-unknown"),
    )


def _one_of(words: type[Word], text: str, option: str) -> Word:
    if text not in list(words):
        raise ToktError(f"{option} is {' or '.join(words)}, not {text!r}")
    return words(text)


@dataclass(frozen=True)
class Observers:
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


def open_observers(
    config: RunConfig,
    pairs: StereoSetup | None,
    senders: dict[str, Sender],
    source: Source,
    events: EventQueue,
    opened: ExitStack,
) -> Observers:
    """Everybody that was asked for; closed with `opened`."""
    run, wanted, model = new_run_id(SYSTEM_CLOCK), config.recording, config.model
    rotation = LogRotation(wanted.log_max_mb, wanted.log_keep)
    drift, counts = DriftMonitor(events.put), RunCounts(SYSTEM_CLOCK)
    observers: list[Observer] = []

    def keep(observer: Observer) -> None:
        observers.append(observer)
        opened.callback(observer.close)

    log = recorder = None
    if wanted.log is not None:
        keep(log := RunLog(wanted.log, run, rotation, wanted.log_values))
    if wanted.record is not None:
        from tokt.inference.recording.clip_trigger import ClipPadding
        from tokt.inference.recording.recorder import RESERVE_MB, Recorder
        from tokt.inference.recording.recording import DiskLimits

        around = ClipPadding(wanted.record_before, wanted.record_after)
        disk = DiskLimits(wanted.record_mb, RESERVE_MB)
        recorder = Recorder(wanted.record, run, SYSTEM_CLOCK, around, disk, tell=events.put)
        keep(recorder)
    keep(drift)
    keep(counts)
    if config.monitoring.metrics is not None:
        from tokt.inference.monitoring.metrics import Metrics, MetricSources, parse_metrics
        from tokt.inference.sources.cameras.live_source import CameraSource

        cameras = source if isinstance(source, CameraSource) else None
        watched = MetricSources(senders, log, recorder, cameras, drift)
        address = parse_metrics(config.monitoring.metrics)
        opened.callback(Metrics(*address, counts, watched, SYSTEM_CLOCK).close)
    if model.shadow is not None and model.shadow_log is not None:
        from tokt.inference.replay.replay import model_named
        from tokt.inference.replay.shadow import Challenger, Shadow

        lines = JsonLines(model.shadow_log, rotation)
        other = model_named(model.shadow)
        challenger = Challenger.of(other, config.policy.policy, pairs, model.threads)
        # After the others: in a replay without a rate it waits for its challenger.
        keep(Shadow(challenger, lines, run, source.live, SYSTEM_CLOCK, events.put))
    return Observers(observers, log, recorder, drift, counts)
