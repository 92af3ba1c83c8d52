"""Scores of curves: first detections, false statuses, patch scores, correlations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tokt.inference.verdict import OBSTACLE, UNKNOWN
from tokt.studies.thesis.context import StudyContext
from tokt.studies.thesis.exhibit import ClaimAgreement
from tokt.studies.thesis.methods.curves import Curves
from tokt.training.evaluation.metrics import obstacle_metrics

IN_A_ROW = 3
MIN_FRAMES = 8
"""Of fewer frames that both curves have no correlation is told."""
NEARLY_ALWAYS, GOES_WITH = 0.95, 0.7
"""Rank correlations of mean value and nearness from which the one tells the other, and from which
it does so with exceptions."""


@dataclass(frozen=True)
class MethodScore:
    """Scores of one method's curve.

    Parameters
    ----------
    first_detection : int or None
        The first of `IN_A_ROW` judged frames in a row with status 1; None without one, and for
        a method that judged a sample of the frames only.
    ocean_frames, false_status : int or None
        Judged frames of which every patch is labelled as clear, and those with status 1; None
        without labels.
    obstacle_frames, detected : int or None
        Judged frames with a patch labelled as an obstacle, and those with status 1.
    unknown : int
        Frames that the method could not judge.
    f1 : float or None
        Of patches on the grid, all sure ones of the labelled frames; None where the method does
        not judge patches.
    """

    first_detection: int | None
    ocean_frames: int | None
    false_status: int | None
    obstacle_frames: int | None
    detected: int | None
    unknown: int
    f1: float | None


def first_in_a_row(status: pd.Series, wanted: int = IN_A_ROW) -> int | None:
    """The first of so many frames in a row, as they are in the series, with status 1."""
    said = (status == OBSTACLE).to_numpy()
    for at in range(len(said) - wanted + 1):
        if said[at : at + wanted].all():
            return int(status.index[at])
    return None


def score_methods(context: StudyContext) -> dict[str, MethodScore]:
    """Score every curve."""
    curves, labelled = context.curves, context.labels is not None
    truth = {number: context.truth(number) for number in context.obstacle_patches}
    with_obstacle = [number for number, count in context.obstacle_patches.items() if count]
    found = {}
    for name, method in curves.methods.items():
        status = curves.status[name]
        if method.sampled:
            status = status[curves.mean[name].notna()]
        ocean, false = _counted(status, context.ocean_frames) if labelled else (None, None)
        obstacle, detected = _counted(status, with_obstacle) if labelled else (None, None)
        found[name] = MethodScore(
            first_detection=None if method.sampled else first_in_a_row(status),
            ocean_frames=ocean,
            false_status=false,
            obstacle_frames=obstacle,
            detected=detected,
            unknown=int((status == UNKNOWN).sum()),
            f1=patch_f1(curves.patches[name], truth) if name in curves.patches else None,
        )
    return found


def _counted(status: pd.Series, frames: Iterable[int]) -> tuple[int, int]:
    """How many of some frames were judged, and how many of these have status 1."""
    there = status[status.index.isin(list(frames))]
    return int((there != UNKNOWN).sum()), int((there == OBSTACLE).sum())


def patch_f1(
    said: Mapping[int, NDArray[np.bool_]], truth: Mapping[int, NDArray[np.int8]]
) -> float | None:
    """F1 of the patches that are known, over the frames that both have; None without any."""
    both = sorted(set(said) & set(truth))
    if not both:
        return None
    known = np.concatenate([truth[number] for number in both])
    white = np.concatenate([said[number] for number in both])
    sure = known >= 0
    metrics: Mapping[str, Any] = obstacle_metrics(known[sure] == 1, white[sure] - 0.5)
    return None if metrics["f1"] is None else float(metrics["f1"])


def scores_table(curves: Curves, scores: Mapping[str, MethodScore]) -> pd.DataFrame:
    """One row a method."""
    return pd.DataFrame(
        [
            {
                "method": curves.methods[name].title,
                "whose": curves.methods[name].kind,
                "frames": int(curves.mean[name].notna().sum()),
                "first detection": one.first_detection,
                "false status": one.false_status,
                "of ocean frames": one.ocean_frames,
                "detected": one.detected,
                "of obstacle frames": one.obstacle_frames,
                "unknown": one.unknown,
                "largest mean": float(curves.mean[name].max()),
                "patch F1": one.f1,
            }
            for name, one in scores.items()
        ]
    ).astype({name: "Int64" for name in ("first detection", "false status", "of ocean frames",
                                         "detected", "of obstacle frames")})  # fmt: skip


def agreement_with_distance(ranks: Iterable[float]) -> ClaimAgreement:
    """Whether the mean value is a relative distance: judged by the worst of some correlations.

    Parameters
    ----------
    ranks : iterable of float
        With 1 / distance, so 1 where it is; one and more.
    """
    worst = min(ranks)
    if worst >= NEARLY_ALWAYS:
        return ClaimAgreement.YES
    return ClaimAgreement.PARTLY if worst >= GOES_WITH else ClaimAgreement.NO


def correlations(curves: Curves, names: Sequence[str]) -> pd.DataFrame:
    """Spearman's rank correlation of each pair of curves, on the frames that both judged."""
    return curves.mean[list(names)].corr("spearman", min_periods=MIN_FRAMES)


def with_nearness(curves: Curves, name: str) -> float | None:
    """Spearman's rank correlation of a curve with 1 / distance, where stereo measured one.

    None where there are too few such frames, or the curve is flat there.
    """
    near = 1.0 / curves.distance_m
    both = curves.mean[name].notna() & near.notna()
    if int(both.sum()) < MIN_FRAMES or curves.mean[name][both].nunique() < 2:
        return None
    return float(curves.mean[name][both].corr(near[both], "spearman"))
