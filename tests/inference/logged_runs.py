"""Bundles that differ in a known way, and runs of them that are logged."""

import itertools
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tokt.features.frames.mission import open_mission
from tokt.inference.clock import SYSTEM_CLOCK, SYSTEM_STOPWATCH, Clock
from tokt.inference.policy.assembly import Assembly, assemble
from tokt.inference.policy.object_naming import ObjectNaming
from tokt.inference.policy.temporal_cues import Anchor
from tokt.inference.recording.run_log import RunLog
from tokt.inference.recording.run_start import ModelName, RunStart, UsedFile, new_run_id
from tokt.inference.report import START, Event, EventQueue
from tokt.inference.runtime import Runtime
from tokt.inference.sources.files import MissionSource
from tokt.inference.texture.detector import TextureDetector
from tokt.models.bundle.bundle import Bundle, Golden, bundle_bytes, read_bundle
from tokt.models.operating_point import MofNRule, OperatingPoint


def variant(like, path, threshold=0.0, rule=None, golden=None) -> Path:
    """A bundle with another threshold or frame rule, or for frames of another size."""
    bundle = read_bundle(like)
    content = bundle.content
    model = replace(content.model, thresholds=np.array([threshold]))
    values, frames = content.golden.decision_values, content.golden.frames
    if golden is not None:
        values = bundle.decision_values(golden)[None]
        frames = (cv2.imencode(".png", golden)[1].tobytes(),)
    obstacle = np.array([model.obstacle_patches(each) for each in values])
    content = replace(
        content,
        name=path.stem,
        model=model,
        golden=Golden(frames, values, obstacle),
        operating_point=OperatingPoint(rule or MofNRule()),
    )
    path.write_bytes(bundle_bytes(content))
    return path


class Seconds:
    """A stopwatch that says what a test wants, call by call, and then 0."""

    def __init__(self, *seconds: float) -> None:
        self._seconds = list(seconds)

    def took(self, call: Callable[[], Any]) -> tuple[Any, float]:
        return call(), self._seconds.pop(0) if self._seconds else 0.0


class Switch:
    """Another model, or the same anew, before given rounds of the loop."""

    def __init__(self, clock: Clock, at: dict[int, Bundle]) -> None:
        self._clock = clock
        self._at = at
        self._round = 0
        self.assembly: Assembly | None = None

    def between(self) -> Sequence[Event]:
        self._round += 1
        bundle = self._at.get(self._round)
        if bundle is None:
            return ()
        self.assembly.texture.put(TextureDetector(bundle))
        fields = {"label": bundle.label, "sha256": bundle.sha256}
        return [Event(self._clock.time(), "model", "another model", fields)]


def log_run(
    source,
    start,
    log,
    clock,
    model,
    stereo=None,
    stopwatch=SYSTEM_STOPWATCH,
    switch=None,
    observers=lambda run: (),
    values=True,
    named=None,
    named_after=0,
):
    """Run a source to its end, with a log; its run's id."""
    run = new_run_id(clock)
    load = model if callable(model) else lambda: model
    anchor = None if start.anchor is None else Anchor(start.anchor)
    said = {"anchor": anchor, "moving": start.moving}
    assembly = assemble(start.policy, load, stereo, stopwatch=stopwatch, **said)
    watching = [RunLog(log, run, values=values), *observers(run)]
    if assembly.texture is not None:
        assembly.texture.note = start.model_note
    switch = switch or Switch(clock, {})
    switch.assembly = assembly
    events = EventQueue()
    events.put(Event(clock.time(), START, "a run", start.fields()))
    policy, limits = assembly.policy, start.limits
    naming = ObjectNaming(policy, clock.time)
    calls = itertools.count()

    def between():
        if next(calls) == named_after and named is not None:
            naming.name_before(named, source.mission, None)
        return [*switch.between(), *naming.take()]

    Runtime(source, policy, [], clock, watching, limits, events, between).run()
    for observer in watching:
        observer.close()
    return run


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def write_lines(path: Path, values: Iterable[Any]) -> Path:
    path.write_text("".join(json.dumps(value) + "\n" for value in values))
    return path


def texture_start(folder: Path, bundle: Path, **more: Any) -> RunStart:
    """How a run of policy texture begins."""
    model = read_bundle(bundle)
    name = ModelName(model.label, model.sha256)
    start = RunStart(str(folder), "texture", model=name, models_from=str(bundle))
    return replace(start, **more)


def stereo_start(start: RunStart, policy: str, calibration: UsedFile) -> RunStart:
    """The same with a pair of cameras."""
    return replace(start, policy=policy, stereo_way="bm", stereo_scale=0.5, calibration=calibration)


class Unhurried(MissionSource):
    """At a rate by a clock that a test moves, and yet every frame is waited for."""

    live = False


def mission_source(folder: Path, clock: Clock, rate: float | None = None) -> MissionSource:
    """Each frame of a folder."""
    return Unhurried(open_mission(folder), clock, rate=rate)


def log_folder(folder, bundle, log, clock=SYSTEM_CLOCK, rate=None, how=None, **start) -> str:
    """Run policy texture over each frame of a folder, with a log; the run's id.

    `start` are what the run began with, and `how` what else `log_run` takes.
    """
    source, begun = mission_source(folder, clock, rate), texture_start(folder, bundle, **start)
    return log_run(source, begun, log, clock, read_bundle(bundle), **(how or {}))
