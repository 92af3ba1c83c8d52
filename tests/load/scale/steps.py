"""The steps of training, timed one by one in a process of their own.

Run as ``python -m tests.load.scale.steps FOLDER DIVES FRAMES STEP...``; what it prints is for
`cost.watched`.
"""

import json
import sys
import time
from collections.abc import Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64
from tokt.features.extractors.extractor import extractor_named
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import open_mission
from tokt.labels.taxonomy import Taxonomy
from tokt.training.datasets.dataset import DatasetVersion, open_dataset, write_dataset
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.folds import EMBARGO_FRAMES, FOLDS
from tokt.training.datasets.mission_source import LabelledMission, plan_from_missions, read_labels
from tokt.training.datasets.split import Split
from tokt.training.fitting.classifier import fit_rows
from tokt.training.fitting.presets import settings_named
from tokt.training.fitting.train import TrainRequest, fit_and_measure

from .mission import DIVE_FRAMES, LABELS, NAME

EXTRACTOR = "water_gray"  # the rendered frames have no colours
BUILD, ONE_JOB, TWO_JOBS = "build", "features_1_job", "features_2_jobs"
FIT, TRAINING = "fit", "training"
_SETTINGS = settings_named("water")


class Steps:
    """Training on the first frames of some dives; a method is a step."""

    def __init__(self, folder: Path, dives: Path, frames: int) -> None:
        self._folder = folder
        self._dives = sorted(dives.iterdir())[: -(-frames // DIVE_FRAMES)]
        self._extractor = extractor_named(EXTRACTOR)

    def run(self, names: Iterable[str]) -> None:
        """Do some steps and print after each what `cost.watched` reads."""
        for name in names:
            began = time.monotonic()
            facts = getattr(self, name)()
            times = {"step": name, "began": began, "ended": time.monotonic()}
            print(json.dumps({**times, **facts}), flush=True)

    @cached_property
    def _dataset(self) -> DatasetVersion:
        return open_dataset(NAME, self._folder / "datasets")

    def _table(self, jobs: int, cache: str) -> F64:
        asked = self._dataset, self._extractor.spec, self._folder / cache, _quiet, jobs
        return cached_features(*asked, whole_frames=True)

    def build(self) -> dict[str, Any]:
        taxonomy = Taxonomy.load()
        missions = [
            LabelledMission(
                open_mission(dive), read_labels([dive / LABELS], taxonomy, DEFAULT_GRID)
            )
            for dive in self._dives
        ]
        plan, _ = plan_from_missions(NAME, "binary", missions, taxonomy)
        dataset = write_dataset(plan, self._folder / "datasets", _quiet)
        stored = sum(file.stat().st_size for file in dataset.path.rglob("*") if file.is_file())
        return {"patches": len(dataset.patches), "stored_mb": stored / 1e6}

    def features_1_job(self, jobs: int = 1, cache: str = "cache") -> dict[str, Any]:
        """Into the cache that all later steps read."""
        table = self._table(jobs, cache)
        return {"features": table.shape[1], "table_mb": table.nbytes / 1e6}

    def features_2_jobs(self) -> dict[str, Any]:
        """The same by two processes."""
        return self.features_1_job(2, "cache-2")

    def fit(self) -> dict[str, Any]:
        """One model of all patches: what cross-validation does again and again."""
        data, choice = self._dataset, _SETTINGS.choices[0]
        rows, table = np.arange(len(data.patches)), self._table(1, "cache")
        dives = Split.of(data, FOLDS, EMBARGO_FRAMES).dives(data.patches)
        made = fit_rows(table, data.targets(), rows, choice, _SETTINGS, (), dives)
        return {"penalty": choice.penalty, "solver_steps": int(np.max(made["svc"].n_iter_))}

    def training(self) -> dict[str, Any]:
        """All that `tokt train` does once there are features, but for MLflow's record."""
        split = Split.of(self._dataset, FOLDS, EMBARGO_FRAMES)
        request = TrainRequest(self._dataset, NAME, self._extractor, EXTRACTOR, _SETTINGS, split)
        made = fit_and_measure(request, self._folder / "cache", _quiet)
        return {"f1": made.metrics["patch"]["f1"], "tested": made.metrics["patches_tested"]}


def _quiet(items: Iterable[Any], total: int, what: str) -> Iterator[Any]:
    yield from items


if __name__ == "__main__":
    Steps(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])).run(sys.argv[4:])
