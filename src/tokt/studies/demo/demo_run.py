"""The state of a demo: everything its steps have made and measured, for the report."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from tokt.features.frames.mission import Mission
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import Taxonomy
from tokt.models.bundle.bundle import Bundle
from tokt.training.compare.bootstrap import Difference
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.evaluation.evaluate import ScoredMission
from tokt.training.fitting.train import Trained

from .replay import DemoReplay

Say = Callable[[str], None]


@dataclass
class DemoRun:
    """Everything a demo found, for its report.

    Parameters
    ----------
    mission : Mission
    records : list of LabelRecord
        All labels of it.
    rendered : bool
        Whether the mission is a rendered one.
    block_frames, embargo_frames : int
        How the mission is cut into blocks, and the gap between parts.
    train_frames, held_frames : list of int
        Labelled frames learnt from, and held back (with a gap between them).
    seconds : dict
        Wall time of each stage.
    """

    mission: Mission
    records: list[LabelRecord]
    taxonomy: Taxonomy
    rendered: bool
    block_frames: int
    embargo_frames: int
    train_frames: list[int]
    held_frames: list[int]
    dataset: DatasetVersion | None = None
    trained: dict[str, Trained] = field(default_factory=dict)
    bundles: dict[str, Bundle] = field(default_factory=dict)
    scored: dict[str, ScoredMission] = field(default_factory=dict)
    evaluations: dict[str, dict[str, Any]] = field(default_factory=dict)
    difference: Difference | None = None
    champion: str = ""
    replay: DemoReplay | None = None
    skew: float = float("nan")
    disagreements: int = -1
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def unknown(self) -> int:
        """Replayed frames that the runtime could not judge."""
        return sum(entry["status"] == -1 for entry in self.replay.log) if self.replay else 0

    @contextmanager
    def stage(self, name: str, say: Say) -> Iterator[None]:
        """Time one stage and say when it begins."""
        say(f"-- {name}")
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start
