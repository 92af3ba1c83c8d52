"""tokt's texture model over a mission, each frame judged by a model that never saw it.

Models learn from labelled blocks of frames and judge the others (`tokt.training.datasets.splits`):
a frame that is labelled is judged by the model of the fold that tests it. A frame without labels is
judged by the model whose training frames are farthest from it, if they are beyond the embargo.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tokt.inference.texture.detector import MofNRun, min_mask_patches
from tokt.models.operating_point import MofNRule, frame_step, missed_before
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.inputs import StudyInputs
from tokt.training.datasets.dataset import DatasetVersion, build_dataset
from tokt.training.datasets.mission_source import plan_from_missions
from tokt.training.datasets.splits import BLOCK_FRAMES, EMBARGO_FRAMES, FOLDS, Fold, blocked_folds
from tokt.training.fitting.choose_operating_point import DEFAULT_TARGET, choose_frame_rule
from tokt.training.fitting.classifier import decision_values, linear_model
from tokt.training.fitting.cross_validation import (
    Split,
    check_blocks,
    check_features,
    choose_hyperparameters,
    fit_rows,
    inner_folds,
)
from tokt.training.fitting.presets import CHOSEN_ON, TrainingSettings

from .per_frame_methods import FrameResult, mean_and_status

TOKT_TEXTURE = "tokt_texture"
_MIN_BLOCKS = 10
_WEAK_BLOCK_FRAMES = 5


@dataclass(frozen=True)
class FoldModel:
    """Scores and frame rule of a model of one fold's training part.

    Parameters
    ----------
    scores : dict of int to array of float64, shape (n_patches,)
        Obstacle scores of the frames it judges.
    rule : MofNRule
        Chosen inside the training part.
    """

    scores: dict[int, NDArray[np.float64]]
    rule: MofNRule


@dataclass(frozen=True)
class HeldOutTexture:
    """Results of held-out models, frame by frame.

    Parameters
    ----------
    mean : dict of int to float
    status : dict of int to int
    patches : dict of int to array of bool, shape (n_patches,)
        Patches whose decision value is over the threshold, whatever the frame rule says.
    words : str
        What it is, and how it was split.
    """

    mean: dict[int, float]
    status: dict[int, int]
    patches: dict[int, NDArray[np.bool_]]
    words: str


def held_out_texture(
    inputs: StudyInputs, judged: Sequence[FrameResult], settings: TrainingSettings
) -> HeldOutTexture:
    """Judge each frame by a model of the other blocks.

    Parameters
    ----------
    inputs : StudyInputs
        With labels.
    judged : sequence of FrameResult
        With features.
    settings : TrainingSettings

    Raises
    ------
    ToktError
        If the labels are too few, or all of one class, for blocks to be held out.
    """
    features = {one.number: one.features for one in judged if one.features}
    with tempfile.TemporaryDirectory(prefix="tokt-reproduce-") as name:
        dataset, split = _dataset(inputs, Path(name), [one.number for one in judged])
        check_blocks(dataset, split.folds, split.embargo_frames)
        learnt = _learn(inputs, dataset, split, features, settings)
    sizes = {one.number: one.size for one in judged}
    return _judged(learnt, sizes, _words(dataset, split, settings))


def _dataset(
    inputs: StudyInputs, folder: Path, readable: Sequence[int]
) -> tuple[DatasetVersion, Split]:
    """The labelled frames that could be read, cut into blocks."""
    labelled = sorted(set(inputs.obstacle_patches) & set(readable))
    block = min(BLOCK_FRAMES, max(2, len(labelled) // _MIN_BLOCKS))
    plan, _ = plan_from_missions(
        "reproduce",
        "binary",
        [inputs.mission.path],
        inputs.labels or [],
        inputs.taxonomy,
        GRID,
        labelled,
        block,
        labels_are_for_it=True,
    )
    dataset = build_dataset(plan, folder, inputs.progress)
    return dataset, Split(FOLDS, EMBARGO_FRAMES * block // BLOCK_FRAMES)


def _tables(
    dataset: DatasetVersion, features: Mapping[int, Sequence[NDArray[np.float64]]], count: int
) -> list[NDArray[np.float64]]:
    """Features of the dataset's patches: of frames as they are, then as each change makes them."""
    patches = dataset.patches
    cells = (patches.row * dataset.grid.cols + patches.col).to_numpy()
    tables = [np.empty((len(patches), features[number][0].shape[1])) for number in [_any(features)]]
    tables += [np.empty_like(tables[0]) for _ in range(count - 1)]
    for key, rows in patches.groupby("frame").indices.items():
        for table, described in zip(tables, features[int(str(key))], strict=True):
            table[rows] = described[cells[rows]]
    return tables


def _any(features: Mapping[int, object]) -> int:
    return next(iter(features))


def _learn(
    inputs: StudyInputs,
    dataset: DatasetVersion,
    split: Split,
    features: Mapping[int, Sequence[NDArray[np.float64]]],
    settings: TrainingSettings,
) -> list[FoldModel]:
    """For each fold a model of its training part, and what it says of the frames it judges."""
    table, *augmented = _tables(dataset, features, 1 + len(settings.changes))
    check_features(dataset, table)
    patches, targets = dataset.patches, dataset.targets()
    folds = blocked_folds(patches, targets, split.folds, split.embargo_frames)
    judges = _judges(dataset, folds, list(features), split.embargo_frames)
    inner = Split(inner_folds(split.folds), split.embargo_frames)
    learnt = []
    for index, fold in enumerate(inputs.progress(folds, len(folds), "our texture, held out")):
        rows = fold.train
        parts = [one[rows] for one in augmented]
        chosen = choose_hyperparameters(
            patches.iloc[rows],
            table[rows],
            targets[rows],
            settings,
            inner,
            parts,
            inputs.request.jobs,
        )
        pipeline = fit_rows(table, targets, rows, chosen.choice, settings, augmented)
        model = linear_model(pipeline, dataset.classes(), dataset.obstacle_flags())
        scores, tested = np.full(len(targets), np.nan), np.zeros(len(targets), bool)
        scores[rows], tested[rows] = model.obstacle_score(chosen.values), True
        rule, _ = choose_frame_rule(dataset, scores, tested, DEFAULT_TARGET)
        said = {
            number: model.obstacle_score(decision_values(pipeline, features[number][0]))
            for number, judge in judges.items()
            if judge == index
        }
        learnt.append(FoldModel(said, rule))
    return learnt


def _judges(
    dataset: DatasetVersion, folds: Sequence[Fold], frames: Sequence[int], embargo_frames: int
) -> dict[int, int]:
    """Which fold's model judges a frame; a frame that none may judge is left out."""
    frame = dataset.patches.frame.to_numpy()
    judges = {
        int(number): index
        for index, fold in enumerate(folds)
        for number in np.unique(frame[fold.test])
    }
    for number in frames:
        if number not in judges:
            away = [int(np.abs(frame[fold.train] - number).min()) for fold in folds]
            if max(away) > embargo_frames:
                judges[number] = int(np.argmax(away))
    return judges


def _judged(
    learnt: Sequence[FoldModel], sizes: Mapping[int, tuple[int, int]], words: str
) -> HeldOutTexture:
    """The frames in their order by each fold's rule; a frame's verdict is that of its own fold."""
    judges = {number: index for index, one in enumerate(learnt) for number in one.scores}
    numbers = sorted(sizes)
    missed = missed_before(numbers, frame_step(numbers))
    found = HeldOutTexture({}, {}, {}, words)
    for index, one in enumerate(learnt):
        run = MofNRun(one.rule)
        for number, gap in zip(numbers, missed, strict=True):
            run.begin(gap)
            if number not in judges:
                continue
            scores = learnt[judges[number]].scores[number]
            least = min_mask_patches(GRID, *GRID.resized(*sizes[number]))
            ruled = run.judge(scores, scores > 0, least)
            if judges[number] != index:
                continue
            found.patches[number] = scores > 0
            found.mean[number], found.status[number] = (
                (float("nan"), -1)
                if ruled.patches is None
                else mean_and_status(ruled.patches, sizes[number], TOKT_TEXTURE)
            )
    return found


def _words(dataset: DatasetVersion, split: Split, settings: TrainingSettings) -> str:
    weak = (
        "weak split, as short blocks leave near copies on both sides: "
        if (dataset.block_frames or 0) < _WEAK_BLOCK_FRAMES
        else ""
    )
    own_choice = f" {CHOSEN_ON}" if settings.preset == "best" else ""
    return (
        f"tokt's texture model (preset {settings.preset}), held out: {weak}{split.folds}-fold "
        f"cross-validation over blocks of {dataset.block_frames} frames, training frames within "
        f"{split.embargo_frames} of a tested one left out, C and frame rule chosen inside each "
        f"training part; a frame without labels is judged by the fold whose training frames are "
        f"farthest from it.{own_choice}"
    )
