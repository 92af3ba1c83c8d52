"""Predictions of the compared models, on the same patches and frames."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from tokt.features.common.arrays import F64, I64, U8, Bools
from tokt.models.bundle.bundle import Bundle
from tokt.models.linear import LinearModel
from tokt.models.operating_point import MofNRule
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.datasets.folds import held_out_together
from tokt.training.datasets.split import BLOCKS, DIVES
from tokt.training.evaluation.approaches import NOTHING_STATED, AtSea, KnownDistances
from tokt.training.evaluation.metrics import class_metrics, metrics_by, obstacle_metrics

from .bootstrap import block_numbers
from .frames import FrameSeries, frame_figures, statuses

HELD_OUT, MISSION = "held out", "mission"


@dataclass(frozen=True)
class ModelPredictions:
    """One model, and what it says of every patch and frame that is compared."""

    bundle: Bundle
    targets: I64  # (n_patches,): index of each label among `classes`
    predicted: I64  # (n_patches,)
    classes: tuple[str, ...]  # the model's, and whatever else was labelled
    error_margin: F64  # (n_patches,): of `error_margins`
    score: F64  # (n_patches,): above 0 where the model says obstacle
    on_grid: F64  # (n_frames, n_patches): the scores of each frame; -inf where a patch has none
    white: int  # patches it takes to bring a mask's mean over the thesis's limit
    judged: Bools  # (n_frames,): whether the runtime would judge the frame at all
    fold_rules: list[MofNRule] | None  # each chosen without its fold; None of no cross-validation
    split: str  # how the model was cross-validated, in its own words
    recipe: Mapping[str, Any] | None = None  # as the registry has it, for a registered model

    @property
    def label(self) -> str:
        """``name/version``."""
        return self.bundle.label

    @property
    def rule(self) -> MofNRule:
        """The frame rule that the bundle ships."""
        return self.bundle.operating_point.rule


def error_margins(model: LinearModel, values: F64, targets: I64) -> F64:
    """By how much the predicted class's value exceeds the labelled one's; 0 where it is right."""
    excess = values - model.thresholds
    predicted = model.predicted(values)
    if excess.shape[1] == 1:
        found = np.abs(excess[:, 0])
    else:
        # A label that the model does not know has no value of its own to exceed.
        known = targets < excess.shape[1]
        rows = np.arange(len(excess))
        of_label = np.where(known, excess[rows, np.where(known, targets, 0)], 0.0)
        found = excess[rows, predicted] - of_label
    return np.where(predicted == targets, 0.0, found)


def independent_units(patches: pd.DataFrame) -> tuple[list[str], I64]:
    """What a bootstrap draws: dives where there are several, else blocks; each patch's number.

    Blocks of a dive share its light, water and camera: however many there are, they say nothing
    of the next dive.
    """
    dives = held_out_together(patches)
    return block_numbers(dives if len(np.unique(dives)) > 1 else patches.group.to_numpy())


@dataclass(frozen=True)
class ComparedModels:
    """Models on the same patches."""

    mode: str  # `HELD_OUT` or `MISSION`
    what: str  # the dataset or mission, for people
    patches: pd.DataFrame  # mission, camera, frame, row, col, label, group of each labelled patch
    truth: Bools  # (n_patches,): whether the label is an obstacle
    models: list[ModelPredictions]
    series: FrameSeries
    # The picture of a mission, camera and frame; None where pictures are not at hand.
    read_frame: Callable[[str, str, int], U8 | None] | None
    dataset: DatasetVersion | None  # what the models were cross-validated on
    notes: list[str]  # what a reader must know of how the figures came about
    stated: AtSea = NOTHING_STATED
    ranges: Mapping[str, KnownDistances] = field(default_factory=dict)  # by mission, of left frames

    def of_dive(self, mission: str) -> "ComparedModels":
        """The same of one dive alone, whose blocks then count as independent."""
        patch = (self.patches.mission == mission).to_numpy()
        frame = (self.series.table.mission == mission).to_numpy()
        kept = dict.fromkeys(("targets", "predicted", "error_margin", "score"), patch)
        kept |= {"on_grid": frame, "judged": frame}
        return replace(
            self,
            patches=self.patches[patch].reset_index(drop=True),
            truth=self.truth[patch],
            models=[
                replace(item, **{name: getattr(item, name)[some] for name, some in kept.items()})
                for item in self.models
            ],
            series=self.series.of_frames(frame),
        )

    @property
    def unit(self) -> str:
        """The unit that counts as independent."""
        if len(np.unique(held_out_together(self.patches))) > 1:
            return DIVES
        return BLOCKS if self.has_frames else "single patches"

    @cached_property
    def units(self) -> tuple[list[str], I64]:
        """Names of the units that count as independent, and the number of each patch's."""
        return independent_units(self.patches)

    @cached_property
    def blocks(self) -> tuple[list[str], I64]:
        """Names of the blocks, and the block number of each patch."""
        return block_numbers(self.patches.group.to_numpy())

    @property
    def has_frames(self) -> bool:
        """Whether patches come from frames that a runtime could judge; ready-cut ones do not."""
        return self.models[0].bundle.grid.width is not None

    @property
    def two_sided(self) -> bool:
        """Whether every model tells obstacles from what is none."""
        return all(bool(np.isfinite(item.score).all()) for item in self.models)

    def status(self, predictions: ModelPredictions) -> I64:
        """The status of each frame, by the rules in force."""
        return statuses(
            self.series,
            predictions.on_grid,
            predictions.judged,
            predictions.fold_rules or [predictions.rule],
            predictions.white,
        )

    def figures(self, predictions: ModelPredictions) -> dict[str, Any]:
        """Patches at their thresholds, and frames at the operating point."""
        said = predictions.score, predictions.targets, predictions.predicted, predictions.classes
        dives = self.patches.mission.to_numpy()
        return {
            "patch": {
                "n": len(self.truth),
                **obstacle_metrics(self.truth, predictions.score),
                **class_metrics(predictions.targets, predictions.predicted, predictions.classes),
            },
            **({"dives": metrics_by(dives, self.truth, *said)} if self.unit == DIVES else {}),
            "frames": frame_figures(self.series, self.status(predictions), self.ranges, self.stated)
            if self.has_frames
            else None,
        }
