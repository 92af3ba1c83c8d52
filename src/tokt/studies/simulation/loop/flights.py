"""Many flights: every scene with every method, for some seeds, on several processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.training.parallel import mapped

from .flight import METHODS, NONE, Flight, fly
from .scenes import KINDS, draw_scene
from .track import Track

FIRST_TUNING_SEED = 1000
"""Planner and scenes were worked out on seeds from here on; those below are for what is reported.

Seeds 1 to 100 of the tower scene led to the model's sequences of open water (docs/closed_loop.md).
"""

Progress = Callable[..., Any]


@dataclass(frozen=True)
class RunsRequest:
    """The flights to fly: scenes, methods and seeds.

    Parameters
    ----------
    scenes, methods : sequence of str
    seeds : sequence of int
    width : int
        Of the frames, in pixels.
    model : Path
        The bundle, for the methods that use one (`uses_model`); not read for others.
    jobs : int
        Processes; -1 for one a core.

    Raises
    ------
    ToktError
        If a scene or a method is not known or named twice, or there is nothing to fly.
    """

    scenes: Sequence[str]
    methods: Sequence[str]
    seeds: Sequence[int]
    width: int
    model: Path
    jobs: int = -1

    def __post_init__(self) -> None:
        for what, asked, known in (
            ("scene", self.scenes, tuple(KINDS)),
            ("method", self.methods, METHODS),
        ):
            for name in asked:
                if name not in known:
                    raise ToktError(f"unknown {what} {name!r} (choose from {', '.join(known)})")
            if not asked or len(set(asked)) < len(asked):
                raise ToktError(f"name each {what} once, and at least one")
        if not self.seeds:
            raise ToktError("at least one run of each scene and method is needed")


@dataclass(frozen=True)
class _FlightTask:
    scene: str
    method: str
    seed: int
    width: int
    model: Path


def fly_all(request: RunsRequest, progress: Progress) -> list[Track]:
    """Fly them all.

    Returns
    -------
    list of Track
        By scene, then method, then seed, as asked.
    """
    tasks = [
        _FlightTask(scene, method, seed, request.width, request.model)
        for scene in request.scenes
        for method in request.methods
        for seed in request.seeds
    ]
    flown = mapped(_fly, tasks, request.jobs)
    return list(progress(flown, len(tasks), "closed loop"))


def uses_model(method: str) -> bool:
    """Whether a method judges frames with a model."""
    return method not in ("disparity", NONE)


def _fly(task: _FlightTask) -> Track:
    scene = draw_scene(task.scene, task.seed, task.width)
    model = task.model if uses_model(task.method) else None
    return fly(Flight(scene, task.method, model))
