"""Train one model version: cross-validate, fit on everything, log it all, register it."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from sklearn.pipeline import Pipeline
from threadpoolctl import ThreadpoolController

from tokt.features.common.arrays import F64, U8
from tokt.features.common.errors import ToktError
from tokt.features.extractors.extractor import Extractor
from tokt.features.frames.image_file import pixel_sha256, read_image
from tokt.features.frames.mission import format_frames
from tokt.models.bundle.bundle import frame_id
from tokt.models.distribution import Distribution
from tokt.models.linear import LinearModel
from tokt.models.operating_point import MofNRule, OperatingPoint
from tokt.models.sight import SightLimits
from tokt.training.datasets.changed_patches import changed_patches
from tokt.training.datasets.dataset import FRAME_KEY, DatasetVersion
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.folds import DIVE, FOLDS
from tokt.training.datasets.split import BLOCKS, Split

from .choose_operating_point import DEFAULT_TARGET, FalseStatusTarget, choose_frame_rule, shapes_on
from .classifier import Tables, converged, decision_values, fit_classifier, fit_rows, linear_model
from .cross_validation import (
    HeldOutPredictions,
    check_features,
    choose_hyperparameters,
    cross_validate,
    held_out_metrics,
    robustness_figures,
    rows_tested,
)
from .drift_limits import novelty_limit, training_distribution
from .presets import CHOSEN_ON, Hyperparameters, TrainingSettings
from .whole_frames import WholeFrames

_MIN_BLOCK_FRAMES = 5
_WEAK = (
    f"WEAK SPLIT: blocks of fewer than {_MIN_BLOCK_FRAMES} frames leave near copies on both "
    "sides and the figures may be too good. "
)


@dataclass(frozen=True)
class TrainRequest:
    """A model to train: dataset, extractor, settings and targets."""

    dataset: DatasetVersion
    name: str  # the model's name in the registry
    extractor: Extractor
    extractor_name: str  # what the user asked for, as ``lbp``
    settings: TrainingSettings
    split: Split
    ocean_image: Path | None = None  # of preset `thesis`; by default a clear frame of the dataset
    other_image: Path | None = None  # of preset `thesis`; by default a rendered texture
    target: FalseStatusTarget = DEFAULT_TARGET  # what the operating point is chosen for
    search: str | None = None  # the search that the extractor comes from
    # Of the model that this one goes on from, where the dataset has frames without a picture.
    known_sight: tuple[SightLimits, ...] = ()
    selection: str = ""  # how the extractor was chosen, in a sentence; stands with the figures


@dataclass(frozen=True)
class Trained:
    """A trained model with all that is known about it, before it is logged."""

    request: TrainRequest
    pipeline: Pipeline  # scikit-learn's, fitted on all training data
    model: LinearModel  # the same with the scaler folded in
    choice: Hyperparameters  # what it was fitted with
    held_out: HeldOutPredictions
    metrics: dict[str, Any]  # as `held_out_metrics`, with ``split``: how they were measured
    trained_on: NDArray[np.uint64]  # first 8 bytes of the pixel hash of every frame learnt from
    # Chosen on held-out decision values of all blocks; the figures of `metrics` come from the
    # folds' own rules.
    operating_point: OperatingPoint
    distribution: Distribution | None  # of unchanged frames; None where no limits can be measured


def fit_and_measure(
    request: TrainRequest,
    cache: Path,
    progress: Callable[..., Any],
    jobs: int = -1,
    dask: str | None = None,
    stress: tuple[str, ...] = (),
) -> Trained:
    """Train and measure; nothing is written but the feature cache.

    Parameters
    ----------
    cache : Path
        Folder of the feature cache.
    progress : callable
        ``progress(items, total, what)`` passes the items through.
    jobs, dask
        Where features are computed, as for `cached_features`, and on how many processes is
        cross-validated; the model depends on neither.
    stress : tuple of str
        Augmentations to test on beside; `metrics` then has ``stress`` (`robustness_figures`).

    Raises
    ------
    ToktError
        If the dataset cannot be split as asked, was changed on disk, or has features that
        nothing can be learnt from.
    """
    dataset, settings = request.dataset, request.settings
    dataset.check()
    if not (request.known_sight or dataset.pictured.all()):
        raise ToktError(
            f"dataset {dataset.label} has features of some frames, and no pictures: tokt adapt "
            "goes on from it"
        )
    if settings.two_images:
        _check_two_images(dataset)
    if settings.two_images or dataset.block_frames is None:
        # Nothing of the dataset is learnt from, or its frame numbers only count file names.
        request = replace(request, split=replace(request.split, embargo_frames=0))
    split = request.split
    # Minutes of computing features come next: say now if they would be for nothing.
    if settings.two_images:
        split.cut(dataset.patches, dataset.targets())
    else:
        split.check(dataset.patches, dataset.targets())
        if dataset.block_frames is not None:
            shapes_on(dataset.grid, request.target)
    spec = request.extractor.spec
    computed = dataset, spec, cache, progress, jobs, dask
    moves = settings.moving_boundary and dataset.block_frames is not None
    judged = ("", *stress) if moves else ()
    tables = {name: cached_features(*computed, name, name in judged) for name in ("", *stress)}
    changed = [
        changed_patches(dataset, spec, name, cache, progress, jobs, dask)
        for name in settings.changes
    ]
    # Priors are chosen on frames as they are, so that these alone need the changed ones.
    whole = {
        name: WholeFrames.of(dataset, tables[name], request.extractor, () if name else changed)
        for name in judged
    }
    tables = {name: table[: len(dataset.patches)] for name, table in tables.items()}
    # One thread, so that sums are added up in the same order on every machine.
    with ThreadpoolController().limit(limits=1):
        if settings.two_images:
            return _train_on_two_images(request, tables, stress)
        return _train_on_dataset(request, tables, changed, whole, progress, jobs)


def _train_on_dataset(
    request: TrainRequest,
    tables: dict[str, F64],
    augmented: Tables,
    whole: dict[str, WholeFrames],
    progress: Callable[..., Any],
    jobs: int,
) -> Trained:
    dataset, settings, split = request.dataset, request.settings, request.split
    features, stressed = tables[""], {name: table for name, table in tables.items() if name}
    targets = dataset.targets()
    held_out = cross_validate(
        *(dataset, features, settings, split, progress, request.target),
        *(augmented, stressed, jobs, whole),
    )
    judged = split.judged(dataset.patches, targets)
    learnt = dataset.patches, features, targets, settings, split, augmented
    chosen = choose_hyperparameters(*learnt, jobs, whole.get(""), judged)
    everything, dives = np.arange(len(targets)), split.dives(dataset.patches)
    pipeline = fit_rows(features, targets, everything, chosen.choice, settings, augmented, dives)
    model = linear_model(pipeline, dataset.classes(), dataset.obstacle_flags())
    score, tested = model.obstacle_score(chosen.values), rows_tested(chosen.values)
    by_dive = split.by == DIVE
    rule, how = choose_frame_rule(dataset, score, tested, request.target, by_dive)
    unlike, words = novelty_limit(dataset, held_out.distance)
    told = {**how, "novelty": words} if words else how
    operating_point = OperatingPoint(rule, told, chosen.prior, unlike)
    metrics = _metrics(request, held_out, model, pipeline, _split_in_words(request))
    trained_on = np.array([frame_id(digest) for digest in dataset.frames.digest], np.uint64)
    return Trained(
        request,
        pipeline,
        model,
        chosen.choice,
        held_out,
        metrics,
        np.unique(trained_on),
        operating_point,
        training_distribution(dataset, features, split.embargo_frames, judged),
    )


def _metrics(
    request: TrainRequest,
    held_out: HeldOutPredictions,
    model: LinearModel,
    pipeline: Pipeline,
    split: str,
) -> dict[str, Any]:
    metrics = held_out_metrics(request.dataset, held_out, model, request.split.sites)
    if held_out.stressed:
        learnt = request.settings.changes
        metrics["stress"] = robustness_figures(request.dataset, held_out, model, learnt)
    if request.dataset.pictured.any():
        metrics["unseen"] = _unseen(request.dataset)
    return {**metrics, "split": split, "converged": converged(pipeline)}


def _unseen(dataset: DatasetVersion) -> dict[str, Any]:
    """The frames that a run would not call clear: how many by reason, and which by mission."""
    rows = dataset.frames.iloc[[row for rows in dataset.unseen.values() for row in rows]]
    return {
        "frames": int(dataset.pictured.sum()),
        "reasons": {code: len(those) for code, those in dataset.unseen.items()},
        "which": {
            str(mission): format_frames(numbers.tolist())
            for mission, numbers in rows.groupby("mission").frame
        },
    }


def _split_in_words(request: TrainRequest) -> str:
    preset = CHOSEN_ON.get(request.settings.preset, "")
    return " ".join(filter(None, (_folds_in_words(request), preset, request.selection)))


def _folds_in_words(request: TrainRequest) -> str:
    split = request.split
    if request.dataset.block_frames is None:
        return (
            f"UNGROUPED: {split.folds}-fold cross-validation over single patches. Nothing says "
            "which patches come from one photo, so near copies may stand on both sides and the "
            f"figures may be too good.{_changes(request.settings)}{_drawn(request)}"
        )
    weighed = split.dives(request.dataset.patches) is not None
    weights = " A dive counts by the root of its patches in learning" if weighed else ""
    more = ", ".join(f"{dive} {times:g} times that" for dive, times in sorted(split.added.items()))
    weights += (f", {more}." if more else ".") if weighed else ""
    rest = f"{_DECIDED}{weights}{_changes(request.settings)}{_drawn(request)}"
    candidates = f"{_candidates(request.settings)} chosen inside each training part"
    unit = split.unit(request.dataset.patches)
    if unit != BLOCKS:
        folds = len(split.cut(request.dataset.patches, request.dataset.targets()))
        return (
            f"{folds}-fold cross-validation over whole {unit}: each is judged by a model that "
            f"learnt nothing of it. {candidates} by the dives' mean F1, held out in the same way. "
            "Blocks of frames are held out where one dive is left or a class would be lost. "
            f"{rest}"
        )
    return (
        f"{_blocks_in_words(request.dataset, split)} {candidates} by {split.inner.folds}-fold "
        f"cross-validation of the same kind. {rest}"
    )


def _blocks_in_words(dataset: DatasetVersion, split: Split) -> str:
    """How a dataset is held out by blocks of frames, and what few folds mean."""
    frames = len(dataset.patches[FRAME_KEY].drop_duplicates())
    if dataset.single_pictures and dataset.block_frames == 1:
        held_out = "each held out alone" if frames == split.folds else "each in one fold only"
        words = f"{split.folds}-fold cross-validation over {frames} single pictures, {held_out}."
    else:
        weak = (dataset.block_frames or 0) < _MIN_BLOCK_FRAMES
        words = (
            f"{_WEAK if weak else ''}{split.folds}-fold cross-validation over blocks of "
            f"{dataset.block_frames} consecutive frames, which are near copies and are held out "
            f"together. Training frames within {split.embargo_frames} frames of a test frame are "
            f"left out.{_positions_in_words(dataset)}"
        )
    if split.folds < FOLDS:
        words += (
            f" A model of so few folds learnt from {split.folds - 1} in {split.folds} of the "
            "labelled blocks, and the registered one from all: it is mostly better."
        )
    return words


def _positions_in_words(dataset: DatasetVersion) -> str:
    """Say how frames are counted, and how long a scene stays the same."""
    if not dataset.has_positions:
        return (
            " Frames are counted by their numbers, as the dataset is of an older tokt: built again "
            "they are counted in the order of the dive."
        )
    scenes = dataset.info.get("scene_frames", {})
    words = ", ".join(f"{length} ({name})" for name, length in scenes.items())
    return f" Frames for which a scene stays the same: {words}." if words else ""


_DECIDED = (
    "Patches at decision threshold 0, not tuned; frames by a rule that was chosen inside each "
    "training part too. Patches marked unsure neither trained nor scored on."
)


def _changes(settings: TrainingSettings) -> str:
    if not settings.changes:
        return ""
    changes = ", ".join(settings.changes)
    return (
        f" Learnt from frames as they are and, counting {settings.change_weight:g} each, changed "
        f"({changes}); tested on as they are."
    )


def _drawn(request: TrainRequest) -> str:
    most, patches = request.settings.max_samples, len(request.dataset.patches)
    also = " (and as many of added dives)" if request.split.added else ""
    fits = f" A fit learns from {most:,} patches at most{also}, drawn by lot."
    fits = fits if patches > most else ""
    return request.split.judged_words(request.dataset) + fits


def _candidates(settings: TrainingSettings) -> str:
    penalties = f"C (of {', '.join(f'{value:g}' for value in settings.penalties)})"
    if settings.class_weights == (None,):
        return penalties
    weights = " or ".join(weight or "none" for weight in settings.class_weights)
    return f"{penalties} and class weights (of {weights})"


def _first_clear_frame(dataset: DatasetVersion) -> U8:
    table = dataset.patches.assign(clear=~dataset.obstacles()).groupby(FRAME_KEY).clear
    sizes, sums = table.size(), table.sum()
    full = set(sums[(sums == sizes) & (sizes == dataset.grid.n_patches)].index)
    keys = dataset.frames[FRAME_KEY].itertuples(index=False, name=None)
    for index, key in enumerate(keys):
        if key in full:
            return dataset.read_frame(index)
    raise ToktError("preset thesis needs --ocean IMAGE: no frame of the dataset is all clear")


def _check_two_images(dataset: DatasetVersion) -> None:
    if dataset.task != "binary":
        raise ToktError("preset thesis tells obstacle from clear only; build a binary dataset")
    if dataset.block_frames is None:
        raise ToktError("preset thesis needs whole frames; this dataset is a folder of patches")


def _train_on_two_images(
    request: TrainRequest, tables: dict[str, F64], stress: tuple[str, ...]
) -> Trained:
    """The thesis's training: the patches of one ocean image against those of one other image."""
    dataset, settings = request.dataset, request.settings
    check_features(dataset, tables[""])
    ocean_file, other_file = request.ocean_image, request.other_image
    ocean = read_image(ocean_file) if ocean_file else _first_clear_frame(dataset)
    other = read_image(other_file) if other_file else rendered_other_image()
    rows = [request.extractor.describe(image, dataset.grid) for image in (ocean, other)]
    targets = np.repeat([0, 1], dataset.grid.n_patches)
    (choice,) = settings.choices
    pipeline = fit_classifier(np.vstack(rows), targets, choice, settings)
    model = linear_model(pipeline, dataset.classes(), dataset.obstacle_flags())
    learnt_from = [pixel_sha256(image) for image in (ocean, other)]
    held_out = _test_on_all(request, tables, stress, pipeline, learnt_from)
    split = (
        "Trained on two images only, as the thesis: "
        f"ocean = {ocean_file.name if ocean_file else 'a frame of the dataset'} and "
        f"other = {other_file.name if other_file else 'a rendered texture'}; "
        "tested on every other frame of the dataset. The folds only say how the figures vary "
        "along the mission."
    )
    metrics = _metrics(request, held_out, model, pipeline, split)
    images = np.array([frame_id(digest) for digest in learnt_from], np.uint64)
    return Trained(
        request,
        pipeline,
        model,
        choice,
        held_out,
        metrics,
        np.unique(images),
        OperatingPoint(
            chosen={
                "method": "none",
                "words": "As the thesis: any patch over its threshold, in any frame, is an alarm.",
                "reachable": False,
            }
        ),
        None,
    )


def _test_on_all(
    request: TrainRequest,
    tables: dict[str, F64],
    stress: tuple[str, ...],
    pipeline: Pipeline,
    learnt_from: list[str],
) -> HeldOutPredictions:
    """Score every patch of the dataset but those of frames that were learnt from."""
    dataset = request.dataset
    folds = request.split.cut(dataset.patches, dataset.targets())
    digests = dataset.patches[FRAME_KEY].merge(dataset.frames, on=FRAME_KEY, how="left").digest
    number = np.full(len(dataset.patches), -1)
    for index, fold in enumerate(folds):
        number[fold.test] = index
    number[digests.isin(learnt_from).to_numpy()] = -1
    values = {name: decision_values(pipeline, tables[name]) for name in ("", *stress)}
    for part in values.values():
        part[number < 0] = np.nan
    rules = tuple([MofNRule()] * len(folds))
    choices = request.settings.choices * len(folds)
    return HeldOutPredictions(values.pop(""), number, choices, rules, values)


def parameters(trained: Trained) -> dict[str, Any]:
    """The parameters that a run logs."""
    request = trained.request
    return {
        "dataset": request.dataset.label,
        "dataset_hash": request.dataset.hash,
        "extractor": request.extractor_name,
        "features": request.extractor.dim,
        "penalty_chosen": trained.choice.penalty,
        "class_weight_chosen": trained.choice.class_weight,
        "search": request.search,
        **{f"target_{key}": value for key, value in asdict(request.target).items()},
        **{f"rule_{key}": value for key, value in trained.operating_point.rule.to_json().items()},
        **{f"setting_{key}": value for key, value in asdict(request.settings).items()},
        **{f"split_{key}": value for key, value in request.split.parameters().items()},
    }


_HEIGHT, _WIDTH = 1024, 1360
_CELL_PIXELS = (256, 128, 64, 32, 16, 8)
_ROUGHNESS = 0.6


def rendered_other_image(seed: int = 1) -> U8:
    """A textured gray image that stands in for the thesis's film still, which is not at hand.

    A sum of smooth noise at six scales, stretched to grey levels 20 to 220: bright, contrasty
    and structured at every size, as a well-lit scene is and open water is not.

    Returns
    -------
    numpy.ndarray
        uint8, shape (1024, 1360).
    """
    generator = np.random.default_rng(seed)
    total = np.zeros((_HEIGHT, _WIDTH))
    for cell in _CELL_PIXELS:
        coarse = generator.normal(size=(_HEIGHT // cell + 2, _WIDTH // cell + 2))
        smooth = cv2.resize(
            coarse.astype(np.float32), (_WIDTH, _HEIGHT), interpolation=cv2.INTER_CUBIC
        )
        total += smooth * (cell / _CELL_PIXELS[0]) ** _ROUGHNESS
    stretched = (total - total.min()) / np.ptp(total)
    return np.asarray(stretched * 200 + 20, np.uint8)
