"""TrainOptions, and the training of the model version that they describe."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.labels.formats.options import Progress, no_progress
from tokt.models.bundle.bundle import Bundle
from tokt.models.operating_point import OperatingPoint
from tokt.models.registry.names import CHAMPION
from tokt.models.registry.registration import RegisteredVersion
from tokt.models.registry.registry import Registry, check_model_name
from tokt.models.signing.passphrase import signing_key
from tokt.training.datasets.augmentations import STRESS
from tokt.training.datasets.dataset import DatasetVersion, open_dataset
from tokt.training.datasets.split import Split
from tokt.training.evaluation.old_dives import held_out_falls
from tokt.training.options import PathOrText, at_least, takes, texts

from .choose_operating_point import DEFAULT_TARGET, FalseStatusTarget
from .presets import (
    DEFAULT_EXTRACTOR,
    WITHOUT_COLOURS,
    TrainingSettings,
    extractor_for,
    preset_for,
    settings_named,
    weighted,
    with_augmentations,
)
from .result_words import result_in_words
from .tracking import held_out_table, log_and_register
from .train import Trained, TrainRequest, fit_and_measure

AUTO = "auto"
_FROM_A_FILE = (
    "The extractor comes from a file: if it was chosen on this data, as a search does, the figures "
    "are somewhat too good."
)


@dataclass(frozen=True)
class TrainOptions:
    """The options of ``tokt train``, by its names: its help explains each."""

    dataset: str
    extractor: str | None = None
    preset: str = "best"
    name: str | None = None
    folds: int | None = None
    embargo: int | None = None
    split: str | None = None
    site: str | Sequence[str] | None = None
    weight: str | None = None
    max_samples: int | None = None
    class_weight: str | None = None
    changes: str | None = None
    fixed_boundary: bool = False
    stress: bool = False
    false_status_rate: float = DEFAULT_TARGET.rate
    confidence: float = DEFAULT_TARGET.confidence
    least_patches: int | str = AUTO
    frame_rule: str = AUTO
    ocean: PathOrText | None = None
    other: PathOrText | None = None
    jobs: int = -1
    dask: str | None = None
    sign: PathOrText | None = None
    workspace: PathOrText = Path(".tokt")


@dataclass(frozen=True, repr=False)
class TrainedVersion:
    """A trained and registered model version."""

    registered: RegisteredVersion  # as the registry lists it
    trained: Trained  # all that training found
    workspace: Path  # whose registry has it
    # Of the champion of that name, or else of the newest version before: its label, and what its
    # dives lost beyond the rule; None where nothing can be compared.
    before: str = ""
    worse: list[str] | None = None

    def __repr__(self) -> str:
        f1 = self.metrics["patch"]["f1"]
        held_out = "" if f1 is None else f": F1 {f1:.3f} of held-out patches"
        return f"{type(self).__name__}({self.label!r}{held_out})"

    @property
    def label(self) -> str:
        """``name/version``, as every command takes it."""
        return self.registered.label

    @property
    def metrics(self) -> dict[str, Any]:
        """Figures of the cross-validation: patch, frames, folds, and how they were measured."""
        return self.trained.metrics

    @property
    def operating_point(self) -> OperatingPoint:
        """When the model's patches become status 1."""
        return self.trained.operating_point

    def bundle(self) -> Bundle:
        """The version as a bundle, with all its checks; raises as `load_model`."""
        return Registry(self.workspace).bundle(self.label)

    def result(self) -> str:
        """The result in the five lines with which ``tokt train`` ends."""
        return "\n".join(result_in_words(self.label, self.trained))

    def to_json(self) -> dict[str, Any]:
        """The JSON object of ``tokt train --json``."""
        version, request = self.registered, self.trained.request
        return {
            "model": {"name": version.name, "version": version.version, "aliases": version.aliases},
            "run_id": version.run_id,
            "dataset": request.dataset.label,
            "dataset_hash": request.dataset.hash,
            "extractor": request.extractor.spec,
            "preset": request.settings.preset,
            "penalty": self.trained.choice.penalty,
            "class_weight": self.trained.choice.class_weight,
            "cv": self.metrics,
            "operating_point": self.operating_point.to_json(),
            "old_dives": {"before": self.before, "worse": self.worse},
        }


@takes(TrainOptions)
def train(options: TrainOptions, *, progress: Progress = no_progress) -> TrainedVersion:
    """Cross-validate, choose the operating point, train, log and register one model version.

    Parameters
    ----------
    options : TrainOptions
        Or its fields, as in the example.
    progress : callable, optional
        As for `build_dataset`.

    Returns
    -------
    TrainedVersion
        Its alias in the registry is ``challenger``; nothing becomes ``champion`` by itself.

    Raises
    ------
    ToktError
        If the dataset or an option cannot be used.

    Examples
    --------
    >>> version = tokt.train("tower", extractor="lbp", preset="plain")  # doctest: +SKIP
    >>> version.metrics["patch"]["f1"]  # doctest: +SKIP
    0.987
    """
    at_least(options, folds=2, embargo=0, max_samples=1000)
    workspace = Path(options.workspace)
    data = open_dataset(options.dataset, workspace / "datasets")
    settings = _settings(options, preset_for(options.preset, data), data)
    if (options.ocean or options.other) and not settings.two_images:
        raise ToktError("--ocean and --other go with --preset thesis")
    target = _target(options)
    if settings.two_images and target != DEFAULT_TARGET:
        raise ToktError(
            "preset thesis has the thesis's rule: no --false-status-rate, --confidence, "
            "--least-patches or --frame-rule"
        )
    named = options.extractor or DEFAULT_EXTRACTOR
    gray = settings.preset in WITHOUT_COLOURS and data.is_gray
    chosen = extractor_for(named, settings.preset, data.grid, gray)
    name = options.name or f"{data.name}-{_file_name(named)}"
    check_model_name(name)
    how = options.folds, options.embargo, options.split, options.weight, texts(options.site)
    split = Split.of(data, *how, with_choices=not settings.two_images)
    ocean, other = (Path(image) if image else None for image in (options.ocean, options.other))
    origin = _FROM_A_FILE if named.startswith("spec:") else ""
    request = TrainRequest(
        data, name, chosen, named, settings, split, ocean, other, target, selection=origin
    )
    key = signing_key(options.sign)
    registry = Registry(workspace, create=True)
    registry.experiment_id()  # a registry that cannot be reached is said before the work
    tested = STRESS if options.stress else ()
    trained = fit_and_measure(
        request, workspace / "cache", progress, options.jobs, options.dask, tested
    )
    before = _replaced(registry, name)
    version = TrainedVersion(log_and_register(trained, registry, key), trained, workspace)
    return version if before is None else compared_with(version, before, registry)


def _replaced(registry: Registry, name: str) -> RegisteredVersion | None:
    """The version that a new one stands against: the champion, or else the newest."""
    versions = registry.versions(name)
    champions = (one for one in versions if CHAMPION in one.aliases)
    return next(champions, versions[0] if versions else None)


def compared_with(
    version: TrainedVersion, before: RegisteredVersion, registry: Registry
) -> TrainedVersion:
    """Return the version with what the dives of the one before lost, if that can be told."""
    dataset = version.trained.request.dataset
    try:
        table, grid = registry.held_out(before.label), registry.recipe(before)["grid"]
    except ToktError:  # an older tokt kept none, or it is damaged
        return replace(version, before=before.label)
    if grid != dataset.grid.to_json():
        return replace(version, before=before.label)
    worse = held_out_falls(table, held_out_table(version.trained), dataset.obstacles())
    return replace(version, before=before.label, worse=worse)


def _settings(options: TrainOptions, preset: str, data: DatasetVersion) -> TrainingSettings:
    settings = weighted(settings_named(preset, data.grid), options.class_weight)
    settings = with_augmentations(settings, options.changes)
    if options.fixed_boundary:
        if not settings.moving_boundary or data.block_frames is None:
            what = "a folder of patches" if data.block_frames is None else f"preset {preset}"
            raise ToktError(f"--fixed-boundary is of no use: with {what} it is fixed anyway")
        settings = replace(settings, moving_boundary=False)
    if options.max_samples is not None:
        if settings.two_images:
            raise ToktError("preset thesis learns from two images: no --max-samples")
        settings = replace(settings, max_samples=options.max_samples)
    return settings


def _file_name(extractor: str) -> str:
    """The part of a model's name that says its extractor."""
    if extractor.startswith("spec:"):
        return Path(extractor.removeprefix("spec:")).stem
    return extractor.replace("+", "_")


def _target(options: TrainOptions) -> FalseStatusTarget:
    least, rule, text = None, None, str(options.least_patches)
    if text != AUTO:
        least = _number(text, "--least-patches", "2")
    if options.frame_rule != AUTO:
        hits, _, window = options.frame_rule.partition("/")
        rule = _number(hits, "--frame-rule", "2/3"), _number(window, "--frame-rule", "2/3")
    return FalseStatusTarget(options.false_status_rate, options.confidence, least, rule)


def _number(text: str, option: str, example: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise ToktError(f"{option} is {AUTO} or something like {example}, not {text!r}")
    return int(text)
