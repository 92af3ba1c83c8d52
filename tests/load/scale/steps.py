"""The steps of training, timed one by one in a process of their own.

Run as ``python -m tests.load.scale.steps FOLDER MISSION STEP...``; what it prints is for
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
from sklearn.pipeline import Pipeline

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.features.extractors.extractor import extractor_named
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import open_mission
from tokt.labels.taxonomy import Taxonomy
from tokt.training.datasets.dataset import DatasetVersion, build_dataset, open_dataset
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.mission_source import LabelledMission, plan_from_missions, read_labels
from tokt.training.datasets.splits import EMBARGO_FRAMES, FOLDS, blocked_folds
from tokt.training.fitting.choose_operating_point import DEFAULT_TARGET, choose_frame_rule
from tokt.training.fitting.classifier import decision_values, fit_classifier, linear_model
from tokt.training.fitting.cross_validation import HeldOutPredictions, Split, held_out_metrics
from tokt.training.fitting.presets import settings_named
from tokt.training.search.space import Trial
from tokt.training.search.trial import TrialTask, run_task

from .mission import NAME

EXTRACTOR = "lbp_24_8+lbp_24_8_frame"
"""Of middle cost; by name, so that figures stay comparable when presets change."""
BUILD, ONE_JOB, TWO_JOBS = "build", "features_1_job", "features_2_jobs"
FIT, FIGURES, TRIAL = "fit", "figures", "search_trial"
_SETTINGS = settings_named("plain")
_CHOICE = _SETTINGS.choices[len(_SETTINGS.choices) // 2]
_SPLIT = Split(FOLDS, EMBARGO_FRAMES)


LABELS = "labels.csv"


class Steps:
    """Training on the frames of a mission that are labelled in a folder; a method is a step."""

    def __init__(self, folder: Path, mission: Path) -> None:
        self._folder, self._mission = folder, mission
        self._spec = extractor_named(EXTRACTOR).spec

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

    @cached_property
    def _features(self) -> F64:
        return self._table(1)

    def _table(self, jobs: int) -> F64:
        cache = self._folder / f"cache-{jobs}"
        return cached_features(self._dataset, self._spec, cache, _quiet, jobs)

    def build(self) -> dict[str, Any]:
        taxonomy = Taxonomy.load()
        labels = read_labels([self._folder / LABELS], taxonomy, DEFAULT_GRID)
        mission = LabelledMission(open_mission(self._mission), labels)
        plan, _ = plan_from_missions(NAME, "binary", [mission], taxonomy)
        dataset = build_dataset(plan, self._folder / "datasets", _quiet)
        stored = sum(file.stat().st_size for file in dataset.path.rglob("*") if file.is_file())
        return {"patches": len(dataset.patches), "stored_mb": stored / 1e6}

    def features_1_job(self) -> dict[str, Any]:
        """Into the cache that all later steps read."""
        return {"features": self._features.shape[1], "table_mb": self._features.nbytes / 1e6}

    def features_2_jobs(self) -> dict[str, Any]:
        """The same by two processes."""
        table = self._table(2)
        return {"features": table.shape[1], "table_mb": table.nbytes / 1e6}

    @cached_property
    def _pipeline(self) -> Pipeline:
        return fit_classifier(self._features, self._dataset.targets(), _CHOICE, _SETTINGS)

    def fit(self) -> dict[str, Any]:
        return {"penalty": _CHOICE.penalty, "solver_steps": int(self._pipeline["svc"].n_iter_)}

    def figures(self) -> dict[str, Any]:
        """Folds, operating point and figures, of values that any model might have given."""
        dataset, targets = self._dataset, self._dataset.targets()
        model = linear_model(self._pipeline, dataset.classes(), dataset.obstacle_flags())
        values = decision_values(self._pipeline, self._features)
        number = np.full(len(targets), -1)
        folds = blocked_folds(dataset.patches, targets, _SPLIT.folds, _SPLIT.embargo_frames)
        for index, fold in enumerate(folds):
            number[fold.test] = index
        tested = np.ones(len(targets), bool)
        rule, _ = choose_frame_rule(dataset, model.obstacle_score(values), tested, DEFAULT_TARGET)
        ways = len(folds)
        held_out = HeldOutPredictions(values, number, (_CHOICE,) * ways, (rule,) * ways)
        held_out_metrics(dataset, held_out, model)
        return {}

    def search_trial(self) -> dict[str, Any]:
        """A trial of a search, and the part of training that takes longest."""
        trial = Trial(EXTRACTOR, self._spec, extractor_named(EXTRACTOR).dim, 1)
        places = (self._dataset.path, self._folder / "cache-1", self._folder / "trial.json")
        outcome = run_task(TrialTask(trial, *places, _SETTINGS, _SPLIT))
        if outcome.fault is not None:
            raise ToktError(outcome.fault)
        inner = (_SPLIT.folds - 1) * len(_SETTINGS.choices)
        return {"fits": _SPLIT.folds * (inner + 1)}


def _quiet(items: Iterable[Any], total: int, what: str) -> Iterator[Any]:
    yield from items


if __name__ == "__main__":
    Steps(Path(sys.argv[1]), Path(sys.argv[2])).run(sys.argv[3:])
