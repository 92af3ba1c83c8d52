"""A registered model that learns a new dive too: what that gains there and costs elsewhere."""

import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy.stats import mannwhitneyu
from threadpoolctl import ThreadpoolController

from tokt.features.common.arrays import F64, I64, Bools
from tokt.features.common.errors import ToktError, counted
from tokt.labels.page.suggestions.queue import next_frames
from tokt.labels.page.suggestions.suggester import suggestions
from tokt.labels.page.suggestions.suggestion_table import MissionSuggestions
from tokt.models.bundle.bundle import Bundle
from tokt.models.operating_point import OperatingPoint
from tokt.models.registry.registry import Registry, fitting
from tokt.training.datasets.changed_patches import changed_patches
from tokt.training.datasets.dataset import PATCH_KEY, DatasetVersion, open_dataset
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.folds import DIVE, FULL_DIVE, Fold, embargo_of
from tokt.training.datasets.split import Split
from tokt.training.evaluation.metrics import obstacle_metrics
from tokt.training.evaluation.old_dives import falls
from tokt.training.parallel import mapped

from .carried import install_carried
from .choose_operating_point import FalseStatusTarget
from .classifier import Tables, decision_values, fit_rows, in_parts
from .presets import Hyperparameters, TrainingSettings
from .train import TrainRequest
from .whole_frames import WholeFrames, judged

COUNTS = (1, 2, 3, 5, 8, 13, 21)
"""Labelled frames of the new dive that a point of the curve is learnt from; a third are left."""
USUAL = 1.0
TIMES = tuple(2.0**-exponent for exponent in range(-2, 9))
"""How many times its usual share (`Dives.weights`) the new dive may count, never above a full dive.

More of it helps the new dive, and costs the old ones more (docs/explanation/waters.md). Where all
labels are water, or all are obstacles, nothing vouches for them: then it counts `USUAL` at least.
"""
_MIN_LAST, _MIN_STEPS = 3, 3  # labelled frames, and orders, that tell what the next ones bring
_SMALL = 0.01  # of F1
_CONTRADICTION = 0.023  # p-value: of two standard deviations below a model that knows nothing
_MOST = 0.75  # of the orders
_FIGURES = ("f1", "average_precision", "precision", "recall", "false_positive", "false_negative")


@dataclass(frozen=True)
class KnownModel:
    """A model with all that it was trained with."""

    name: str  # of the next version
    bundle: Bundle
    dataset: DatasetVersion
    extractor_name: str
    target: FalseStatusTarget
    settings: TrainingSettings
    split: Split
    choice: Hyperparameters
    fold_choices: list[Hyperparameters]


def known_model(registry: Registry, reference: str, datasets: Path) -> KnownModel:
    """Read a registered model and what it was trained with.

    Raises ToktError if it is not there, or learnt from two images or a folder of patches: no dives.
    """
    version = registry.find(reference)
    recipe, parameters = registry.recipe(version), registry.parameters(version)
    with fitting(version):
        dataset = open_dataset(recipe["provenance"]["dataset"], datasets)
        choices = _choices(recipe["provenance"], recipe["metrics"])
    with fitting(version, "list of parameters"):
        settings, split = TrainingSettings.logged(parameters), Split.logged(parameters)
        asked = parameters["extractor"], FalseStatusTarget.logged(parameters)
    if settings.two_images or dataset.block_frames is None:
        what = "two images" if settings.two_images else "a folder of patches"
        raise ToktError(f"model {version.label} learnt from {what}, not from dives: train another")
    table, bundle = registry.held_out(version.label), registry.bundle(version.label)
    if not table[PATCH_KEY].equals(dataset.patches[PATCH_KEY]):
        raise ToktError(f"model {version.label}: its held_out.parquet is of another dataset")
    with fitting(version, "list of folds"):
        judged = split.cut(dataset.patches, dataset.targets())
        if len(judged) != len(choices[1]):
            raise ValueError(f"{len(judged)} folds, choices of {len(choices[1])}")
    return KnownModel(bundle.name, bundle, dataset, *asked, settings, split, *choices)


def packaged_model(bundle: Bundle, datasets: Path) -> KnownModel:
    """Read a model that comes with tokt; its dataset goes into the workspace's ``datasets``.

    A next version is a model of its own: the name in the result has to be replaced.
    """
    carried = install_carried(bundle, datasets)
    parameters = carried.parameters
    try:
        return KnownModel(
            bundle.name,
            bundle,
            carried.dataset,
            parameters["extractor"],
            FalseStatusTarget.logged(parameters),
            TrainingSettings.logged(parameters),
            Split.logged(parameters),
            *_choices(bundle.provenance, bundle.metrics),
        )
    except (KeyError, ValueError, TypeError, AttributeError, SyntaxError):
        raise ToktError(f"model {bundle.label}: what it was trained with is damaged") from None


def _choices(
    made_by: Mapping[str, Any], metrics: Mapping[str, Any]
) -> tuple[Hyperparameters, list[Hyperparameters]]:
    """Return what a model was fitted with, and each of its folds."""
    weight = made_by.get("class_weight", "none")
    choice = Hyperparameters(made_by["penalty"], None if weight == "none" else weight)
    folds = metrics["folds"]
    return choice, [Hyperparameters(one["penalty"], one.get("class_weight")) for one in folds]


def adapted_request(
    known: KnownModel,
    dataset: DatasetVersion,
    by: str | None = None,
    sites: Sequence[str] = (),
    added: Mapping[str, float] | None = None,
) -> TrainRequest:
    """A request for the model's next version: all as before, and the new dive.

    `dataset` is the model's, with the new dive. `by` and `sites` are as for `Split.of`; what is
    left open is the model's own, but for one of a single dive. `added` is as of `Split`, of the new
    dive.

    Raises ToktError as `Split.of`; or if the new dive has a class that the model does not tell.
    """
    old, bundle = known.split, known.bundle
    more = sorted(set(dataset.classes()) - set(known.dataset.classes()))
    if more:
        raise ToktError(f"model {bundle.label} does not tell {', '.join(more)}: train another")
    several = known.dataset.patches.mission.nunique() > 1
    by, weight = by or (old.by if several else None), old.weight if several else None
    # A model of single pictures has no embargo; a sequence that comes to it needs one.
    embargo = old.embargo_frames
    if known.dataset.block_frames == 1:
        embargo = max(embargo, embargo_of(dataset.block_frames))
    asked = embargo, by, weight, sites
    split = Split.of(dataset, old.folds, *asked)
    try:
        split.check(dataset.patches, dataset.targets())
    except ToktError:  # the new dive alone is too small to choose by
        split = Split.of(dataset, None, *asked)
    return TrainRequest(
        dataset,
        known.name,
        bundle.extractor,
        known.extractor_name,
        known.settings,
        replace(
            split,
            sites=split.sites if sites else {**old.sites, **split.sites},
            added={**old.added, **(added or {})},
        ),
        target=known.target,
        search=bundle.content.provenance.get("search"),
        known_sight=() if dataset.pictured.all() else tuple(bundle.sight),
        selection=f"Extractor and settings are those of {bundle.label}.",
    )


class _NewDive:
    """The new dive in the dataset, and models of the old dives and some of its frames.

    Its frames are named by their place in `frames`, which are positions in the dive.
    `unseen[i, j]`: whether a model that learnt from frame i has not as good as seen frame j, its
    copy, its neighbour or one of an old dive's block. `before` are the old model's scores.
    """

    def __init__(
        self,
        known: KnownModel,
        request: TrainRequest,
        name: str,
        features: F64,
        augmented: Tables,
        whole: WholeFrames | None,
    ) -> None:
        self.known, self.request, self.dataset = known, request, request.dataset
        self.patches, self.targets = self.dataset.patches, self.dataset.targets()
        self.obstacle = self.dataset.obstacles()
        mine = (self.patches.mission == name).to_numpy()
        sites = request.split.sites if known.split.by == DIVE else {}
        site = self.patches.mission.map(lambda mission: sites.get(mission, mission))
        self.sister = (site == sites.get(name, name)).to_numpy()  # of the same site
        self.rows, self.old_rows = np.flatnonzero(mine), np.flatnonzero(~mine)
        self.group = self.patches.group.to_numpy()
        self.frames, self.place = np.unique(self.patches.position[mine], return_inverse=True)
        copied = np.isin(self.group[mine], self.group[~mine])
        self.testable = ~np.isin(np.arange(len(self.frames)), self.place[copied])
        self.listed = self.dataset.frames[self.dataset.frames.mission == name]
        near = 0 if name in request.split.single_pictures else request.split.embargo_frames
        unseen = np.abs(self.frames[:, None] - self.frames) > near
        for _, numbers in self.listed.groupby("digest").position:
            same = np.isin(self.frames, numbers)
            unseen &= ~np.outer(same, same)
        self.unseen = unseen & self.testable
        self._rest = known.settings, augmented, request.split.dives(self.patches)
        self._features, self._whole = features, whole
        before = partial(in_parts, known.bundle.model.decision_values)
        prior = known.bundle.operating_point.water
        self.before = self.scores(judged(before, features, self.rows, whole, prior), self.rows)

    def scores(self, values: F64, rows: I64) -> F64:
        """Obstacle scores of the dive's patches; NaN of those without a value."""
        found = np.full(len(self.rows), np.nan)
        found[np.searchsorted(self.rows, rows)] = self.known.bundle.model.obstacle_score(values)
        return found

    def counting(self, request: TrainRequest) -> Self:
        """Return the same dive, counting in learning as a request says."""
        other = copy(self)
        other.request, (settings, augmented, _) = request, self._rest
        other._rest = settings, augmented, request.split.dives(self.patches)
        return other

    @property
    def is_one_sided(self) -> bool:
        """Whether all labels of the dive are obstacles, or none is."""
        return bool(len(np.unique(self.obstacle[self.rows])) < 2)

    @property
    def possible_times(self) -> tuple[float, ...]:
        """Of `TIMES` those by which it may count."""
        least = USUAL if self.is_one_sided else 0.0
        most = math.sqrt(FULL_DIVE / min(len(self.rows), FULL_DIVE))
        return tuple(times for times in TIMES if least <= times <= most)

    def fold(self, learnt: frozenset[int]) -> Fold:
        """Learn from the old dives and these frames; test those that are not as good as seen."""
        mine = np.isin(self.place, list(learnt))
        tested = np.isin(self.place, np.flatnonzero(self.unseen[list(learnt)].all(axis=0)))
        return Fold(np.sort(np.concatenate([self.old_rows, self.rows[mine]])), self.rows[tested])

    def old_folds(self, learnt: bool) -> Iterator[Fold]:
        """The old model's folds; `learnt`: the new dive too, but for copies of what is tested.

        Where whole sites are held out, it is not learnt with a dive of its own site.
        """
        old = self.known.dataset
        for fold in self.known.split.cut(old.patches, old.targets()):
            test = self.old_rows[fold.test]
            mine = self.rows[~np.isin(self.group[self.rows], self.group[test])]
            if not learnt or self.sister[test].any():
                mine = mine[:0]
            yield Fold(np.sort(np.concatenate([self.old_rows[fold.train], mine])), test)

    def task(self, fold: Fold, choice: Hyperparameters) -> tuple[Any, ...]:
        """One fit, for `_tested`."""
        prior = self.known.bundle.operating_point.water
        return self._features, self.targets, fold, choice, self._rest, self._whole, prior

    def both(self, after: F64) -> dict[str, Any]:
        """Figures of the old model and of another on the patches that the other has scored."""
        told = np.isfinite(after)
        return _both(self.obstacle[self.rows][told], self.before[told], after[told])


def _tested(task: tuple[Any, ...]) -> F64:
    """Decision values of a fold's test rows; where the boundary moves, over those frames of it."""
    features, targets, fold, choice, (settings, augmented, dives), whole, prior = task
    pipeline = fit_rows(features, targets, fold.train, choice, settings, augmented, dives)
    return judged(partial(decision_values, pipeline), features, fold.test, whole, prior)


def _both(truth: Bools, before: F64, after: F64) -> dict[str, Any]:
    was, now = (obstacle_metrics(truth, scores) for scores in (before, after))
    known = was["f1"] is not None and now["f1"] is not None
    return {
        "before": {name: was[name] for name in _FIGURES},
        "after": {name: now[name] for name in _FIGURES},
        "change": now["f1"] - was["f1"] if known else None,
    }


@dataclass(frozen=True)
class Adaptation:
    """What learning a new dive too gains and costs, before anything is registered."""

    request: TrainRequest  # of the next version
    told: dict[str, Any]  # as `adaptation` says; plain JSON


def adaptation(
    known: KnownModel,
    dataset: DatasetVersion,
    name: str,
    cache: Path,
    progress: Callable[..., Any],
    draws: int,
    jobs: int = -1,
    by: str | None = None,
    sites: Sequence[str] = (),
    forced: bool = False,
) -> Adaptation:
    """Find how much a new dive may count, what it gains, costs, and what more labels would bring.

    The dive counts by the most of `TIMES` at which the old dives lose no more than the rule allows,
    held out as the old model held them out; they are bisected. Nothing is chosen on the new dive's
    frames: fits have the model's own C, those of the old folds the folds'; a boundary that moves
    with the water starts from the model's own prior.

    Parameters
    ----------
    dataset : DatasetVersion
        The model's, with the new dive.
    name : str
        The new dive.
    draws : int
        Orders in which its frames are labelled, drawn with a fixed seed.
    by, sites
        As for `adapted_request`.
    forced : bool
        Whether the dive counts its usual share, whatever the old dives lose.

    Returns
    -------
    Adaptation
        Its JSON: mission, before (the model), labelled, times (how many times its share the dive
        counts, if by_dive), lost (by old dive), worse (`falls`), tried (times and worse of all that
        were tried), gained (null where nothing can be told), curve (a dict a number of labelled
        frames).
    """
    spec, moving = known.bundle.extractor.spec, known.settings.moving_boundary
    features = cached_features(dataset, spec, cache, progress, jobs, whole_frames=moving)
    augmented = [
        changed_patches(dataset, spec, change, cache, progress, jobs)
        for change in known.settings.changes
    ]
    whole = WholeFrames.of(dataset, features, known.bundle.extractor) if moving else None
    with ThreadpoolController().limit(limits=1):

        def request_counting(times: float) -> TrainRequest:
            return adapted_request(known, dataset, by, sites, {name: times})

        usual = _NewDive(known, request_counting(USUAL), name, features, augmented, whole)
        before, faults = _old_scores(usual, False, progress, jobs), _contradiction(usual)
        tried: dict[float, dict[str, Any]] = {}

        def holds(times: float) -> bool:
            after = _old_scores(usual.counting(request_counting(times)), True, progress, jobs)
            lost = _lost(usual, before, after)
            tried[times] = {"times": times, "lost": lost, "worse": [*faults, *_worse(lost)]}
            return not tried[times]["worse"]

        alone = bool(faults) or forced or usual.request.split.weight != DIVE
        several = (USUAL,) if alone else usual.possible_times
        first = bisect_left(several, True, key=holds)
        chosen = tried[several[min(first, len(several) - 1)]]
        dive = usual.counting(request_counting(chosen["times"]))
        gained, curve = _gained_and_curve(dive, _orders(dive, known.bundle, draws), progress, jobs)
    told: dict[str, Any] = {
        "mission": name,
        "before": known.bundle.label,
        "labelled": {
            "frames": len(dive.frames),
            "patches": len(dive.rows),
            "obstacles": int(dive.obstacle[dive.rows].sum()),
            "of_old_blocks": int((~dive.testable).sum()),
        },
        **chosen,
        "by_dive": dive.request.split.weight == DIVE,
        "tried": [
            {"times": times, "worse": tried[times]["worse"]}
            for times in sorted(tried, reverse=True)
        ],
        "gained": gained,
        "curve": curve,
    }
    return Adaptation(dive.request, {**told, "words": _words(told)})


def with_rate(told: Mapping[str, Any], operating_point: OperatingPoint) -> dict[str, Any]:
    """Add whether the rate of false statuses in the new dive is unknown (rate_unknown, words)."""
    name, chosen, words = told["mission"], operating_point.chosen, told["words"]
    unknown = chosen["method"] == "none" or name in chosen.get("rate_unknown_in", ())
    if unknown:
        words = [*words, f"Rate of false statuses in {name}: unknown."]
    return {**told, "rate_unknown": unknown, "words": words}


def _gained_and_curve(
    dive: _NewDive, orders: list[list[int]], progress: Callable[..., Any], jobs: int
) -> tuple[dict[str, Any] | None, list[dict[str, Any]]]:
    """What the new dive's frames gain, and that by the number of frames that were labelled."""
    frames = len(dive.frames)
    counts = [count for count in COUNTS if count <= frames - max(1, frames // 3)]
    others = [frozenset(np.flatnonzero(row).tolist()) for row in dive.unseen.T]
    wanted = {frozenset(order[:count]) for order in orders for count in counts} | {*others}
    folds = {some: dive.fold(some) for some in sorted(wanted, key=sorted) if some}
    folds = {some: fold for some, fold in folds.items() if len(fold.test)}
    tasks = [dive.task(fold, dive.known.choice) for fold in folds.values()]
    values = progress(mapped(_tested, tasks, jobs), len(tasks), "with some of the new dive")
    by_learnt = {
        some: dive.scores(one, fold.test)
        for (some, fold), one in zip(folds.items(), values, strict=True)
    }
    by_learnt[frozenset()] = np.where(dive.testable[dive.place], dive.before, np.nan)
    gained = _gained(dive, [by_learnt.get(some) if some else None for some in others])
    return gained, [_point(dive, count, orders, by_learnt) for count in (0, *counts)]


def _orders(dive: _NewDive, bundle: Bundle, draws: int) -> list[list[int]]:
    """The queue's order of the labelled frames, by the old model alone; then drawn ones."""
    described = [
        bundle.extractor.describe(dive.dataset.read_frame(index), bundle.grid)
        for index in dive.listed.index
    ]
    known = MissionSuggestions(
        dive.listed.camera.to_numpy(str),
        dive.listed.position.to_numpy(np.int64),
        np.stack(
            [suggestions(bundle.model, bundle.values_alone(rows)).values for rows in described]
        ),
        np.stack([np.r_[rows.mean(0), rows.std(0)] for rows in described]).astype(np.float32),
        len(bundle.model.classes) > 2,
    )
    queued = dict.fromkeys(entry.frame for entry in next_frames(known, [], len(described)))
    rng = np.random.default_rng(0)
    drawn = [rng.permutation(len(dive.frames)).tolist() for _ in range(draws)]
    return [np.searchsorted(dive.frames, list(queued)).tolist(), *drawn]


def _contradiction(dive: _NewDive) -> list[str]:
    """A line where the labels say the opposite of the old model: as where classes were swapped."""
    truth = dive.obstacle[dive.rows]
    if dive.is_one_sided or not np.isfinite(dive.before).all():
        return []
    test = mannwhitneyu(dive.before[truth], dive.before[~truth], alternative="less")
    if test.pvalue >= _CONTRADICTION:
        return []
    share = test.statistic / (truth.sum() * (~truth).sum())
    return [
        f"labels that contradict {dive.known.bundle.label} (an obstacle scores higher than water "
        f"in {share:.0%} of pairs)"
    ]


def _old_scores(dive: _NewDive, learnt: bool, progress: Callable[..., Any], jobs: int) -> F64:
    """Scores of the old dives, held out as the old model did, with or without the new dive."""
    folds = list(dive.old_folds(learnt))
    pairs = zip(folds, dive.known.fold_choices, strict=True)
    found = mapped(_tested, [dive.task(*pair) for pair in pairs], jobs)
    what = f"the old dives {'with' if learnt else 'without'} the new one"
    scores = np.full(len(dive.targets), np.nan)
    for fold, values in zip(folds, progress(found, len(folds), what), strict=True):
        scores[fold.test] = dive.known.bundle.model.obstacle_score(values)
    return scores


def _lost(dive: _NewDive, before: F64, after: F64) -> dict[str, Any]:
    """Figures of each old dive, given the scores without the new dive and with it."""
    told = np.isfinite(before) & np.isfinite(after)
    return {
        str(name): _both(*(one[rows] for one in (dive.obstacle, before, after)))
        for name, rows in dive.patches[told].groupby("mission").groups.items()
    }


def _worse(lost: dict[str, Any]) -> list[str]:
    before, after = (
        {name: one[when]["f1"] for name, one in lost.items()} for when in ("before", "after")
    )
    return falls(before, after)


def _gained(dive: _NewDive, others: Sequence[F64 | None]) -> dict[str, Any] | None:
    """Each frame by a model of the old dives and of the new one's other frames."""
    after = np.full(len(dive.rows), np.nan)
    for place, scores in enumerate(others):
        if scores is not None:
            after[dive.place == place] = scores[dive.place == place]
    rows = [
        {
            "frame": int(dive.frames[place]),
            **dive.both(np.where(dive.place == place, after, np.nan)),
        }
        for place in np.unique(dive.place[np.isfinite(after)])
    ]
    return {**dive.both(after), "frames": rows} if rows else None


def _point(
    dive: _NewDive, count: int, orders: list[list[int]], by_learnt: dict[frozenset[int], F64]
) -> dict[str, Any]:
    """F1 on the frames not learnt from; `before` is the old model's on the same frames."""
    learnt = [by_learnt.get(frozenset(order[:count])) for order in orders]
    both = [None if scores is None else dive.both(scores) for scores in learnt]
    queue, *drawn = [one if one and one["change"] is not None else None for one in both]
    now, was = ([one[when]["f1"] for one in drawn if one] for when in ("after", "before"))
    return {
        "labelled": count,
        "draws": len(now),
        **{"mean": float(np.mean(now)) if now else None, "worst": min(now, default=None)},
        "before": float(np.mean(was)) if was else None,
        **{"queue": queue and queue["after"]["f1"]},
        "queue_before": queue and queue["before"]["f1"],
        "changes": [one and one["change"] for one in drawn],
    }


def _words(told: dict[str, Any]) -> list[str]:
    """What was gained, what was lost, what more labels would bring: a sentence each."""
    name, gained, lost = told["mission"], told["gained"], told["lost"]
    if gained is None:
        words = [
            f"Gained on {name}: cannot be told. It takes labelled frames that are no neighbours or "
            "copies of each other: each is judged by a model that learnt of the others."
        ]
    else:
        was, now = gained["before"], gained["after"]
        f1 = "" if gained["change"] is None else f"F1 {was['f1']:.3f} -> {now['f1']:.3f}, "
        false, missed = (f"{was[key]} -> {now[key]}" for key in _FIGURES[-2:])
        words = [
            f"Gained on {name}: {f1}false patches {false}, missed {missed}, in "
            f"{counted(len(gained['frames']), 'frame')}, each judged by a model that learnt of the "
            f"others.{_whether_better(gained, told['before'])}"
        ]
    changes = {dive: one for dive, one in lost.items() if one["change"] is not None}
    worse = ", ".join(
        f"{dive} F1 {one['before']['f1']:.3f} -> {one['after']['f1']:.3f}"
        for dive, one in changes.items()
        if one["change"] <= -_SMALL
    )
    fell = f"WORSE: {worse}" if worse else f"F1 fell by {_SMALL} in none"
    words.append(f"Elsewhere, {counted(len(changes), 'old dive')}, held out as before: {fell}.")
    words.append(_counts(told))
    words.append(f"More labels: {_more(told['curve'])}.")
    return words


def is_as_good(gained: Mapping[str, Any] | None) -> bool:
    """Tell whether the model before is as good on the new dive, or better."""
    return bool(gained and gained["change"] is not None and gained["change"] < _SMALL)


def _whether_better(gained: Mapping[str, Any], before: str) -> str:
    """Say which model to prefer on the new dive, where F1 tells."""
    if gained["change"] is None:
        return ""
    if is_as_good(gained):
        worse = "WORSE" if gained["change"] <= -_SMALL else "no better"
        return f" That is {worse} than {before}, which may as well stay."
    return f" That is better than {before} there."


def _counts(told: dict[str, Any]) -> str:
    """How much the new dive counts, and why no more."""
    name, times = told["mission"], told["times"]
    counts = f"{name} counts {times:g} times the usual share of a dive of so many patches"
    if not told["by_dive"]:
        counts = "each patch counts the same"
    more = [one for one in told["tried"] if one["times"] > times and one["worse"]]
    if told["worse"]:
        return f"TOO MUCH IS LOST where {counts}: {'; '.join(told['worse'])}."
    if more:
        counts += f"; with {more[-1]['times']:g} times too much is lost: "
        counts += "; ".join(more[-1]["worse"])
    return f"In learning {counts}."


def _more(curve: list[dict[str, Any]]) -> str:
    """What the second half of the labelled frames brought, order by order."""
    last = curve[-1]
    half = [one for one in curve if 2 * one["labelled"] <= last["labelled"]][-1]
    pairs = zip(last["changes"], half["changes"], strict=True)
    steps = [now - was for now, was in pairs if now is not None and was is not None]
    if last["labelled"] < _MIN_LAST or len(steps) < _MIN_STEPS:
        return "too few frames are labelled, or orders drawn, to tell what they would bring"
    mean, better = float(np.mean(steps)), float(np.mean(np.array(steps) > 0))
    seen = (
        f"from {half['labelled']} to {last['labelled']} labelled frames the gain in F1 on the "
        f"others changed by {mean:+.3f} ({min(steps):+.3f} to {max(steps):+.3f} in {len(steps)} "
        "drawn orders)"
    )
    if mean >= _SMALL and better >= _MOST:
        return f"they would probably help, the next as much at most: {seen}"
    if mean < _SMALL and better < _MOST:
        return f"they would hardly help, the curve is flat: {seen}"
    return f"it cannot be told whether they would help: {seen}"
