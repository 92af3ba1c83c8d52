"""A run as its description says: checked, put together, run to its end, and its result.

What not every run asks for is imported where it is opened: after a crash each import is time in
which nothing is said.
"""

from __future__ import annotations

import atexit
import gc
import signal
import sys
from collections.abc import Iterable
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from tokt.features.common.address import without_credentials
from tokt.features.common.errors import ToktError, counted
from tokt.features.common.terminal import print_json, real_stderr, say, stop_on_signal
from tokt.features.frames.mission import frame_size, parse_frames
from tokt.features.frames.view_mask import CameraMasks, joined, parse_masks
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import RunConfig, SourceConfig, StereoConfig
from tokt.inference.frame import Source
from tokt.inference.links.vehicle import VehicleState
from tokt.inference.monitoring.status_line import StatusLine
from tokt.inference.monitoring.watchdog import Notifier, restarts
from tokt.inference.policy.assembly import Assembly, StereoSetup, assemble
from tokt.inference.policy.object_naming import ObjectNaming
from tokt.inference.policy.temporal_cues import Anchor
from tokt.inference.publisher import Sender
from tokt.inference.reason import unknown_in_words
from tokt.inference.recording.run_start import ModelName, RunStart, software
from tokt.inference.report import Event, EventQueue
from tokt.inference.runtime import Runtime, Summary
from tokt.inference.sources.files import MissionSource, open_source
from tokt.inference.sources.open import is_camera_source, open_camera_source
from tokt.inference.sources.stream import StreamSource, is_stream_source
from tokt.models.bundle.bundle import Bundle
from tokt.models.sight import sight_to_json

from .observers import open_observers
from .option_checks import check_options
from .run_model import RunModel, open_model_watch
from .senders import open_senders, read_nmea

_END_S = 1.0
"""Seconds from the end of all work until the system ends the process, if it does not by itself."""


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
    check_options(config)
    events = EventQueue()
    with ExitStack() as opened:
        pairs = _stereo(config)
        source = _source(config, pairs, events, opened)
        vehicle = VehicleState(SYSTEM_CLOCK)
        senders = open_senders(config, pairs, vehicle, events, opened)
        nmea_fault = read_nmea(config.source, vehicle, opened)
        model = RunModel(config, lambda bundle: _masks(config.source, source, bundle))
        size = config.policy.anchor
        assembly = assemble(
            *(config.policy.policy, model.loader, pairs, config.model.threads),
            anchor=None if size is None else Anchor(size),
            moving=config.policy.moving,
        )
        _check_pictures(config, model, source)
        if assembly.texture is not None:
            assembly.texture.note = model.note
        naming = _naming(config, source, assembly)
        looking = open_observers(
            config, pairs, senders, source, events, opened, nmea_fault, naming, model.sight
        )
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
        watch = open_model_watch(config, model, assembly, looking.drift, opened)
        looking.observers.extend([] if watch is None else [watch])
        notifier = opened.enter_context(closing(Notifier(SYSTEM_CLOCK)))

        def alive() -> None:
            notifier.alive()
            if notifier.dismissed:
                source.stop()

        masks = _masks(config.source, source, model.bundle)
        _say_masks(masks, config.source, source, model.bundle)
        runtime = Runtime(
            *(source, assembly.policy, list(senders.values()), SYSTEM_CLOCK),
            observers=looking.observers,
            limits=config.limits,
            events=events,
            between=lambda: [*(() if watch is None else watch.exchange()), *naming.take()],
            alive=alive,
            place=vehicle.place,
            masks=masks,
        )
        events.put(_start_event(config, model, source, masks))
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
    for line in (_words(summary, senders.values()), *unknown_in_words(looking.counts.unknown)):
        say(line)
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
    from tokt.inference.stereo.calibration import read_calibration
    from tokt.inference.stereo.odometry import load_odometry

    poses = None if wanted.odometry is None else load_odometry(wanted.odometry)
    calibration = read_calibration(wanted.calibration).usable(say)
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
    wanted = replace(wanted, wait=wanted.wait or restarts() > 0)
    source = open_camera_source(wanted, SYSTEM_CLOCK, events.put)
    opened.callback(source.close)
    return source


def _masks(wanted: SourceConfig, source: Source, model: Bundle | None) -> CameraMasks:
    """Find what is no view in a run; raise ToktError if the options cannot be meant."""
    if wanted.mask is not None:
        return parse_masks(wanted.mask, () if model is None else model.masks)
    return _masks_beside(source)


def _masks_beside(source: Source) -> CameraMasks:
    return source.mission.masks if isinstance(source, MissionSource) else CameraMasks()


def _say_masks(
    masks: CameraMasks, wanted: SourceConfig, source: Source, model: Bundle | None
) -> None:
    """Say what is no view in a run, and where that is not what one would expect."""
    beside = _masks_beside(source)
    if masks:
        say(masks.words())
    if beside and masks != beside:
        say("note: the mask beside the frames is not used: --mask says another one")
    if model is not None and model.masks and not masks and wanted.mask is None:
        say(
            f"WARNING: model {model.label} learnt from pictures with a mask, and this run has "
            f"none ({joined(model.masks).words()}). Use it with --mask model, or say --mask none"
        )


def _check_pictures(config: RunConfig, model: RunModel, source: Source) -> None:
    """Raise ToktError if a model cannot judge the pictures of a source.

    Or if recorded frames have another size than those that the options call sharp.
    """
    if config.source.pixel_format == "Mono8" and model.bundle and model.bundle.needs_colour:
        label = model.bundle.label
        raise ToktError(f"model {label} looks at colours: not with --pixel-format Mono8")
    sight = model.sight
    if not sight or not isinstance(source, MissionSource):
        return
    try:
        width, height = frame_size(source.mission)
    except ToktError:
        return  # there is no frame to judge
    if (height, width) not in {(one.height, one.width) for one in sight}:
        raise ToktError(
            f"--sharp-frames has {sight[0].width}x{sight[0].height} frames, and the source's are "
            f"{width}x{height}: name frames of the same camera, of the same size"
        )


def _start_event(config: RunConfig, model: RunModel, source: Source, masks: CameraMasks) -> Event:
    """How the run begins, for the log."""
    bundle, named = model.bundle, config.source.source
    is_kept = config.recording.log is not None or config.recording.record is not None
    is_path = not (is_camera_source(named) or is_stream_source(named))
    start = RunStart.of(
        config,
        # Whole paths: a replay begins somewhere else.
        source=str(Path(named).absolute()) if is_path else without_credentials(named),
        live=source.live,
        model=None if bundle is None else ModelName(bundle.label, bundle.sha256),
        model_fault=model.fault,
        model_note=model.note,
        masks=masks.to_json() if masks else None,
        sight=None if model.sight is None else sight_to_json(model.sight),
        frame_rule=None if bundle is None else bundle.operating_point.rule.to_json(),
        software=software() if is_kept else {},  # asking for versions takes a tenth of a start
    )
    again = restarts()
    words = f"tokt run on {without_credentials(named)}, policy {start.policy}"
    if again:
        words += f", started again by its watchdog ({again})"
    return Event(SYSTEM_CLOCK.time(), "start", words, {**start.fields(), "restarts": again})
