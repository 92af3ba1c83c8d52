"""One trial: the nested cross-validation of an extractor, kept when it is finished."""

import copy
import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from tokt.features.common.arrays import I64
from tokt.features.common.errors import ToktError
from tokt.labels.formats.options import no_progress
from tokt.training.datasets.changed_patches import changed_patches
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.split import BLOCKS, Split
from tokt.training.fitting.cross_validation import cross_validate
from tokt.training.fitting.presets import TrainingSettings

from .score import tally
from .space import Trial
from .state import Finished, write_finished


@dataclass(frozen=True)
class TrialTask:
    """A trial to be run, on any process that sees the same files."""

    trial: Trial
    dataset: Path
    cache: Path  # of features
    file: Path  # for the outcome
    settings: TrainingSettings
    split: Split  # of the whole search
    outer_fold: int | None = None  # use nothing but the training part of this fold
    not_after: float | None = None  # time (s since 1970) after which it is not begun any more


@dataclass(frozen=True)
class TrialOutcome:
    """Result of a trial, or its error."""

    task: TrialTask
    finished: Finished | None = None
    fault: str | None = None  # why the extractor cannot be tried; with neither, the time was up


def run_task(task: TrialTask) -> TrialOutcome:
    """Run a trial and keep its outcome; the same on every process."""
    if task.not_after is not None and time.time() > task.not_after:
        return TrialOutcome(task)
    began = time.monotonic()
    dataset, split = _dataset(task.dataset), task.split
    try:
        asked = dataset, task.trial.spec
        features = cached_features(*asked, task.cache, no_progress, 1)
        augmented = [
            changed_patches(*asked, name, task.cache, no_progress, 1)
            for name in task.settings.changes
        ]
        if task.outer_fold is not None:
            rows = split.cut(dataset.patches, dataset.targets())[task.outer_fold].train
            dataset, features = part_of(dataset, rows), features[rows]
            augmented = [table.part(rows) for table in augmented]
            split = split.inner
        held_out = cross_validate(
            dataset, features, task.settings, split, no_progress, augmented=augmented
        )
    except ToktError as error:
        return TrialOutcome(task, fault=str(error))
    seconds = time.monotonic() - began
    by_dive = split.unit(dataset.patches) != BLOCKS
    finished = Finished(tally(dataset, held_out, by_dive), tuple(held_out.choices), seconds)
    write_finished(task.file, finished)
    return TrialOutcome(task, finished)


@lru_cache(maxsize=1)
def _dataset(path: Path) -> DatasetVersion:
    return DatasetVersion(path)


def part_of(dataset: DatasetVersion, rows: I64) -> DatasetVersion:
    """The same dataset with some of its patches only; its frames stay."""
    part = copy.copy(dataset)
    part.patches = dataset.patches.iloc[rows].reset_index(drop=True)
    return part
