"""Put a runtime together as `tokt run` was asked to, and run it to its end."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path

from ..features.errors import ToktError
from ..features.mission import parse_frames
from ..inference.anchor import Anchor
from ..inference.assemble import Assembly, Stereo, assemble
from ..inference.cameras.open import is_camera_source
from ..inference.clock import SYSTEM_CLOCK
from ..inference.detector import GridDetector
from ..inference.drift import DriftMonitor
from ..inference.event_queue import EventQueue
from ..inference.frame_stream import StreamSource, is_stream_source
from ..inference.interrupt import stop_on_signal
from ..inference.limits import Limits
from ..inference.notify import Notifier
from ..inference.observer import Event
from ..inference.reload import ModelWatch
from ..inference.run_start import ModelName, RunStart, used_file
from ..inference.runtime import Runtime
from ..inference.sources import Source, open_source
from ..inference.stereo_ways import BM, HALF
from ..inference.watchdog import RESTARTS_VARIABLE
from ..models.bundle import Bundle, read_bundle
from ..models.last_good import load_running
from ..models.store import Store
from .output import say
from .run_asked import Asked
from .run_check import check
from .run_done import Done
from .run_outlets import open_onlookers, open_senders
from .stereo_file import read_calibration_file


@dataclass
class Model:
    """The model a run begins with.

    Parameters
    ----------
    load : callable or None
        Loads it; None where none was asked for.
    bundle : Bundle or None
        It, once loaded.
    fault : str
        Why it could not be loaded.
    notes : list of str
        Why it is not the store's active one.
    """

    load: Callable[[], Bundle] | None = None
    bundle: Bundle | None = None
    fault: str = ""
    notes: list[str] = field(default_factory=list)

    def words(self) -> list[str]:
        """Lines for people."""
        lines = [f"WARNING: {note}" for note in self.notes]
        return lines if self.bundle is None else [*lines, _rule_line(self.bundle)]


def carry_out(asked: Asked) -> Done:
    """Run until the source ends or somebody stops it.

    Raises
    ------
    ToktError
        If something that was asked for cannot be had.
    """
    check(asked)
    events = EventQueue()
    limits = Limits(asked.stale, asked.heartbeat)
    with ExitStack() as opened:
        pairs = _stereo(asked)
        source = _source(asked, pairs, events, opened)
        senders = open_senders(asked, pairs, opened)
        model = _model(asked)
        anchor = None if asked.anchor is None else Anchor(asked.anchor)
        assembly = assemble(asked.policy, model.load, pairs, asked.threads, anchor=anchor)
        if assembly.texture is not None:
            assembly.texture.note = "; ".join(model.notes)
        looking = open_onlookers(asked, pairs, senders, source, events, opened)
        for line in model.words():
            say(line)
        looking.show(opened)
        looking.drift.set_model(model.bundle)
        watch = _model_watch(asked, model, assembly, looking.drift, opened)
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
        events.put(_start_event(asked, model, source, limits))
        # What was made up to here stays: the collector need not go through it at sea.
        gc.freeze()
        with stop_on_signal(source.stop):
            notifier.ready()
            summary = runtime.run()
            notifier.stopping()
    summary.log_failures = 0 if looking.log is None else looking.log.failed
    return Done(asked, model.bundle, list(senders.values()), summary)


def _stereo(asked: Asked) -> Stereo | None:
    """How pairs are looked at, or None without a calibration."""
    if asked.calibration is None:
        if (asked.stereo, asked.stereo_scale, asked.odometry) != (BM, HALF, None):
            raise ToktError("stereo needs a calibration (--calibration FILE.yml)")
        return None
    from ..inference.odometry import load_odometry

    poses = None if asked.odometry is None else load_odometry(asked.odometry)
    calibration = read_calibration_file(asked.calibration)
    return Stereo(calibration, asked.stereo, asked.stereo_scale, poses)


def _source(asked: Asked, pairs: Stereo | None, events: EventQueue, opened: ExitStack) -> Source:
    if is_stream_source(asked.source):
        return opened.enter_context(closing(StreamSource(asked.source, SYSTEM_CLOCK)))
    if not is_camera_source(asked.source):
        chosen = None if asked.frames is None else parse_frames(asked.frames)
        read_right = pairs is not None
        return open_source(
            asked.source, SYSTEM_CLOCK, chosen, asked.rate, read_right, asked.pixel_format
        )
    from ..inference.cameras.open import open_camera_source
    from ..inference.cameras.options import GIGABIT_BYTES_S, CameraOptions

    wanted = CameraOptions(
        exposure_us=asked.exposure_us,
        gain_db=asked.gain_db,
        pixel_format=asked.pixel_format,
        packet_size=asked.packet_size,
        bandwidth_bytes_s=GIGABIT_BYTES_S if asked.bandwidth is None else asked.bandwidth,
        frame_rate=asked.camera_rate,
        trigger=asked.trigger,
        ptp=asked.ptp,
        wait=asked.wait,
    )
    source = open_camera_source(asked.source, SYSTEM_CLOCK, wanted, events.put)
    opened.callback(source.close)
    return source


def _model(asked: Asked) -> Model:
    """What loads the model, and remembers what came of it."""
    model = Model()

    def load() -> Bundle:
        try:
            if asked.bundle is not None:
                model.bundle = read_bundle(asked.bundle)
            elif asked.store is not None:
                model.bundle, model.notes = load_running(Store(asked.store))
            else:
                raise AssertionError("neither a store nor a bundle was given")
        except ToktError as error:
            model.fault = str(error)
            raise
        return model.bundle

    if asked.store is not None or asked.bundle is not None:
        model.load = load
    return model


def _rule_line(bundle: Bundle) -> str:
    rule = bundle.operating_point.rule
    late = f"; {rule.latency_words()}" if rule.latency_frames else ""
    return f"model {bundle.label}: status 1 with {rule.words()}{late}"


def _model_watch(
    asked: Asked, model: Model, assembly: Assembly, drift: DriftMonitor, opened: ExitStack
) -> ModelWatch | None:
    """What goes over to a store's next model, where there is a store."""
    slot = assembly.texture
    if asked.store is None or slot is None:
        return None

    def put(bundle: Bundle) -> None:
        slot.put(GridDetector(bundle, asked.threads))
        drift.set_model(bundle)

    watch = ModelWatch(
        *(Store(asked.store), model.bundle, assembly.misfit, put, SYSTEM_CLOCK),
        is_active=not model.notes,
    )
    watch.start()
    opened.callback(watch.close)
    return watch


def _start_event(asked: Asked, model: Model, source: Source, limits: Limits) -> Event:
    """How the run begins, for the log."""
    bundle, stereo = model.bundle, asked.calibration is not None
    is_path = not (is_camera_source(asked.source) or is_stream_source(asked.source))
    place = asked.store or asked.bundle
    start = RunStart(
        # Whole paths: a replay begins somewhere else.
        source=str(Path(asked.source).absolute()) if is_path else asked.source,
        policy=asked.policy,
        live=source.live,
        limits=limits,
        model=None if bundle is None else ModelName(bundle.label, bundle.sha256),
        model_fault=model.fault,
        model_note="; ".join(model.notes),
        models_from="" if place is None else str(place.absolute()),
        stereo_way=asked.stereo if stereo else None,
        stereo_scale=asked.stereo_scale if stereo else None,
        calibration=None if asked.calibration is None else used_file(asked.calibration),
        odometry=None if asked.odometry is None else used_file(asked.odometry),
        pixel_format=asked.pixel_format,
        threads=asked.threads,
        frame_rule=None if bundle is None else bundle.operating_point.rule.to_json(),
        record=None if asked.record is None else str(asked.record),
        anchor=asked.anchor,
    )
    restarts = int(os.environ.get(RESTARTS_VARIABLE, "0"))
    words = f"tokt run on {asked.source}, policy {asked.policy}"
    if restarts:
        words += f", started again by its watchdog ({restarts})"
    return Event(SYSTEM_CLOCK.time(), "start", words, {**start.fields(), "restarts": restarts})
