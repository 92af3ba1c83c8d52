"""Figures of merit for patches and frames, from decision values and true labels."""

from collections.abc import Mapping
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from sklearn.metrics import (
    average_precision_score,
    confusion_matrix,
    precision_recall_fscore_support,
)

from tokt.features.common.arrays import F64, I64, Bools

BINS = 5
_MARGINS = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, None)
MIN_PATCHES = 30
BOUND_CONFIDENCE = 0.95


def _ratio(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def obstacle_metrics(truth: Bools, score: F64) -> dict[str, Any]:
    """Precision, recall, f1 and average_precision of "this patch is an obstacle"; the counts, too.

    Of n patches whether they are one, and a score above 0 where the model says so. It is infinite
    from a model whose classes are all obstacles, or all clear: of such a model these figures say
    nothing, and are None, as they are where they are undefined. The counts are true_positive,
    false_positive, false_negative, true_negative.
    """
    said = score > 0
    hit, false = int((said & truth).sum()), int((said & ~truth).sum())
    missed, quiet = int((~said & truth).sum()), int((~said & ~truth).sum())
    denominator = 2 * hit + false + missed
    two_sided = bool(np.isfinite(score).all())
    some = two_sided and bool(truth.any())
    return {
        "precision": hit / (hit + false) if two_sided and hit + false else None,
        "recall": hit / (hit + missed) if some else None,
        "f1": 2 * hit / denominator if some else None,
        "average_precision": _ratio(average_precision_score(truth, score)) if some else None,
        "true_positive": hit,
        "false_positive": false,
        "false_negative": missed,
        "true_negative": quiet,
    }


def metrics_by(
    names: NDArray[np.object_],
    truth: Bools,
    score: F64,
    targets: I64,
    predicted: I64,
    classes: tuple[str, ...],
) -> dict[str, Any]:
    """The figures of each dive, or site, by the name that each patch has.

    Without an obstacle, or without water, it has neither F1 nor average precision.
    """
    found = {}
    for name in np.unique(names):
        at = names == name
        found[str(name)] = {
            "n": int(at.sum()),
            "obstacles": int(truth[at].sum()),
            **obstacle_metrics(truth[at], score[at]),
            **class_metrics(targets[at], predicted[at], classes),
            **({"f1": None, "average_precision": None} if truth[at].all() else {}),
        }
    return found


def over_dives(dives: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Means over the dives that have a figure, each dive counting the same, and the worst F1.

    That is f1, average_precision, macro_f1 (None of no dive), worst_f1 and worst (its dive), n
    (dives) and without_f1 (dives without an obstacle or without water, which are left out).
    """
    means: dict[str, Any] = {}
    for name in ("f1", "average_precision", "macro_f1"):
        values = [one[name] for one in dives.values() if one[name] is not None]
        means[name] = float(np.mean(values)) if values else None
    known = {name: one["f1"] for name, one in dives.items() if one["f1"] is not None}
    worst = min(known, key=lambda name: known[name], default=None)
    return {
        **means,
        "worst_f1": None if worst is None else known[worst],
        "worst": worst,
        "n": len(dives),
        "without_f1": len(dives) - len(known),
    }


def class_metrics(truth: I64, predicted: I64, classes: tuple[str, ...]) -> dict[str, Any]:
    """Per-class precision, recall and F1, macro-F1 over the classes present, and confusion.

    That is per_class {name: {precision, recall, f1, n}}, macro_f1, and confusion {classes, counts}
    with a row for each true class and a column for each predicted one.
    """
    indices = np.arange(len(classes))
    precision, recall, f1, support = precision_recall_fscore_support(
        truth, predicted, labels=indices, zero_division=np.nan
    )
    present = support > 0
    per_class = {
        name: {"precision": _ratio(p), "recall": _ratio(r), "f1": _ratio(f), "n": int(n)}
        for name, p, r, f, n in zip(classes, precision, recall, f1, support, strict=True)
    }
    return {
        "per_class": per_class,
        "macro_f1": float(np.nan_to_num(f1[present]).mean()) if present.any() else None,
        "confusion": {
            "classes": list(classes),
            "counts": confusion_matrix(truth, predicted, labels=indices).tolist(),
        },
    }


def reliability(truth: Bools, score: F64) -> list[dict[str, Any]]:
    """How often patches are obstacles, by decision value, which is no probability.

    Of patches as for `obstacle_metrics` low, high (the least and the largest value), n and obstacle
    (the labelled share) of up to `BINS` bins of as many patches each on either side of 0, by rising
    value; none where a model's values are not finite.
    """
    if not np.isfinite(score).all():
        return []
    order = np.argsort(score, kind="stable")
    below = int((score <= 0).sum())
    sides = [side for side in (order[:below], order[below:]) if len(side)]
    bins = [part for side in sides for part in np.array_split(side, min(BINS, len(side)))]
    return [
        {
            "low": float(score[part[0]]),
            "high": float(score[part[-1]]),
            "n": len(part),
            "obstacle": float(truth[part].mean()),
        }
        for part in bins
    ]


def right_by_margin(truth: Bools, score: F64) -> list[dict[str, Any]]:
    """How often patches are what a model calls them, by how far from its threshold they are.

    Of patches that were not learnt from, as for `obstacle_metrics`: obstacle (what they are
    called), low and high (of the margin; None: no end), n, right (the share) and at_least (its
    lower bound, were patches independent); none of fewer than `MIN_PATCHES` patches.
    """
    found = []
    for obstacle, (low, high) in product((False, True), pairwise(_MARGINS)):
        called = np.abs(score) >= low
        called &= (score > 0) == obstacle
        called &= np.abs(score) < (np.inf if high is None else high)
        n, wrong = int(called.sum()), int((truth[called] != obstacle).sum())
        if n >= MIN_PATCHES:
            shares = {"right": 1 - wrong / n, "at_least": 1 - upper_bound(wrong, n)}
            found.append({"obstacle": obstacle, "low": low, "high": high, "n": n, **shares})
    return found


def upper_bound(exceeding: int, n: int) -> float:
    """The largest rate that `exceeding` of `n` independent trials do not contradict.

    Exact (Clopper and Pearson 1934), one-sided, at `BOUND_CONFIDENCE`.
    """
    if exceeding >= n:
        return 1.0
    return float(stats.beta.ppf(BOUND_CONFIDENCE, exceeding + 1, n - exceeding))
