"""A runtime put together as its description says, run to its end, and its result."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tokt.cli.interrupt import stop_on_signal
from tokt.cli.output import say
from tokt.cli.stereo_file import read_calibration_file
from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import parse_frames
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import ModelConfig, RunConfig, StereoConfig
from tokt.inference.frame import Source
from tokt.inference.monitoring.drift import DriftMonitor
from tokt.inference.monitoring.reload import ModelReloader
from tokt.inference.monitoring.watchdog import RESTARTS_VARIABLE, Notifier
from tokt.inference.policy.assembly import Assembly, StereoSetup, assemble
from tokt.inference.policy.temporal_cues import Anchor
from tokt.inference.publisher import Sender
from tokt.inference.recording.run_start import ModelName, RunStart
from tokt.inference.report import Event, EventQueue
from tokt.inference.runtime import Runtime, Summary
from tokt.inference.sources.cameras.open import is_camera_source, open_camera_source
from tokt.inference.sources.files import open_source
from tokt.inference.sources.stream import StreamSource, is_stream_source
from tokt.inference.texture.detector import TextureDetector
from tokt.models.bundle.bundle import Bundle, read_bundle
from tokt.models.store.last_good import load_running
from tokt.models.store.store import Store

from .check import check
from .outputs import open_observers, open_senders


class RunModel:
    """The model a run begins with.

    Parameters
    ----------
    wanted : ModelConfig

    Attributes
    ----------
    bundle : Bundle or None
        It, once loaded.
    fault : str
        Why it could not be loaded.
    notes : list of str
        Why it is not the store's active one.
    """

    def __init__(self, wanted: ModelConfig) -> None:
        self.bundle: Bundle | None = None
        self.fault = ""
        self.notes: list[str] = []
        self._wanted = wanted

    @property
    def loader(self) -> Callable[[], Bundle] | None:
        """What loads it; None where none was asked for."""
        return self._load if self._wanted.store or self._wanted.bundle else None

    def _load(self) -> Bundle:
        try:
            if self._wanted.bundle is not None:
                self.bundle = read_bundle(self._wanted.bundle)
            else:
                assert self._wanted.store is not None
                self.bundle, self.notes = load_running(Store(self._wanted.store))
        except ToktError as error:
            self.fault = str(error)
            raise
        return self.bundle

    def words(self) -> list[str]:
        """Lines for people."""
        lines = [f"WARNING: {note}" for note in self.notes]
        if self.bundle is None:
            return lines
        rule = self.bundle.operating_point.rule
        late = f"; {rule.latency_words()}" if rule.latency_frames else ""
        return [*lines, f"model {self.bundle.label}: status 1 with {rule.words()}{late}"]


@dataclass(frozen=True)
class RunResult:
    """A run that has ended.

    Parameters
    ----------
    config : RunConfig
    model : Bundle or None
        What it began with.
    senders : list of Sender
    summary : Summary
    """

    config: RunConfig
    model: Bundle | None
    senders: list[Sender]
    summary: Summary

    def words(self) -> str:
        """One line for people."""
        summary = self.summary
        line = (
            f"{summary.frames} frames in {summary.seconds:.1f} s: {summary.obstacle} obstacle, "
            f"{summary.clear} clear, {summary.unknown} unknown; {summary.sent} datagrams sent"
        )
        if summary.send_failures:
            reasons = sorted({sender.last_error for sender in self.senders if sender.last_error})
            line += f", {summary.send_failures} refused ({', '.join(reasons)})"
        if summary.heartbeats or summary.dropped:
            line += f"; {summary.heartbeats} heartbeats, no time for {summary.dropped} frames"
        if summary.log_failures:
            line += f"; {summary.log_failures} log lines could not be written"
        return line

    def to_json(self) -> dict[str, Any]:
        """What ``--json`` prints; without a model its figures are None."""
        rule = self.model and self.model.operating_point.rule
        return {
            "policy": self.config.policy.policy,
            "format": self.config.outputs.format,
            "model": self.model and self.model.label,
            "frame_rule": rule and rule.to_json(),
            "latency_frames": rule and rule.latency_frames,
            **self.summary.to_json(),
        }


def carry_out(config: RunConfig) -> RunResult:
    """Run until the source ends or somebody stops it.

    Raises
    ------
    ToktError
        If something that was asked for cannot be had.
    """
    check(config)
    events = EventQueue()
    limits = config.limits
    with ExitStack() as opened:
        pairs = _stereo(config)
        source = _source(config, pairs, events, opened)
        senders = open_senders(config, pairs, opened)
        model = RunModel(config.model)
        size = config.policy.anchor
        anchor = None if size is None else Anchor(size)
        threads = config.model.threads
        assembly = assemble(config.policy.policy, model.loader, pairs, threads, anchor=anchor)
        if assembly.texture is not None:
            assembly.texture.note = "; ".join(model.notes)
        looking = open_observers(config, pairs, senders, source, events, opened)
        for line in model.words():
            say(line)
        looking.show(opened)
        looking.drift.set_model(model.bundle)
        watch = _model_watch(config, model, assembly, looking.drift, opened)
        notifier = opened.enter_context(closing(Notifier(SYSTEM_CLOCK)))

        def alive() -> None:
            notifier.alive()
            if notifier.orphaned:
                source.stop()

        runtime = Runtime(
            *(source, assembly.policy, list(senders.values()), SYSTEM_CLOCK),
            observers=looking.observers,
            limits=limits,
            events=events,
            between=tuple if watch is None else watch.exchange,
            alive=alive,
        )
        events.put(_start_event(config, model, source))
        # What was made up to here stays: the collector need not go through it at sea.
        gc.freeze()
        with stop_on_signal(source.stop):
            notifier.ready()
            summary = runtime.run()
            notifier.stopping()
    summary.log_failures = 0 if looking.log is None else looking.log.failed
    return RunResult(config, model.bundle, list(senders.values()), summary)


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

    def put(bundle: Bundle) -> None:
        slot.put(TextureDetector(bundle, config.model.threads))
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
        source=str(Path(named).absolute()) if is_path else named,
        live=source.live,
        model=None if bundle is None else ModelName(bundle.label, bundle.sha256),
        model_fault=model.fault,
        model_note="; ".join(model.notes),
        frame_rule=None if bundle is None else bundle.operating_point.rule.to_json(),
    )
    restarts = int(os.environ.get(RESTARTS_VARIABLE, "0"))
    words = f"tokt run on {named}, policy {start.policy}"
    if restarts:
        words += f", started again by its watchdog ({restarts})"
    return Event(SYSTEM_CLOCK.time(), "start", words, {**start.fields(), "restarts": restarts})
