"""Learning curves: models of a part of the training blocks, scored on held-out folds; in words.

Nothing is chosen anew: each fold keeps the settings that its own training part chose.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64, I64, Bools
from tokt.features.frames.mission import format_frames
from tokt.models.registry.registry import Registry, fitting
from tokt.training.datasets.changed_patches import ChangedPatches, changed_patches
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.folds import Fold
from tokt.training.datasets.split import BLOCKS, Split
from tokt.training.fitting.classifier import decision_values, fit_rows, linear_model
from tokt.training.fitting.presets import Hyperparameters, TrainingSettings

from .bootstrap import ComparisonMetric, block_numbers, drawn_blocks, interval, summed
from .predictions import ModelPredictions, independent_units

FRACTIONS = (0.25, 0.5, 0.75, 1.0)
REPEATS = 3
_MAX_VALUES = 600_000  # rows times features of one fit: about 0.1 s
_MAX_STRETCHES = 16
_Fit = tuple[tuple[Any, ...], int, I64]
"""What a fit belongs to, its fold, and the blocks that it learns from."""
_SMALL = 0.01  # a gain that is not worth a day of labelling
_UNKNOWN: dict[str, Any] = {"low": None, "high": None}


@dataclass(frozen=True)
class Setting:
    """All that a fit needs; of the folds one training patch in `every` is left."""

    dataset: DatasetVersion
    features: F64
    augmented: list[ChangedPatches]
    folds: list[Fold]
    choices: list[Hyperparameters]
    settings: TrainingSettings
    every: int
    split: Split

    @cached_property
    def targets(self) -> I64:
        """The dataset's."""
        return self.dataset.targets()

    @cached_property
    def obstacle(self) -> Bools:
        """For each class whether it is one."""
        return np.asarray(self.dataset.obstacle_flags(), bool)

    @cached_property
    def measure(self) -> ComparisonMetric:
        """What models are compared by."""
        return ComparisonMetric.of(self.dataset.obstacle_flags())

    @cached_property
    def block(self) -> I64:
        """The block of each patch."""
        return block_numbers(self.dataset.patches.group.to_numpy())[1]

    @cached_property
    def unit(self) -> I64:
        """What each block is drawn with: its dive where there are several, else by itself."""
        of_patch = independent_units(self.dataset.patches)[1]
        return of_patch[np.unique(self.block, return_index=True)[1]]

    @property
    def units(self) -> int:
        """How many are drawn for an interval."""
        return int(self.unit.max()) + 1

    @property
    def tested(self) -> I64:
        """The rows that some fold tests, in order."""
        return np.sort(np.concatenate([fold.test for fold in self.folds]))

    def counts(self, predicted: I64, rows: I64) -> F64:
        """What predictions of some rows add to each block's counts."""
        targets = self.targets[rows]
        sides = self.obstacle[targets], self.obstacle[predicted]
        return self.measure.counts(targets, predicted, *sides, self.block[rows], len(self.unit))

    def predict(self, index: int, blocks: I64) -> I64:
        """Predictions of a fold's test rows by a model of some of its training blocks."""
        fold = self.folds[index]
        train = fold.train[np.isin(self.block[fold.train], blocks)]
        pipeline = fit_rows(
            *(self.features, self.targets, train, self.choices[index], self.settings),
            *(self.augmented, self.split.dives(self.dataset.patches)),
        )
        model = linear_model(pipeline, self.dataset.classes(), self.dataset.obstacle_flags())
        return model.predicted(decision_values(pipeline, self.features[fold.test]))


def _thinned(dataset: DatasetVersion, folds: list[Fold], dim: int) -> tuple[list[Fold], int]:
    """One training patch in n, drawn with a fixed seed, so that a fit takes a tenth of a second.

    A class that would be lost stays whole.
    """
    every = max(1, -(-max(len(fold.train) for fold in folds) * dim // _MAX_VALUES))
    if every == 1:
        return folds, 1
    targets = dataset.targets()
    kept = np.random.default_rng(0).random(len(targets)) < 1 / every
    for fold in folds:
        for target in np.unique(targets):
            if not kept[fold.train][targets[fold.train] == target].any():
                kept |= targets == target
    return [Fold(fold.train[kept[fold.train]], fold.test) for fold in folds], every


def set_up(
    predictions: ModelPredictions,
    dataset: DatasetVersion,
    workspace: Path,
    progress: Callable[..., Any],
) -> Setting:
    """What a registered model was fitted with, its cached features, and its folds, thinned."""
    recipe: Any = predictions.recipe
    registry = Registry(workspace)
    version = registry.find(predictions.label)
    with fitting(version, "list of parameters"):
        parameters = registry.parameters(version)
        split, settings = Split.logged(parameters), TrainingSettings.logged(parameters)
    with fitting(version):
        choices = [
            Hyperparameters(float(fold["penalty"]), fold.get("class_weight"))
            for fold in recipe["metrics"]["folds"]
        ]
        folds = split.cut(dataset.patches, dataset.targets())
        if len(folds) != len(choices):
            raise ValueError(f"{len(folds)} folds, choices of {len(choices)}")
    spec = dict(predictions.bundle.content.extractor_spec)
    cache = workspace / "cache"
    features = cached_features(dataset, spec, cache, progress)
    augmented = [changed_patches(dataset, spec, name, cache, progress) for name in settings.changes]
    folds, every = _thinned(dataset, folds, features.shape[1] * (1 + len(augmented)))
    return Setting(dataset, features, augmented, folds, choices, settings, every, split)


def _order(setting: Setting, fold: Fold, rng: np.random.Generator) -> I64:
    """A fold's training blocks as they are added: first enough of them to have every class."""
    block, targets = setting.block[fold.train], setting.targets[fold.train]
    order = rng.permutation(np.unique(block))
    first = []
    for target in np.unique(targets):
        having = set(block[targets == target].tolist())
        first.append(next(number for number in order.tolist() if number in having))
    needed = list(dict.fromkeys(first))
    return np.array([*needed, *(number for number in order.tolist() if number not in needed)])


def _curve_fits(setting: Setting) -> Iterator[_Fit]:
    """By fraction and repeat."""
    rng = np.random.default_rng(0)
    for index, fold in enumerate(setting.folds):
        orders = [_order(setting, fold, rng) for _ in range(REPEATS)]
        for fraction in FRACTIONS:
            for repeat, order in enumerate(orders[: 1 if fraction == 1 else REPEATS]):
                kept = max(len(np.unique(setting.targets)), round(fraction * len(order)))
                yield (fraction, repeat), index, order[:kept]


def _fits_without(setting: Setting, stretches: list[I64]) -> Iterator[_Fit]:
    """By number of the stretch that is left out."""
    for number, left_out in enumerate(stretches):
        for index, fold in enumerate(setting.folds):
            there = np.unique(setting.block[fold.train])
            rest = np.setdiff1d(there, left_out)
            known = setting.targets[fold.train][np.isin(setting.block[fold.train], rest)]
            lacking = len(np.unique(known)) < len(np.unique(setting.targets))
            if len(rest) < len(there) and not lacking:
                yield (number,), index, rest


def _wrong_by_label(setting: Setting, found: dict[tuple[float, int], I64]) -> list[dict[str, Any]]:
    """For each label the share of its patches that is judged wrong, by fraction."""
    tested = setting.tested
    labels = setting.dataset.patches.label.to_numpy()[tested]
    rows = []
    for label in sorted(set(labels)):
        mine = tested[labels == label]
        wrong: dict[float, list[float]] = defaultdict(list)
        for (fraction, _), predicted in found.items():
            wrong[fraction].append((predicted[mine] != setting.targets[mine]).mean())
        shares = [float(np.mean(wrong[fraction])) for fraction in FRACTIONS]
        rows.append({"label": str(label), "n": len(mine), "wrong": shares})
    return rows


def learning_curve(
    predictions: ModelPredictions,
    dataset: DatasetVersion,
    workspace: Path,
    progress: Callable[..., Any],
) -> dict[str, Any]:
    """Learn from growing parts of the training blocks, and from all but one stretch.

    The model is registered, and not of preset `thesis`, which learns from two images alone. Found
    are model, measure, points (fraction, blocks, mean, least, most), gains (from, to, difference,
    low, high), by_label, stretches (frames, obstacle, help, low, high; most helpful first), words
    (list of str) and how.
    """
    setting = set_up(predictions, dataset, workspace, progress)
    # Blocks one by one, or neighbours together where there are many.
    blocks, stretches = np.arange(len(setting.unit)), list[I64]()
    if dataset.block_frames is not None:
        stretches = np.array_split(blocks, min(len(blocks), _MAX_STRETCHES))
    fits = [*_curve_fits(setting), *_fits_without(setting, stretches)]
    curve: dict[Any, I64] = defaultdict(lambda: np.zeros_like(setting.targets))
    without: dict[int, dict[int, I64]] = defaultdict(dict)
    for key, fold, blocks in progress(fits, len(fits), "learning curve"):
        predicted = setting.predict(fold, blocks)
        if len(key) == 2:
            curve[key][setting.folds[fold].test] = predicted
        else:
            without[key[0]][fold] = predicted
    # What is drawn are dives where there are several: each with all its blocks.
    draws = drawn_blocks(setting.units)[:, setting.unit]
    rows = setting.tested
    counts = {key: setting.counts(predicted[rows], rows) for key, predicted in curve.items()}
    result = {
        "model": predictions.label,
        "measure": setting.measure.name,
        "measure_title": setting.measure.title,
        "points": _points(setting, counts),
        "gains": [_gain(setting, counts, draws, part) for part in (0.5, 0.75)],
        "by_label": _wrong_by_label(setting, curve),
        "stretches": _helped(setting, stretches, curve[1.0, 0], without, draws),
        "how": _how(setting),
    }
    return {**result, "words": learning_words(result)}


def _value(setting: Setting, counts: F64) -> float:
    return float(setting.measure.figure(counts.sum(axis=0)[None])[0])


def _points(setting: Setting, counts: dict[tuple[float, int], F64]) -> list[dict[str, Any]]:
    blocks = np.mean([len(np.unique(setting.block[fold.train])) for fold in setting.folds])
    points = []
    for fraction in FRACTIONS:
        values = [_value(setting, part) for (of, _), part in counts.items() if of == fraction]
        points.append(
            {
                "fraction": fraction,
                "blocks": round(float(fraction * blocks), 1),
                "mean": float(np.mean(values)),
                "least": float(np.min(values)),
                "most": float(np.max(values)),
            }
        )
    return points


def _gain(
    setting: Setting, counts: dict[tuple[float, int], F64], draws: F64, part: float
) -> dict[str, Any]:
    """What the blocks beyond a part of them brought, with its interval over test blocks."""
    figure = setting.measure.figure
    whole, fewer = counts[1.0, 0], [counts[part, repeat] for repeat in range(REPEATS)]
    spread = figure(summed(draws, whole)) - np.mean(
        [figure(summed(draws, item)) for item in fewer], axis=0
    )
    bounds = interval(spread, setting.units) or _UNKNOWN
    difference = _value(setting, whole) - float(np.mean([_value(setting, x) for x in fewer]))
    return {"from": part, "to": 1.0, "difference": difference, **bounds}


def _helped(
    setting: Setting,
    stretches: list[I64],
    whole: I64,
    without: dict[int, dict[int, I64]],
    draws: F64,
) -> list[dict[str, Any]]:
    """How much worse the other blocks are judged when a stretch is not learnt from."""
    figure = setting.measure.figure
    patches = setting.dataset.patches
    obstacle = setting.obstacle[setting.targets]
    found = []
    for number, parts in without.items():
        # Only of the folds that had the stretch to learn from.
        rows = np.concatenate([setting.folds[index].test for index in parts])
        other = setting.counts(np.concatenate(list(parts.values())), rows)
        same = setting.counts(whole[rows], rows)
        if setting.measure.name == "f1" and not obstacle[rows].any():
            continue  # the folds that are left hold no obstacle to find: no F1
        without_it = figure(summed(draws, other))
        bounds = interval(figure(summed(draws, same)) - without_it, setting.units) or _UNKNOWN
        mine = np.isin(setting.block, stretches[number])
        found.append(
            {
                "mission": ", ".join(sorted(set(patches.mission[mine]))),
                "frames": format_frames(patches.frame[mine].unique().tolist()),
                "patches": int(mine.sum()),
                "obstacle": int(obstacle[mine].sum()),
                "help": _value(setting, same) - _value(setting, other),
                **bounds,
            }
        )
    return sorted(found, key=lambda row: -float(row["help"]))


def _how(setting: Setting) -> str:
    thin = f" (one patch in {setting.every} of them, drawn)" if setting.every > 1 else ""
    same = "blocks are of the same dives" if setting.dataset.block_frames else "are of one folder"
    if setting.split.unit(setting.dataset.patches) != BLOCKS:
        same = "blocks learnt from are of the same dives, those tested of others"
    return (
        f"Each fold's model learnt anew from a part of its training blocks{thin} and was tested on "
        f"the fold that was held out. The blocks came in {REPEATS} random orders (seed 0), with "
        f"the settings that each fold had chosen. All {same}: this says nothing of what labels of "
        "another dive would bring."
    )


def learning_words(result: dict[str, Any]) -> list[str]:
    """What a learning curve, as `learning_curve` gives it, says: a sentence each."""
    return [*_gain_words(result), *_label_words(result), *_stretch_words(result)]


def _bounds_words(row: dict[str, Any]) -> str:
    if row["low"] is None:
        return ""
    return f" (95 % interval {row['low']:+.3f} to {row['high']:+.3f})"


def _gain_words(result: dict[str, Any]) -> list[str]:
    """The verdict rests on what the last blocks brought: the first ones always help."""
    half, last = result["gains"]
    title = result["measure_title"]
    if last["low"] is None:
        verdict = "Too few blocks to say whether more labels would help"
    elif last["low"] > 0:
        verdict = "More labels of this kind would probably still help"
    elif last["high"] < _SMALL:
        verdict = "More labels of this kind would hardly help"
    else:
        verdict = "Cannot tell whether more labels of this kind would help"
    return [
        f"{verdict}: from three quarters of the blocks to all, {title} changed by "
        f"{last['difference']:+.3f}{_bounds_words(last)}, from half to all by "
        f"{half['difference']:+.3f}{_bounds_words(half)}."
    ]


def _label_words(result: dict[str, Any]) -> list[str]:
    rows = [row for row in result["by_label"] if row["n"]]
    worst = max(rows, key=lambda row: row["wrong"][-1])
    half = [point["fraction"] for point in result["points"]].index(0.5)
    gains = {row["label"]: row["wrong"][half] - row["wrong"][-1] for row in rows}
    most = max(gains, key=lambda label: gains[label])
    said = (
        f"By class: {worst['label']} is judged wrong most often ({worst['wrong'][-1]:.1%} of "
        f"{worst['n']} patches)"
    )
    if gains[most] > 0:
        said += (
            f"; the second half of the blocks helped {most} most (its share judged wrong fell by "
            f"{100 * gains[most]:.1f} percentage points)"
        )
    return [f"{said}."]


def _stretch_words(result: dict[str, Any]) -> list[str]:
    rows = result["stretches"]
    if not rows:
        return []
    best, least = rows[0], rows[-1]
    words = [
        f"By stretch: frames {best['frames']} of {best['mission']} ({best['obstacle']} obstacle "
        f"patches) helped the other blocks most: with them {result['measure_title']} is "
        f"{best['help']:+.3f} from what it is without{_bounds_words(best)}."
    ]
    if best["low"] is None or best["low"] <= 0:
        words.append(f"Of {len(rows)} stretches none helps beyond doubt; their order may be luck.")
    if least["high"] is not None and least["high"] < 0:
        words.append(
            f"Learning from frames {least['frames']} of {least['mission']} made the other blocks "
            f"worse by {-least['help']:.3f}{_bounds_words(least)}. They look unlike the rest, or "
            "their labels are worth a second look."
        )
    return words
