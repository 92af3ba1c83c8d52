"""Train one model version: cross-validate, fit on everything, log it all, register it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.pipeline import Pipeline

from ..features.errors import ToktError
from ..features.extractor import Extractor
from ..features.image_file import pixel_sha256, read_image
from ..models.linear import LinearModel
from .classifier import converged, decision_values, fit_classifier, linear_model
from .cross_validation import HeldOut, Split, choose_penalty, cross_validate, held_out_metrics
from .dataset import DatasetVersion
from .feature_table import feature_table
from .presets import CHOSEN_ON, TrainingSettings
from .splits import blocked_folds
from .thesis_images import rendered_other_image

_LEAST_BLOCK_FRAMES = 5
_WEAK = (
    f"WEAK SPLIT: blocks of fewer than {_LEAST_BLOCK_FRAMES} frames leave near copies on both "
    "sides and the figures may be too good. "
)


@dataclass(frozen=True)
class TrainRequest:
    """What to train.

    Parameters
    ----------
    dataset : DatasetVersion
    name : str
        The model's name in the registry.
    extractor : Extractor
    extractor_name : str
        What the user asked for, as ``lbp``.
    settings : TrainingSettings
    split : Split
    ocean_image, other_image : Path or None
        For the preset `thesis` only; by default a clear frame of the dataset and a rendered
        texture.
    """

    dataset: DatasetVersion
    name: str
    extractor: Extractor
    extractor_name: str
    settings: TrainingSettings
    split: Split
    ocean_image: Path | None = None
    other_image: Path | None = None


@dataclass(frozen=True)
class Trained:
    """A trained model with all that is known about it, before it is logged.

    Parameters
    ----------
    request : TrainRequest
    pipeline : Pipeline
        scikit-learn's, fitted on all training data.
    model : LinearModel
        The same with the scaler folded in.
    penalty : float
        LinearSVC's C.
    held_out : HeldOut
    metrics : dict
        As `held_out_metrics`, with ``split``: how they were measured, in words.
    trained_on : array of uint64
        First 8 bytes of the pixel hash of every frame learnt from.
    """

    request: TrainRequest
    pipeline: Pipeline
    model: LinearModel
    penalty: float
    held_out: HeldOut
    metrics: dict[str, Any]
    trained_on: NDArray[np.uint64]


def frame_id(digest: str) -> np.uint64:
    """The first 8 bytes of a pixel hash, as `BundleContent.trained_on` holds them."""
    return np.uint64(int(digest[:16], 16))


def train(request: TrainRequest, cache: Path, progress: Callable[..., Any]) -> Trained:
    """Train and measure; nothing is written but the feature cache.

    Raises
    ------
    ToktError
        If the dataset cannot be split as asked, or was changed on disk.
    """
    dataset, settings = request.dataset, request.settings
    dataset.check()
    if settings.two_images:
        _check_two_images(dataset)
    if settings.two_images or dataset.block_frames is None:
        # Nothing of the dataset is learnt from, or its frame numbers only count file names.
        request = replace(request, split=Split(request.split.folds, embargo_frames=0))
    split, targets = request.split, dataset.targets()
    # Minutes of computing features come next: say now if they would be for nothing.
    blocked_folds(dataset.patches, targets, split.folds, split.embargo_frames)
    features = feature_table(dataset, request.extractor.spec, cache, progress)
    if settings.two_images:
        return _train_on_two_images(request, np.asarray(features))
    held_out = cross_validate(dataset, features, settings, split, progress)
    penalty = choose_penalty(dataset.patches, np.asarray(features), targets, settings, split)
    pipeline = fit_classifier(features, targets, penalty, settings)
    model = linear_model(pipeline, dataset.classes(), dataset.obstacle_flags())
    metrics = held_out_metrics(dataset, held_out, model)
    metrics["split"] = _split_in_words(request)
    metrics["converged"] = converged(pipeline)
    trained_on = np.array([frame_id(digest) for digest in dataset.frames.digest], np.uint64)
    return Trained(request, pipeline, model, penalty, held_out, metrics, np.unique(trained_on))


def _split_in_words(request: TrainRequest) -> str:
    split = request.split
    if request.dataset.block_frames is None:
        return (
            f"UNGROUPED: {split.folds}-fold cross-validation over single patches. Nothing says "
            "which patches come from one photo, so near copies may stand on both sides and the "
            "figures may be too good."
        )
    weak = request.dataset.block_frames < _LEAST_BLOCK_FRAMES
    return (
        f"{_WEAK if weak else ''}{split.folds}-fold cross-validation over whole blocks of frames "
        f"({request.dataset.block_frames} frames a block); training frames within "
        f"{split.embargo_frames} frames of a test frame left out; C chosen inside each "
        f"training part by {max(2, split.folds - 1)}-fold blocked cross-validation among "
        f"{', '.join(f'{value:g}' for value in request.settings.penalties)}. "
        "Decision threshold 0, not tuned. Patches marked unsure neither trained nor scored on."
        f"{' ' + CHOSEN_ON if request.settings.preset == 'best' else ''}"
    )


def _first_clear_frame(dataset: DatasetVersion) -> int:
    clear = ~np.asarray(dataset.obstacle_flags(), bool)[dataset.targets()]
    table = dataset.patches.assign(clear=clear).groupby(["mission", "camera", "frame"]).clear
    sizes, sums = table.size(), table.sum()
    full = set(sums[(sums == sizes) & (sizes == dataset.grid.n_patches)].index)
    keys = dataset.frames[["mission", "camera", "frame"]].itertuples(index=False, name=None)
    for index, key in enumerate(keys):
        if key in full:
            return index
    raise ToktError("preset thesis needs --ocean IMAGE: no frame of the dataset is all clear")


def _check_two_images(dataset: DatasetVersion) -> None:
    if dataset.task != "binary":
        raise ToktError("preset thesis tells obstacle from clear only; build a binary dataset")
    if dataset.block_frames is None:
        raise ToktError("preset thesis needs whole frames; this dataset is a folder of patches")


def _train_on_two_images(request: TrainRequest, features: NDArray[np.float64]) -> Trained:
    """The thesis's training: the patches of one ocean image against those of one other image."""
    dataset, settings = request.dataset, request.settings
    index = None if request.ocean_image else _first_clear_frame(dataset)
    ocean = (
        read_image(request.ocean_image) if request.ocean_image else dataset.read_frame(index or 0)
    )
    other = read_image(request.other_image) if request.other_image else rendered_other_image()
    rows = [request.extractor.describe(image, dataset.grid) for image in (ocean, other)]
    targets = np.repeat([0, 1], dataset.grid.n_patches)
    penalty = settings.penalties[0]
    pipeline = fit_classifier(np.vstack(rows), targets, penalty, settings)
    model = linear_model(pipeline, dataset.classes(), dataset.obstacle_flags())
    learnt_from = [pixel_sha256(image) for image in (ocean, other)]
    held_out = _test_on_all(request, features, pipeline, learnt_from)
    metrics = held_out_metrics(dataset, held_out, model)
    names = (
        _name(request.ocean_image, "a frame of the dataset"),
        _name(request.other_image, "a rendered texture"),
    )
    metrics["split"] = (
        f"Trained on two images only, as the thesis: ocean = {names[0]} and other = {names[1]}; "
        "tested on every other frame of the dataset. The folds only say how the figures vary "
        "along the mission."
    )
    metrics["converged"] = converged(pipeline)
    images = np.array([frame_id(digest) for digest in learnt_from], np.uint64)
    return Trained(request, pipeline, model, penalty, held_out, metrics, np.unique(images))


def _name(path: Path | None, default: str) -> str:
    return default if path is None else path.name


def _test_on_all(
    request: TrainRequest,
    features: NDArray[np.float64],
    pipeline: Pipeline,
    learnt_from: list[str],
) -> HeldOut:
    """Score every patch of the dataset but those of frames that were learnt from."""
    dataset = request.dataset
    split = request.split
    folds = blocked_folds(dataset.patches, dataset.targets(), split.folds, split.embargo_frames)
    keys = ["mission", "camera", "frame"]
    digests = dataset.patches[keys].merge(dataset.frames, on=keys, how="left").digest
    number = np.full(len(dataset.patches), -1)
    for index, fold in enumerate(folds):
        number[fold.test] = index
    number[digests.isin(learnt_from).to_numpy()] = -1
    values = decision_values(pipeline, features)
    values[number < 0] = np.nan
    return HeldOut(values, number, tuple([request.settings.penalties[0]] * len(folds)))


def parameters(trained: Trained) -> dict[str, Any]:
    """What a run logs as its parameters."""
    request = trained.request
    return {
        "dataset": request.dataset.label,
        "dataset_hash": request.dataset.hash,
        "extractor": request.extractor_name,
        "features": request.extractor.dim,
        "penalty_chosen": trained.penalty,
        **{f"setting_{key}": value for key, value in asdict(request.settings).items()},
        **{f"split_{key}": value for key, value in asdict(request.split).items()},
    }
