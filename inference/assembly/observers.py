"""The observers of a run: log, recording, metrics, live view and challenger."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from tokt.features.common.terminal import say
from tokt.features.common.workspace import DEFAULT_WORKSPACE
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import RunConfig
from tokt.inference.frame import Source
from tokt.inference.monitoring.drift import DriftMonitor
from tokt.inference.monitoring.fixed_marks_watch import FixedMarksWatch
from tokt.inference.monitoring.receivers import PlaceWatch, ReceiverWatch
from tokt.inference.monitoring.run_counts import RunCounts
from tokt.inference.monitoring.watchdog import restarts
from tokt.inference.policy.assembly import StereoSetup
from tokt.inference.policy.object_naming import ObjectNaming
from tokt.inference.publisher import Observer, Sender
from tokt.inference.report import EventQueue

if TYPE_CHECKING:
    from tokt.inference.recording.recorder import Recorder
    from tokt.inference.recording.run_log import RunLog
    from tokt.models.sight import SightLimits


def _live_view(config: RunConfig, events: EventQueue, naming: ObjectNaming) -> Observer:
    """The view, and where it is said."""
    from tokt.features.common.address import kept_token
    from tokt.inference.outputs.view import LOOPBACK, LiveView, listening, view_url

    wanted, listener, token, listen = config.monitoring, None, None, None
    if wanted.view is not None:
        host, port = wanted.view_host or LOOPBACK, wanted.view
        listen = partial(listening, host, port)
        # The view of a run that a watchdog started again may wait for its port, verdicts not.
        if not restarts():
            listener = listen()
            port = listener.getsockname()[1]
        if wanted.view_host is not None:
            token = kept_token(DEFAULT_WORKSPACE / "view-token")
        say(f"view: {view_url(host, port, token)}")
    record, stale_s = wanted.view_record, config.limits.stale_s
    return LiveView(listener, token, record, stale_s, events.put, naming, listen)


@dataclass(frozen=True)
class Observers:
    """Who looks on, in the order in which they are told, and those of them that others ask."""

    observers: list[Observer]
    log: RunLog | None
    recorder: Recorder | None
    drift: DriftMonitor
    counts: RunCounts


def open_observers(
    config: RunConfig,
    pairs: StereoSetup | None,
    senders: dict[str, Sender],
    source: Source,
    events: EventQueue,
    opened: ExitStack,
    nmea_fault: Callable[[], str],
    naming: ObjectNaming,
    sight: tuple[SightLimits, ...] | None,
) -> Observers:
    """Everybody that was asked for; closed with `opened`."""
    wanted, model = config.recording, config.model
    drift, counts = DriftMonitor(events.put), RunCounts(SYSTEM_CLOCK)
    observers: list[Observer] = []

    def keep(observer: Observer) -> None:
        observers.append(observer)
        opened.callback(observer.close)

    log = recorder = None
    if not (wanted.log is wanted.record is model.shadow_log is None):
        from tokt.inference.recording.log import JsonLines, LinesApart, LogRotation
        from tokt.inference.recording.run_log import RunLog, new_run_id

        run, rotation = new_run_id(SYSTEM_CLOCK), LogRotation(wanted.log_max_mb, wanted.log_keep)
    if wanted.log is not None:
        keep(log := RunLog(wanted.log, run, rotation, wanted.log_values, source.live))
    if wanted.record is not None:
        from tokt.inference.recording.recorder import Recorder

        limits = wanted.record_before, wanted.record_after, wanted.record_mb
        recorder = Recorder(wanted.record, run, SYSTEM_CLOCK, *limits, tell=events.put)
        keep(recorder)
    keep(drift)
    keep(counts)
    keep(ReceiverWatch(senders, SYSTEM_CLOCK, events.put))
    keep(FixedMarksWatch(SYSTEM_CLOCK, events.put))
    if config.source.nmea is not None or config.outputs.mavlink:
        keep(PlaceWatch(SYSTEM_CLOCK, events.put, nmea_fault))
    if config.monitoring.metrics is not None:
        from tokt.inference.monitoring.metrics import Metrics, RunCollector, parse_metrics
        from tokt.inference.sources.cameras.live_source import CameraSource

        cameras = source if isinstance(source, CameraSource) else None
        parts = senders, log, recorder, cameras, drift
        address = parse_metrics(config.monitoring.metrics)
        metrics = Metrics(*address, RunCollector(counts, SYSTEM_CLOCK, *parts))
        opened.callback(metrics.close)
    if config.monitoring.view is not None or config.monitoring.view_record is not None:
        keep(_live_view(config, events, naming))
    if model.shadow is not None and model.shadow_log is not None:
        from tokt.inference.replay.replay import model_named
        from tokt.inference.replay.shadow import Challenger, Shadow

        lines = (LinesApart if source.live else JsonLines)(model.shadow_log, rotation)
        other = model_named(model.shadow)
        challenger = Challenger(
            label=other.label,
            sha256=other.sha256,
            data=other.data,
            policy=config.policy.policy,
            stereo=pairs,
            threads=model.threads,
            moving=config.policy.moving,
            sight=sight,
        )
        # After the others: in a replay without a rate it waits for its challenger.
        keep(Shadow(challenger, lines, run, source.live, SYSTEM_CLOCK, events.put))
    return Observers(observers, log, recorder, drift, counts)
