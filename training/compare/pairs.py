"""Pairwise differences between models: intervals, p-values and verdicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy.stats import norm

from tokt.features.common.arrays import F64
from tokt.training.datasets.split import DIVES

from .bootstrap import (
    CONFIDENCE,
    ComparisonMetric,
    average_precision,
    drawn_blocks,
    interval,
    ranked_counts,
    spread_of_ap,
    summed,
)
from .predictions import ComparedModels

BETTER, WORSE, CANNOT_TELL = "better", "worse", "cannot tell"
_POWER = 0.8
_UNDEFINED = (
    "Cannot tell which model is better: there is no F1. No patch here is labelled as an obstacle, "
    "or a model knows one side alone. False statuses are all that can be compared."
)
EXACT_BLOCKS = 12
_DRAWN = 9999
_ROUNDING = 1e-12


@dataclass(frozen=True)
class _Resampled:
    """A figure, its counts in each block for each model, and its value in each resample."""

    name: str
    title: str
    figure: Callable[[F64], F64]
    counts: dict[str, F64]
    spread: dict[str, F64]

    def value(self, label: str) -> float:
        return float(self.figure(self.counts[label].sum(axis=0)[None])[0])

    def compared(self, first: str, second: str, blocks: int) -> dict[str, Any]:
        return {
            "difference": self.value(first) - self.value(second),
            "interval": interval(self.spread[first] - self.spread[second], blocks),
        }


def main_measure(compared: ComparedModels) -> ComparisonMetric:
    """Macro-F1 where all models tell the same several classes apart, else the obstacles' F1."""
    classes = {predictions.classes for predictions in compared.models}
    names = classes.pop()
    several = not classes and (len(names) > 2 or not compared.two_sided)
    return ComparisonMetric(len(names)) if several else ComparisonMetric()


def _resampled(
    compared: ComparedModels, measure: ComparisonMetric | None, draws: F64
) -> _Resampled:
    """By a measure, or for None by average precision."""
    (names, block), truth, counts, spread = compared.units, compared.truth, {}, {}
    for item in compared.models:
        if measure is None:
            part = ranked_counts(truth, item.score, block, len(names))
            spread[item.label] = spread_of_ap(draws, part)
        else:
            said = item.targets, item.predicted, truth, item.score > 0
            part = measure.counts(*said, block, len(names))
            spread[item.label] = measure.figure(summed(draws, part))
        counts[item.label] = part
    if measure is None:
        return _Resampled("average_precision", "AP", average_precision, counts, spread)
    return _Resampled(measure.name, measure.title, measure.figure, counts, spread)


def _detectable(spread: F64, questions: int) -> float | None:
    """The difference that would be called one in 4 of 5 repeats, from its standard error."""
    found = spread[np.isfinite(spread)]
    if len(found) < 2 or not found.std():
        return None
    alpha = (1 - CONFIDENCE) / questions
    return float((norm.ppf(1 - alpha / 2) + norm.ppf(_POWER)) * found.std())


def _verdict(p: float, difference: float, interval: dict[str, float] | None) -> str:
    if interval is None or p > 1 - CONFIDENCE or interval["low"] <= 0 <= interval["high"]:
        return CANNOT_TELL
    return BETTER if difference > 0 else WORSE


def _said(
    pair: dict[str, Any], title: str, test: PermutationTest, questions: int, unit: str
) -> str:
    """The verdict on a pair, for people."""
    units = _in_short(unit)
    first, second = pair["models"]
    bounds, p = pair["interval"], pair["p_adjusted"]
    if not test.differing:
        return (
            f"{first} and {second} are right and wrong equally often in every {units[:-1]}: "
            "nothing tells them apart."
        )
    by = f"{title} {pair['values'][0]:.3f} against {pair['values'][1]:.3f}, a difference of "
    by += f"{pair['difference']:+.3f}"
    if bounds is not None:
        by += f" (95 % interval {bounds['low']:+.3f} to {bounds['high']:+.3f}, p = {p:.2g}"
        by += ", adjusted)" if questions > 1 else ")"
    if pair["verdict"] != CANNOT_TELL:
        return f"{first} is {pair['verdict']} than {second}: {by}."
    seen = ""
    if test.least_p * questions > 1 - CONFIDENCE:
        seen = (
            f" They differ in {test.differing} {units} only: too few for any difference to be told "
            "from luck."
        )
    elif pair["detectable"] is not None:
        seen = (
            f" With these {units} a difference of about {pair['detectable']:.3f} would be found "
            "in 4 of 5 repeats."
        )
    return f"Cannot tell whether {first} or {second} is better: {by}.{seen}"


def _in_short(unit: str) -> str:
    return DIVES if unit == DIVES else "blocks"


def compare_pairs(compared: ComparedModels) -> dict[str, Any]:
    """Intervals for each model and a verdict on each pair.

    The verdict is *better* or *worse* only where the block permutation test, adjusted for the
    number of pairs, gives p <= 0.05 and the bootstrap interval of the difference leaves 0 out.

    Returns measure, blocks, intervals {label: {measure: {low, high}}}, pairs (none where there is
    no F1 to compare by; models, values, difference, interval, p, p_adjusted, detectable,
    average_precision, verdict, words), and method in words.
    """
    names, _ = compared.units
    draws = drawn_blocks(len(names))
    sides = bool(compared.truth.any() and compared.two_sided)
    measure = _resampled(compared, main_measure(compared), draws)
    ap = _resampled(compared, None, draws) if sides else None
    shown = [measure] if ap is None else [measure, ap]
    if measure.name != "f1" and compared.two_sided:
        shown.append(_resampled(compared, ComparisonMetric(), draws))
    labels = [predictions.label for predictions in compared.models]
    defined = measure.name != "f1" or sides
    couples = list(combinations(labels, 2))
    return {
        "measure": measure.name,
        "measure_title": measure.title,
        "blocks": len(names),
        "intervals": {
            label: {item.name: interval(item.spread[label], len(names)) for item in shown}
            for label in labels
        },
        "pairs": _pairs(measure, ap, couples, len(names), compared.unit) if defined else [],
        "method": _method(len(names), compared.unit, len(couples)) if defined else _UNDEFINED,
    }


def _pairs(
    measure: _Resampled,
    ap: _Resampled | None,
    couples: list[tuple[str, str]],
    blocks: int,
    unit: str,
) -> list[dict[str, Any]]:
    tests = [
        permutation_test(measure.counts[a], measure.counts[b], measure.figure) for a, b in couples
    ]
    adjusted = holm([test.p for test in tests])
    pairs = []
    for (a, b), test, p in zip(couples, tests, adjusted, strict=True):
        told = measure.compared(a, b, blocks)
        pair: dict[str, Any] = {
            "models": [a, b],
            "values": [measure.value(a), measure.value(b)],
            **told,
            "p": test.p,
            "p_adjusted": p,
            "swaps": test.swaps,
            "exact": test.exact,
            "differing_blocks": test.differing,
            "detectable": _detectable(measure.spread[a] - measure.spread[b], len(couples)),
            "average_precision": ap and ap.compared(a, b, blocks),
            "verdict": _verdict(p, **told),
        }
        pair["words"] = _said(pair, measure.title, test, len(couples), unit)
        pairs.append(pair)
    return pairs


def _method(blocks: int, unit: str, questions: int) -> str:
    several = (
        f" {questions} pairs were asked about at once: their p-values are adjusted (Holm), their "
        "intervals are not."
        if questions > 1
        else ""
    )
    units, least = _in_short(unit), 2 / 2**blocks
    few = (
        f" So few dives cannot show a difference: swapping gives no p below {least:.2g}, and "
        "intervals over them are rough. Read the figures of each dive."
        if unit == DIVES and least * questions > 1 - CONFIDENCE
        else ""
    )
    return (
        f"{blocks} {unit} count as independent.{few} Intervals: 95 %, bootstrap over whole "
        f"{units}, the same {units} for all models. p: the two models' verdicts swapped "
        f"{units[:-1]} by {units[:-1]}, all ways where there are few {units}. A model is called "
        "better or worse only where p is at most 0.05 and the interval of the difference leaves 0 "
        f"out.{several}"
    )


@dataclass(frozen=True)
class PermutationTest:
    """Result of a block permutation test."""

    p: float  # share of swaps with a difference at least as large, in either direction
    swaps: int  # how many were looked at
    exact: bool  # whether these were all there are
    differing: int  # blocks in which the two models' counts differ: swapping others does nothing
    least_p: float  # the smallest p that so many blocks can give, however large the difference


def permutation_test(
    first: F64, second: F64, figure: Callable[[F64], F64], seed: int = 0
) -> PermutationTest:
    """Paired permutation test of a figure that follows from counts summed over blocks.

    If the models are alike, it makes no difference which of them judged a block: the difference
    seen is then one of many that swapping their verdicts gives. Whole blocks are swapped, as
    patches of a block are not independent; where there are too many swaps to look at all of them,
    some are drawn. `first` and `second` are each model's counts, (blocks, ...); `figure` makes n
    figures of counts (n, ...). Good (2005), Permutation, Parametric and Bootstrap Tests of
    Hypotheses, chapter 3.
    """
    change = (second - first).reshape(len(first), -1)
    differing = np.flatnonzero(change.any(axis=1))
    if not len(differing):
        return PermutationTest(1.0, 1, True, 0, 1.0)
    exact = len(differing) <= EXACT_BLOCKS
    if exact:
        swaps = (np.arange(2 ** len(differing))[:, None] >> np.arange(len(differing))) & 1
    else:
        swaps = np.random.default_rng(seed).integers(0, 2, (_DRAWN, len(differing)))
    shape = (len(swaps), *first.shape[1:])
    moved = (swaps.astype(np.float64) @ change[differing]).reshape(shape)
    differences = figure(first.sum(axis=0) + moved) - figure(second.sum(axis=0) - moved)
    seen = figure(first.sum(axis=0)[None]) - figure(second.sum(axis=0)[None])
    as_large = int((np.abs(differences) >= abs(float(seen[0])) - _ROUNDING).sum())
    # Of drawn swaps the arrangement seen is one more; of all swaps it and its mirror are there.
    more, least = (0, 2) if exact else (1, 1)
    every = len(swaps) + more
    p = (as_large + more) / every
    return PermutationTest(p, len(swaps), exact, len(differing), least / every)


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjust p-values for how many questions were asked at once.

    Holm (1979), A Simple Sequentially Rejective Multiple Test Procedure, Scandinavian Journal of
    Statistics 6.
    """
    order = np.argsort(p_values, kind="stable")
    steps = np.arange(len(order), 0, -1) * np.asarray(p_values)[order]
    adjusted: list[float] = np.maximum.accumulate(steps).clip(max=1.0)[np.argsort(order)].tolist()
    return adjusted
