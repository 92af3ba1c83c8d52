"""The presets and settings of training, as plain values that are logged with every run."""

import ast
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Self

from tokt.features.common.errors import ToktError
from tokt.features.extractors.extractor import Extractor, Glcm, extractor_named
from tokt.features.frames.grid import Grid
from tokt.training.datasets.augmentations import parse_augmentation
from tokt.training.datasets.dataset import DatasetVersion


@dataclass(frozen=True)
class Hyperparameters:
    """One candidate of a cross-validation."""

    penalty: float  # LinearSVC's C
    class_weight: str | None = None  # ``balanced`` weighs a patch by how rare its class is

    def __post_init__(self) -> None:
        if not 0 < self.penalty < math.inf or self.class_weight not in (None, "balanced"):
            raise ValueError(f"penalty {self.penalty!r}, class weight {self.class_weight!r}")


@dataclass(frozen=True)
class TrainingSettings:
    """All that decides the weights besides the data."""

    preset: str
    scale: bool  # whether features are brought to zero mean and unit variance
    penalties: tuple[float, ...]  # candidates for LinearSVC's C
    two_images: bool  # learn from two images, ocean and other, as the thesis does, not the dataset
    seed: int = 42  # LinearSVC's random state, and the landmarks'
    # Candidates, too. The choice among all pairs is made by a blocked cross-validation inside the
    # training part of each fold.
    class_weights: tuple[str | None, ...] = (None,)
    # Augmentations, by name: every training part is learnt from as it is and as each of them makes
    # it. Tested on is what the camera gave.
    changes: tuple[str, ...] = ()
    change_weight: float = 1.0  # how much a patch of an augmented frame counts, against 1 as it is
    landmarks: int = 0  # of Nystroem's map between scaler and LinearSVC; 0 for none
    gamma: float = 0.3  # of that map's radial basis function, times the number of features
    limit: float = 2.5  # standard deviations at which features are cut off before that map
    logistic: bool = False  # loss; else LinearSVC's squared hinge
    moving_boundary: bool = False  # with the water (`tokt.models.water`), if frames are whole
    # Patches that a fit learns from at most: drawn where there are more, so that memory and time
    # have a bound. More of the same water teach nothing (docs/how-to/scale.md).
    max_samples: int = 50_000

    @classmethod
    def logged(cls, parameters: Mapping[str, str]) -> Self:
        """What a run's parameters say."""
        values: dict[str, Any] = {}
        for field in fields(cls):
            text = parameters.get(f"setting_{field.name}")
            if text is not None:  # an older tokt knew fewer settings
                value = text if field.name == "preset" else ast.literal_eval(text)
                if type(value) is not type(getattr(PRESETS["best"], field.name)):
                    raise ValueError(f"setting_{field.name} is {text}")
                values[field.name] = value
        for change in values.get("changes", ()):
            parse_augmentation(change)
        return cls(**values)

    @property
    def choices(self) -> tuple[Hyperparameters, ...]:
        """The candidates, the simpler first: a smaller C, then no weights."""
        weights = sorted(self.class_weights, key=lambda weight: weight is not None)
        return tuple(
            Hyperparameters(penalty, weight)
            for penalty in sorted(self.penalties)
            for weight in weights
        )


PRESETS = {
    "thesis": TrainingSettings("thesis", scale=False, penalties=(100.0,), two_images=True),
    "plain": TrainingSettings(
        "plain", scale=True, penalties=(0.01, 0.1, 1.0, 10.0), two_images=False
    ),
    "best": TrainingSettings(
        "best",
        scale=True,
        penalties=(0.1, 1.0),
        two_images=False,
        changes=("gain_0.5", "jpeg_60"),
        change_weight=0.05,
    ),
    "water": TrainingSettings(
        "water",
        scale=True,
        penalties=(1.0,),
        two_images=False,
        changes=("random_9",),
        landmarks=400,
        gamma=0.6,
        logistic=True,
        moving_boundary=True,
        max_samples=16_000,
    ),
}
# For small computers: features at half the width, and fewer of them.
PRESETS["lite"] = replace(PRESETS["best"], preset="lite")
PRESETS["lite_water"] = replace(PRESETS["water"], preset="lite_water", landmarks=100)

CHOSEN_ON = {
    "best": (
        "The preset's parts were worked out and its join found by tokt search, both by blocked "
        "cross-validation on the sea-trial mission. Those for ready-cut patches were found on "
        "photos of the seabed. Figures on that data are somewhat too good, and only another dive "
        "is a test."
    ),
    "water": (
        "The preset's parts were chosen with whole sites held out, on the sea-trial mission and "
        "nineteen groups of frames of twelve other sites. Figures on that data are somewhat too "
        "good, and only another dive is a test."
    ),
    "lite": (
        "The extractor is one of twelve, chosen by blocked cross-validation on the sea-trial "
        "mission. Figures on that data are somewhat too good, and only another dive is a test."
    ),
    "lite_water": (
        "The extractor and the number of landmarks are one of ten pairs. It was chosen with whole "
        "sites held out, on eleven dives of four sites. Figures on those dives are somewhat too "
        "good, and only another dive is a test."
    ),
}
DEFAULT_EXTRACTOR = "haralick"
# What `tokt search` found on the sea-trial mission: the simplest within 0.01 of the best.
_SHAPES = "lbp_flat_8_5+lbp_flat_8_9+lbp_flat_8_13+lines+lines_fine"
_BEST = {"lbp": _SHAPES, "haralick": f"haralick_flat+{_SHAPES}"}
WITHOUT_COLOURS = ("water", "lite_water")
"""Presets with another extractor for frames that are all gray."""
_OF_WHOLE_FRAMES = (*WITHOUT_COLOURS, "lite")
_OF_SEVERAL_DIVES = {"best": "water", "lite": "lite_water"}
_BEST_READY_CUT = (
    "lbp_8_1+lbp_8_2+lbp_12_3+lbp_10_5+lbp_24_8+haralick_log+haralick_log_64+haralick_log_16"
    "+lines+structure_3+structure_7+structure_11"
)


def preset_for(preset: str, dataset: DatasetVersion) -> str:
    """The preset that a name stands for: of several dives' frames ``best`` is ``water``.

    What tells one dive's water best does not carry over to another's, and the other way round.
    ``lite`` is ``lite_water`` then.
    """
    several = dataset.patches.mission.nunique() > 1 and not _ready_cut(dataset.grid)
    return _OF_SEVERAL_DIVES.get(preset, preset) if several else preset


def settings_named(preset: str, grid: Grid | None = None) -> TrainingSettings:
    """The preset's settings, for frames cut by `grid` (or by any).

    For ready-cut patches, which are photos of all kinds as they are, ``best`` learns from no
    changed ones; and it tries smaller C only, since folds that hold out whole kinds of photos
    choose too large a one. Raises ToktError if there is no preset of that name.
    """
    if preset not in PRESETS:
        raise ToktError(f"unknown preset {preset!r} (known: {', '.join(PRESETS)})")
    settings = PRESETS[preset]
    if preset == "best" and _ready_cut(grid):
        return replace(settings, changes=(), penalties=(0.01, 0.03, 0.1, 0.3))
    return settings


def _ready_cut(grid: Grid | None) -> bool:
    return grid is not None and grid.width is None


def weighted(settings: TrainingSettings, class_weight: str | None) -> TrainingSettings:
    """The settings with ``none``, ``balanced`` or ``auto`` (the better one) class weights.

    Raises ToktError for any other word; None keeps what the settings have.
    """
    if class_weight is None:
        return settings
    known: dict[str, tuple[str | None, ...]] = {
        "none": (None,),
        "balanced": ("balanced",),
        "auto": (None, "balanced"),
    }
    if class_weight not in known:
        raise ToktError(f"class weights are {', '.join(known)}, not {class_weight!r}")
    if settings.two_images and class_weight == "auto":
        raise ToktError("preset thesis chooses nothing: class weights none or balanced")
    return replace(settings, class_weights=known[class_weight])


def with_augmentations(settings: TrainingSettings, names: str | None) -> TrainingSettings:
    """The settings with these augmentations (``gain_0.5,jpeg_60``, or ``none``).

    Raises ToktError for one that is not there; None keeps what the settings have.
    """
    if names is None:
        return settings
    changes = () if names == "none" else tuple(dict.fromkeys(names.split(",")))
    for name in changes:
        parse_augmentation(name)
    if settings.two_images and changes:
        raise ToktError("preset thesis learns from two images as they are: no --changes")
    return replace(settings, changes=changes)


def extractor_for(
    name: str, preset: str, grid: Grid | None = None, gray: bool = False
) -> Extractor:
    """The extractor a preset uses for ``lbp``, ``haralick`` or a more exact name.

    All but ``plain`` and ``thesis`` widen the two plain names. ``water``: to gradients, colours
    (none for `gray` frames), shapes, less what the frame's own water shows. ``best``: to LBP, lines
    and structure of the frame without its background, ``haralick`` with Haralick's figures of it as
    well. For ready-cut patches, which have no background of their own frame around them, both are
    LBP and Haralick at several scales. ``lite`` has the lines alone, at half the width, and
    ``lite_water`` what ``water`` has without lines, at half the width but for the colours.
    ``thesis`` leaves grey level 0 out of Haralick's counts, as the thesis does.
    """
    if preset in _OF_WHOLE_FRAMES and name in _BEST:
        if _ready_cut(grid):
            raise ToktError(f"preset {preset} needs whole frames, and these patches are ready-cut")
        return extractor_named(f"{preset}_gray" if gray and preset in WITHOUT_COLOURS else preset)
    if preset == "best" and name in _BEST:
        return extractor_named(_BEST_READY_CUT if _ready_cut(grid) else _BEST[name])
    if preset == "thesis" and name == "haralick":
        return Glcm(ignore_zeros=True)
    return extractor_named(name)
