"""A run as its description says: checked, put together, run to its end, and its result.

What not every run asks for is imported where it is opened: after a crash each import is time in
which nothing is said.
"""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
from collections.abc import Callable, Iterable
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tokt.features.common.address import without_credentials
from tokt.features.common.errors import ToktError, counted
from tokt.features.frames.mission import parse_frames
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import (
    CAMERAS,
    FILES,
    LIVE,
    MODELS,
    OPTIONS,
    PICTURES,
    REAL_TIME,
    VIDEO,
    ModelConfig,
    RunConfig,
    SourceConfig,
    StereoConfig,
)
from tokt.inference.frame import Source
from tokt.inference.links.link import open_link
from tokt.inference.links.nmea import NmeaReader
from tokt.inference.links.vehicle import VehicleState
from tokt.inference.monitoring.drift import DriftMonitor
from tokt.inference.monitoring.receivers import PlaceWatch, ReceiverWatch
from tokt.inference.monitoring.reload import ModelReloader
from tokt.inference.monitoring.run_counts import RunCounts
from tokt.inference.monitoring.status_line import StatusLine
from tokt.inference.monitoring.watchdog import RESTARTS_VARIABLE, Notifier
from tokt.inference.outputs.udp import DEFAULT_RECEIVER, UdpSender, parse_receiver, version_of
from tokt.inference.policy.assembly import Assembly, StereoSetup, assemble
from tokt.inference.policy.object_naming import ObjectNaming
from tokt.inference.policy.temporal_cues import Anchor
from tokt.inference.publisher import Observer, Sender
from tokt.inference.recording.log import JsonLines, LinesApart, LogRotation
from tokt.inference.recording.run_log import RunLog, events_path, new_run_id
from tokt.inference.recording.run_start import ModelName, RunStart
from tokt.inference.report import Event, EventQueue
from tokt.inference.runtime import Runtime, Summary
from tokt.inference.sources.files import MissionSource, open_source
from tokt.inference.sources.open import is_camera_source, open_camera_source
from tokt.inference.sources.stream import StreamSource, is_stream_source
from tokt.inference.sources.video.address import is_video_source
from tokt.inference.texture.detector import TextureDetector
from tokt.models.bundle.bundle import Bundle, read_bundle
from tokt.models.store.last_good import load_running
from tokt.models.store.store import Store

from .options import DEFAULT_WORKSPACE, read_calibration_file
from .output import print_json, real_stderr, say, stop_on_signal

if TYPE_CHECKING:
    from tokt.inference.recording.recorder import Recorder

_END_S = 1.0
"""Seconds from the end of all work until the system ends the process, if it does not by itself."""


def check(config: RunConfig) -> None:
    """Refuse options that contradict each other, and those that would do nothing."""
    if config.monitoring.watchdog:
        raise ToktError("--watchdog is for the command tokt run: it starts processes")
    given = [each for each in OPTIONS.values() if each.name in config.given]
    for each in given:
        if each.not_with in config.given:
            raise ToktError(f"give --{each.key} or --{OPTIONS[each.not_with].key}, not both")
        if each.needs and config.given.isdisjoint(each.needs):
            words = " or ".join(f"--{OPTIONS[name].key}" for name in each.needs)
            raise ToktError(f"--{each.key} is of no use without {words}")
    log, shadow_log = config.recording.log, config.model.shadow_log
    logs = () if log is None else (log, events_path(log))
    if shadow_log is not None and shadow_log.absolute() in [path.absolute() for path in logs]:
        raise ToktError("--shadow-log names a file that --log writes: give it one of its own")
    _check_told(config)
    useless = _useless(config)
    for each in given:
        if each.only in useless:
            raise ToktError(f"--{each.key} is for {useless[each.only]}")


def _useless(config: RunConfig) -> dict[str, str]:
    """The kinds of runs that this one is not; what options for them are for."""
    source = config.source.source
    useless: dict[str, str] = {}
    if is_video_source(source):
        useless |= {CAMERAS: CAMERAS, **dict.fromkeys((FILES, PICTURES), f"{FILES}, not for video")}
    elif is_camera_source(source):
        useless |= {VIDEO: VIDEO, FILES: f"{FILES}, not for live cameras"}
    else:
        useless |= {CAMERAS: CAMERAS, VIDEO: VIDEO, LIVE: LIVE}
        if is_stream_source(source):
            useless |= dict.fromkeys((FILES, PICTURES), f"{FILES}, not for a stream")
        if config.source.rate is None:
            useless[REAL_TIME] = REAL_TIME
    if config.policy.policy == "disparity":
        useless[MODELS] = MODELS
    return useless


def _check_told(config: RunConfig) -> None:
    """Refuse an anchor or a place of which nobody would hear, and a share that cannot be held."""
    policy = config.policy
    if policy.anchor is not None:
        Anchor(policy.anchor)
    asked = {"anchor": policy.anchor, "anchor-from": policy.anchor_from, "nmea": config.source.nmea}
    version = version_of(config.outputs.format)
    receivers = config.outputs.udp or []
    versions = {parse_receiver(text, version).version for text in receivers} or {version}
    if versions != {1} or config.recording.log is not None or config.recording.record is not None:
        return
    for name in (name for name, value in asked.items() if value is not None):
        raise ToktError(
            f"--{name} is of no use without a receiver of v2 (--format v2 or --udp v2@HOST:PORT), "
            "--log or --record"
        )


class RunModel:
    """The model a run begins with."""

    def __init__(self, wanted: ModelConfig) -> None:
        self.bundle: Bundle | None = None  # it, once loaded
        self.fault = ""  # why it could not be loaded
        self.notes: list[str] = []  # why it is not the store's active one
        self._wanted = wanted

    @property
    def loader(self) -> Callable[[], Bundle] | None:
        """What loads it; None where none was asked for."""
        return self._load if self._wanted.store or self._wanted.bundle else None

    def _load(self) -> Bundle:
        try:
            if self._wanted.bundle is not None:
                found = read_bundle(self._wanted.bundle)
                if found.deployment_fault:
                    fault = f"model {found.label} cannot guard a vehicle: {found.deployment_fault}"
                    raise ToktError(f"{self._wanted.bundle}: {fault}")
            else:
                assert self._wanted.store is not None
                found, self.notes = load_running(Store(self._wanted.store))
        except ToktError as error:
            self.fault = str(error)
            raise
        self.bundle = self.as_it_runs(found)
        return self.bundle

    def as_it_runs(self, bundle: Bundle) -> Bundle:
        """A model that has passed all checks, with its boundary as the options want it."""
        return bundle.with_fixed_boundary() if self._wanted.fixed_boundary else bundle

    def words(self) -> list[str]:
        """Lines for people."""
        lines = [f"WARNING: {note}" for note in self.notes]
        if self.bundle is None:
            return lines
        rule = self.bundle.operating_point.rule
        late = f"; {rule.latency_words()}" if rule.latency_frames else ""
        return [*lines, f"model {self.bundle.label}: status 1 with {rule.words()}{late}"]


def _words(summary: Summary, senders: Iterable[Sender]) -> str:
    """A run that has ended, in one line for people."""
    line = (
        f"{counted(summary.frames, 'frame')} in {summary.seconds:.1f} s: "
        f"{summary.obstacle} obstacle, {summary.clear} clear, {summary.unknown} unknown; "
        f"{counted(summary.sent, 'datagram')} sent"
    )
    if summary.send_failures:
        reasons = sorted({sender.last_error for sender in senders if sender.last_error})
        line += f", {summary.send_failures} refused ({', '.join(reasons)})"
    if summary.heartbeats or summary.dropped:
        late = counted(summary.dropped, "frame")
        line += f"; {counted(summary.heartbeats, 'heartbeat')}, no time for {late}"
    if summary.log_failures:
        line += f"; {summary.log_failures} log lines could not be written"
    return line


def _as_json(config: RunConfig, model: Bundle | None, summary: Summary) -> dict[str, Any]:
    """What ``--json`` prints of it; without a model its figures are None."""
    rule = model and model.operating_point.rule
    return {
        "policy": config.policy.policy,
        "format": config.outputs.format,
        "model": model and model.label,
        "frame_rule": rule and rule.to_json(),
        "latency_frames": rule and rule.latency_frames,
        **summary.to_json(),
    }


def run(config: RunConfig) -> Summary:
    """Run until the source ends or somebody stops it, and say what came of it.

    Only for the main thread: Ctrl-C and SIGTERM end the run. SIGTERM is ignored after either.

    Examples
    --------
    >>> options = {"source": "dive", "bundle": "tower-lbp-1.tokt", "log": "run.jsonl"}
    >>> tokt.run(tokt.RunConfig.of(options)).frames  # doctest: +SKIP
    246
    """
    check(config)
    events = EventQueue()
    with ExitStack() as opened:
        pairs = _stereo(config)
        source = _source(config, pairs, events, opened)
        vehicle = VehicleState(SYSTEM_CLOCK)
        senders = _senders(config, pairs, vehicle, events, opened)
        nmea_fault = _read_nmea(config.source, vehicle, opened)
        model = RunModel(config.model)
        size = config.policy.anchor
        assembly = assemble(
            *(config.policy.policy, model.loader, pairs, config.model.threads),
            anchor=None if size is None else Anchor(size),
            moving=config.policy.moving,
        )
        if config.source.pixel_format == "Mono8" and model.bundle and model.bundle.needs_colour:
            label = model.bundle.label
            raise ToktError(f"model {label} looks at colours: not with --pixel-format Mono8")
        if assembly.texture is not None:
            assembly.texture.note = "; ".join(model.notes)
        naming = _naming(config, source, assembly)
        looking = _observers(config, pairs, senders, source, events, opened, nmea_fault, naming)
        for line in model.words():
            say(line)
        # Who writes to the terminal from now on writes across it.
        terminal = real_stderr()
        if terminal is not None and not terminal.isatty():
            terminal = None  # lines keep their order with those of others
        status = StatusLine(looking.counts, SYSTEM_CLOCK, terminal, looking.recorder)
        opened.callback(status.close)
        looking.observers.append(status)
        looking.drift.set_model(model.bundle)
        watch = _model_watch(config, model, assembly, looking.drift, opened)
        looking.observers.extend([] if watch is None else [watch])
        notifier = opened.enter_context(closing(Notifier(SYSTEM_CLOCK)))

        def alive() -> None:
            notifier.alive()
            if notifier.dismissed:
                source.stop()

        runtime = Runtime(
            *(source, assembly.policy, list(senders.values()), SYSTEM_CLOCK),
            observers=looking.observers,
            limits=config.limits,
            events=events,
            between=lambda: [*(() if watch is None else watch.exchange()), *naming.take()],
            alive=alive,
            place=vehicle.place,
        )
        events.put(_start_event(config, model, source))
        # What was made up to here stays: the collector need not go through it at sea.
        gc.freeze()
        with stop_on_signal(source.stop) as signals:
            notifier.ready()
            summary = runtime.run()
            if not signals:  # a watchdog knows of its own, and starts again after anybody else's
                notifier.stopping()
        if signals:  # a watchdog asks, too, after a Ctrl-C: what ends is not to be cut off
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
    summary.log_failures = 0 if looking.log is None else looking.log.failed
    say(_words(summary, senders.values()))
    if config.monitoring.json:
        print_json(_as_json(config, model.bundle, summary))
    return summary


def _naming(config: RunConfig, source: Source, assembly: Assembly) -> ObjectNaming:
    """What takes the names of objects to hold, and holds the one that the options name."""
    naming, text = ObjectNaming(assembly.policy, SYSTEM_CLOCK.time), config.policy.anchor_from
    if text is not None:
        mission = source.mission if isinstance(source, MissionSource) else None
        naming.name_before(text, mission, config.source.pixel_format)
    return naming


def _stereo(config: RunConfig) -> StereoSetup | None:
    """How pairs are looked at, or None without a calibration."""
    wanted = config.stereo
    if wanted.calibration is None:
        if wanted != StereoConfig():
            raise ToktError("stereo needs a calibration (--calibration FILE.yml)")
        return None
    from tokt.inference.stereo.odometry import load_odometry

    poses = None if wanted.odometry is None else load_odometry(wanted.odometry)
    calibration = read_calibration_file(wanted.calibration)
    return StereoSetup(calibration, wanted.stereo, wanted.stereo_scale, poses)


def _source(
    config: RunConfig, pairs: StereoSetup | None, events: EventQueue, opened: ExitStack
) -> Source:
    wanted = config.source
    if is_stream_source(wanted.source):
        return opened.enter_context(closing(StreamSource(wanted.source, SYSTEM_CLOCK)))
    if not is_camera_source(wanted.source):
        chosen = None if wanted.frames is None else parse_frames(wanted.frames)
        read_right = pairs is not None
        return open_source(
            wanted.source, SYSTEM_CLOCK, chosen, wanted.rate, read_right, wanted.pixel_format
        )
    if sys.platform != "win32":
        # As a program ends a vendor's library may wait for calls of its own, for ever.
        atexit.register(signal.setitimer, signal.ITIMER_REAL, _END_S)
    # Started again by the watchdog it had its cameras: one that is gone now is lost, no mistake.
    wanted = replace(wanted, wait=wanted.wait or _restarts() > 0)
    source = open_camera_source(wanted, SYSTEM_CLOCK, events.put)
    opened.callback(source.close)
    return source


def _model_watch(
    config: RunConfig, model: RunModel, assembly: Assembly, drift: DriftMonitor, opened: ExitStack
) -> ModelReloader | None:
    """What goes over to a store's next model, where there is a store."""
    slot = assembly.texture
    if config.model.store is None or slot is None:
        return None

    def put(bundle: Bundle, note: str) -> None:
        wanted = config.model
        slot.put(TextureDetector(model.as_it_runs(bundle), wanted.threads), note)
        drift.set_model(bundle)

    watch = ModelReloader(
        *(Store(config.model.store), model.bundle, assembly.misfit, put, SYSTEM_CLOCK),
        is_active=not model.notes,
    )
    watch.start()
    opened.callback(watch.close)
    return watch


def _start_event(config: RunConfig, model: RunModel, source: Source) -> Event:
    """How the run begins, for the log."""
    bundle, named = model.bundle, config.source.source
    is_path = not (is_camera_source(named) or is_stream_source(named))
    start = RunStart.of(
        config,
        # Whole paths: a replay begins somewhere else.
        source=str(Path(named).absolute()) if is_path else without_credentials(named),
        live=source.live,
        model=None if bundle is None else ModelName(bundle.label, bundle.sha256),
        model_fault=model.fault,
        model_note="; ".join(model.notes),
        frame_rule=None if bundle is None else bundle.operating_point.rule.to_json(),
    )
    restarts = _restarts()
    words = f"tokt run on {without_credentials(named)}, policy {start.policy}"
    if restarts:
        words += f", started again by its watchdog ({restarts})"
    return Event(SYSTEM_CLOCK.time(), "start", words, {**start.fields(), "restarts": restarts})


def _restarts() -> int:
    return int(os.environ.get(RESTARTS_VARIABLE, "0"))


def _read_nmea(wanted: SourceConfig, vehicle: VehicleState, opened: ExitStack) -> Callable[[], str]:
    """Hear where the vehicle is, where that was asked for; gives what fails of that."""
    if wanted.nmea is None:
        return str
    if wanted.nmea.strip().startswith("udpout:"):
        raise ToktError("--nmea only listens: write udpin:HOST:PORT")
    link = opened.enter_context(closing(open_link(wanted.nmea)))
    link.listen(NmeaReader(vehicle, wanted.nmea_dpt, link.whole).heard)
    return lambda: link.last_error


def _senders(
    config: RunConfig,
    pairs: StereoSetup | None,
    vehicle: VehicleState,
    events: EventQueue,
    opened: ExitStack,
) -> dict[str, Sender]:
    """Every receiver's sender, by what the user called it; closed with `opened`."""
    version = version_of(config.outputs.format)
    senders: dict[str, Sender] = {}

    def keep(text: str, sender: Sender) -> None:
        opened.callback(sender.close)
        # The same receiver may be named twice.
        senders[text if text not in senders else f"{text} ({len(senders) + 1})"] = sender

    for text in config.outputs.udp or [DEFAULT_RECEIVER]:
        keep(text, UdpSender(*parse_receiver(text, version)))
    if config.outputs.mavlink:
        from tokt.inference.outputs.mavlink import MavlinkSender, check_mavlink, lens_of

        wanted = config.outputs
        check_mavlink(wanted)
        lens = lens_of(wanted.camera_fov_deg, None if pairs is None else pairs.calibration)
        for text in config.outputs.mavlink:
            told = vehicle, events.put
            keep(text, MavlinkSender(open_link(text), lens, wanted, SYSTEM_CLOCK, *told))
    return senders


def _live_view(config: RunConfig, events: EventQueue, naming: ObjectNaming) -> Observer:
    """The view, and where it is said."""
    from tokt.features.common.address import kept_token
    from tokt.inference.outputs.view import LOOPBACK, LiveView, listening, view_url

    wanted, listener, token, listen = config.monitoring, None, None, None
    if wanted.view is not None:
        host, port = wanted.view_host or LOOPBACK, wanted.view
        listen = partial(listening, host, port)
        # The view of a run that a watchdog started again may wait for its port, verdicts not.
        if not _restarts():
            listener = listen()
            port = listener.getsockname()[1]
        if wanted.view_host is not None:
            token = kept_token(DEFAULT_WORKSPACE / "view-token")
        say(f"view: {view_url(host, port, token)}")
    record, stale_s = wanted.view_record, config.limits.stale_s
    return LiveView(listener, token, record, stale_s, events.put, naming, listen)


class _Observers(NamedTuple):
    """Who looks on, in the order in which they are told, and those of them that others ask."""

    observers: list[Observer]
    log: RunLog | None
    recorder: Recorder | None
    drift: DriftMonitor
    counts: RunCounts


def _observers(
    config: RunConfig,
    pairs: StereoSetup | None,
    senders: dict[str, Sender],
    source: Source,
    events: EventQueue,
    opened: ExitStack,
    nmea_fault: Callable[[], str],
    naming: ObjectNaming,
) -> _Observers:
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
        keep(log := RunLog(wanted.log, run, rotation, wanted.log_values, source.live))
    if wanted.record is not None:
        from tokt.inference.recording.recorder import Recorder

        limits = wanted.record_before, wanted.record_after, wanted.record_mb
        recorder = Recorder(wanted.record, run, SYSTEM_CLOCK, *limits, tell=events.put)
        keep(recorder)
    keep(drift)
    keep(counts)
    keep(ReceiverWatch(senders, SYSTEM_CLOCK, events.put))
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
        named = other.label, other.sha256, other.data
        challenger = Challenger(
            *named, config.policy.policy, pairs, model.threads, config.policy.moving
        )
        # After the others: in a replay without a rate it waits for its challenger.
        keep(Shadow(challenger, lines, run, source.live, SYSTEM_CLOCK, events.put))
    return _Observers(observers, log, recorder, drift, counts)
