"""Label audit: labels that are contradicted by models that did not learn them, ranked.

The rule, a plain one. Each patch is judged by a model trained without its block of frames; its
margin is the decision value for its label (for several classes: less the best other one), so that
below 0 the model decides otherwise. Wrong labels also spoil the models they are learnt by: hence a
second pass, in which labels that the first one contradicts are not learnt (at most half of a
class in a fold). Ranked by the mean of both margins; listed where it is below 0.

Why not cleanlab (2.9, Apache licence; it runs here and needs tqdm and termcolor besides what we
have): it asks for probabilities, which a linear SVM has to be calibrated for, and then orders the
patches as the margin does. Measured on the sea-trial mission (20,841 sure patches, 122 features,
5 blocked folds; n labels flipped at random, 4 draws each; share of flipped ones among the first n,
and share of all flipped ones that are found among the first 3 n):

=============================  ============  ============  ============
flipped                        20 + 20       30 + 30       40 anywhere
=============================  ============  ============  ============
margin, one pass               0.41 | 0.65   0.43 | 0.82   0.59 | 0.98
cleanlab self-confidence       0.37 | 0.62   0.38 | 0.82   0.57 | 0.98
cleanlab, adjusted             0.35 | 0.66   0.45 | 0.86   0.27 | 0.98
margin, both passes (this)     0.66 | 0.89   0.76 | 0.93   0.58 | 0.98
=============================  ============  ============  ============

("20 + 20": 20 obstacles said to be ocean and 20 ocean patches said to be obstacles. The mission has
doubtful labels of its own, which also rank high and count as misses here.)
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import ThreadpoolController

from tokt.features.common.arrays import F64, I64
from tokt.features.common.errors import ToktError
from tokt.labels.formats.audit_csv import Audit, AuditedPatch
from tokt.labels.record import utc_now
from tokt.models.registry.registry import Registry, fitting
from tokt.training.datasets.changed_patches import changed_patches
from tokt.training.datasets.dataset import (
    FRAME_KEY,
    OBSTACLE,
    PATCH_KEY,
    DatasetVersion,
    open_dataset,
)
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.folds import BLOCK, Fold
from tokt.training.datasets.split import PATCH, Split

from .classifier import Tables, decision_values, fit_rows
from .cross_validation import check_features, choose_hyperparameters
from .presets import (
    DEFAULT_EXTRACTOR,
    PRESETS,
    Hyperparameters,
    TrainingSettings,
    extractor_for,
    preset_for,
    settings_named,
)

PRESET = "best"
_UNGROUPED = (
    " UNGROUPED: nothing says which patches come from one photo; a wrong label may be confirmed by "
    "a near copy of its patch. Frame n is the folder's n-th picture, by class and file name."
)


@dataclass(frozen=True)
class AuditInput:
    """The dataset to audit, and the model settings to audit it with."""

    label: str  # the dataset or model, for people
    name: str  # the same, fit for a file's name
    dataset: DatasetVersion
    extractor_spec: dict[str, Any]
    split: Split
    settings: TrainingSettings  # of a model, with what it was trained with as the only candidate
    first: F64 | None = None  # (n_patches, n_outputs), a model's of held-out patches, if known


def audit_input_named(reference: str, workspace: Path, folds: int | None = None) -> AuditInput:
    """A dataset (``NAME``, ``NAME@HASH``) or else a model (``NAME@ALIAS``, ``NAME/VERSION``).

    `folds` are for a dataset; a model has its own. Raises ToktError if it is neither, or a model of
    which no held-out values can be told.
    """
    root = workspace / "datasets"
    name, _, prefix = reference.partition("@")
    if any((root / name).glob(f"{prefix}*/dataset.json" if prefix else "latest")):
        return _of_dataset(open_dataset(reference, root), folds)
    if not (workspace / "mlflow.db").exists():
        known = ", ".join(sorted(path.parent.name for path in root.glob("*/latest")))
        raise ToktError(
            f"{reference!r} is neither a dataset (there are: {known or 'none yet'}) nor a model: "
            "none has been trained in this workspace"
        )
    if folds is not None:
        raise ToktError(f"--folds goes with a dataset; model {reference} has its own")
    return _of_model(Registry(workspace), reference, root)


def _of_dataset(dataset: DatasetVersion, folds: int | None) -> AuditInput:
    preset = preset_for(PRESET, dataset)
    gray = preset != PRESET and dataset.is_gray
    return AuditInput(
        f"dataset {dataset.label}",
        dataset.label,
        dataset,
        extractor_for(DEFAULT_EXTRACTOR, preset, dataset.grid, gray).spec,
        Split.of(dataset, folds, by=BLOCK, weight=PATCH),
        settings_named(preset, dataset.grid),
    )


def _of_model(registry: Registry, reference: str, datasets: Path) -> AuditInput:
    version = registry.find(reference)
    recipe = registry.recipe(version)
    with fitting(version):
        made_by, extractor = recipe["provenance"], recipe["extractor"]
        if made_by["preset"] == "thesis":
            raise ToktError(
                f"model {version.label} learnt from two images and no label of its dataset; audit "
                f"dataset {made_by['dataset']} instead"
            )
        dataset, settings = open_dataset(made_by["dataset"], datasets), _settings_of(made_by)
    with fitting(version, "list of parameters"):
        parameters = registry.parameters(version)
        split = Split.logged(parameters)
        most = int(parameters.get("setting_max_samples", settings.max_samples))
        settings = replace(settings, max_samples=most)
    return AuditInput(
        f"model {version.label} ({dataset.label})",
        f"{version.name}-{version.version}",
        dataset,
        extractor,
        split,
        settings,
        _first_values(registry.held_out(version.label), dataset),
    )


def _settings_of(made_by: dict[str, Any]) -> TrainingSettings:
    weight, changes = made_by.get("class_weight", "none"), made_by.get("learnt_changes", "none")
    choice = Hyperparameters(made_by["penalty"], None if weight == "none" else weight)
    return replace(
        PRESETS.get(made_by["preset"], PRESETS[PRESET]),  # a search's are those of the best one
        penalties=(choice.penalty,),
        class_weights=(choice.class_weight,),
        changes=() if changes == "none" else tuple(changes.split(", ")),
    )


def _first_values(table: pd.DataFrame, dataset: DatasetVersion) -> F64 | None:
    """The registered held-out values; None where an older tokt did not keep them."""
    columns = [name for name in table if name.startswith("value_")]
    same = table[PATCH_KEY].equals(dataset.patches[PATCH_KEY])
    return table[columns].to_numpy(np.float64) if columns and same else None


def audit(
    audited: AuditInput,
    cache: Path,
    progress: Callable[..., Any],
    top: int | None = None,
    jobs: int = -1,
) -> Audit:
    """Rank the labels that held-out decisions contradict, or the `top` worst ones; changes none.

    `cache` is the folder of the feature cache; the result does not depend on `jobs`. Raises
    ToktError if the dataset cannot be cross-validated, or was changed on disk.
    """
    dataset, split = audited.dataset, audited.split
    dataset.check()
    folds = split.cut(dataset.patches, dataset.targets())
    spec = audited.extractor_spec
    features = cached_features(dataset, spec, cache, progress, jobs)
    augmented = [
        changed_patches(dataset, spec, name, cache, progress, jobs)
        for name in audited.settings.changes
    ]
    check_features(dataset, features)
    with ThreadpoolController().limit(limits=1):
        passes = progress(folds, len(folds), "second pass")
        margins, decided = _judge(audited, features, augmented, passes)
    order = np.argsort(margins, kind="stable")
    order = order[margins[order] < 0][:top]
    return Audit(
        audited.name,
        audited.label,
        dataset.grid,
        _rule(audited, len(folds)),
        tuple(_doubted(dataset, order, margins, decided)),
        utc_now(),
    )


def _rule(audited: AuditInput, folds: int) -> str:
    grouped = audited.dataset.block_frames is not None
    over = f"whole {audited.split.unit(audited.dataset.patches)}" if grouped else "single patches"
    return (
        f"mean of two held-out margins ({folds} folds over {over}); the second "
        "without learning what the first contradicts. Decision values; below 0 the label's class "
        f"loses.{'' if grouped else _UNGROUPED}{audited.split.judged_words(audited.dataset)}"
    )


def _judge(
    audited: AuditInput, features: F64, augmented: Tables, folds: Iterable[Fold]
) -> tuple[F64, I64]:
    """Mean margin of each patch, and the index of the best class beside its label."""
    dataset, settings = audited.dataset, audited.settings
    targets = dataset.targets()
    first, choice = audited.first, settings.choices[0]
    if first is None:
        chosen = choose_hyperparameters(
            dataset.patches, features, targets, settings, audited.split, augmented
        )
        first, choice = chosen.values, chosen.choice
    before = label_margins(first, targets)
    second, dives = np.full_like(first, np.nan), audited.split.dives(dataset.patches)
    for fold in folds:
        believed = believable(fold, before, targets)
        model = fit_rows(features, targets, believed, choice, settings, augmented, dives)
        second[fold.test] = decision_values(model, features[fold.test])
    mean = (before + label_margins(second, targets)) / 2
    _, others = _own_and_others((first + second) / 2, targets)
    return mean, others.argmax(axis=1)


def label_margins(values: F64, targets: I64) -> F64:
    """By how much each label wins by decision values, (n, n_outputs); below 0 it loses."""
    own, others = _own_and_others(values, targets)
    return np.asarray(own - others.max(axis=1), np.float64)


def _own_and_others(values: F64, targets: I64) -> tuple[F64, F64]:
    """The value of each label's class, and those of all classes with -inf in its place."""
    two = values.shape[1] == 1
    others = np.column_stack([np.zeros(len(values)), values]) if two else values.copy()
    rows = np.arange(len(targets))
    own = others[rows, targets]
    others[rows, targets] = -np.inf
    return own, others


def believable(fold: Fold, margins: F64, targets: I64) -> I64:
    """A fold's training rows without those that are contradicted, at most half of each class."""
    kept = []
    for target in np.unique(targets[fold.train]):
        rows = fold.train[targets[fold.train] == target]
        kept.append(rows[margins[rows] >= min(0.0, float(np.median(margins[rows])))])
    return np.sort(np.concatenate(kept))


def _doubted(dataset: DatasetVersion, order: I64, margins: F64, decided: I64) -> list[AuditedPatch]:
    """The patches of these rows, in words."""
    names = _suggestions(dataset)
    classes = dataset.classes()
    chosen = dataset.patches.iloc[order]
    near = dataset.patches.merge(chosen[FRAME_KEY].drop_duplicates(), on=FRAME_KEY)
    labels = near.set_index(PATCH_KEY).label.to_dict()
    patches = []
    for row, place in zip(chosen.itertuples(index=False), order.tolist(), strict=True):
        said, margin = classes[decided[place]], float(margins[place])
        around = _around(labels, row)
        suggested = _suggested(dataset, around, said) or names[decided[place]]
        reason = f"a model that did not learn it takes it for {said} by {-margin:.2f}"
        patches.append(
            AuditedPatch(
                *(str(row.mission), str(row.camera), int(row.frame), int(row.row), int(row.col)),
                str(row.label),
                suggested,
                round(margin, 4),
                reason + _neighbours_words(around, suggested),
            )
        )
    return patches


def _suggestions(dataset: DatasetVersion) -> tuple[str, ...]:
    """The label to suggest for each class: for clear and obstacle, the commonest such label."""
    if dataset.task != "binary":
        return dataset.classes()
    counts = dataset.patches.label.value_counts()
    names = {dataset.taxonomy.is_obstacle(str(name)): str(name) for name in counts.index[::-1]}
    return tuple(names[side == OBSTACLE] for side in dataset.classes())


def _suggested(dataset: DatasetVersion, around: Sequence[str], said: str) -> str:
    """The commonest label around a patch of the side that the model says; empty where none is."""
    if dataset.task != "binary":
        return ""
    obstacle = said == OBSTACLE
    fitting = [label for label in around if dataset.taxonomy.is_obstacle(label) == obstacle]
    return max(fitting, key=fitting.count, default="")


def _around(labels: dict[Any, str], row: Any) -> list[str]:
    """The labels of the patches around a patch."""
    cells = (
        (row.mission, row.camera, row.frame, row.row + down, row.col + right)
        for down in (-1, 0, 1)
        for right in (-1, 0, 1)
        if (down, right) != (0, 0)
    )
    return [labels[cell] for cell in cells if cell in labels]


def _neighbours_words(around: Sequence[str], suggested: str) -> str:
    """How many of the patches around a patch have the suggested label."""
    if not around:
        return ""
    return f"; {around.count(suggested)} of {len(around)} labelled neighbours are {suggested}"
