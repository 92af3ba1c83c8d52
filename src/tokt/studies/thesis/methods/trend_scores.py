r"""The trend of a mean value held against the change of a measured depth.

::

    mean   . . o o O   trend: growing, steady or shrinking      A ~ 1 / Z**2 for a thing wholly in
           .           (`policy/trend.py`)                     view, so a mean that changes by s a
    depth  o o o .     slope of the same last seconds,          second goes with a depth that
           ---------   by Theil and Sen                         changes by -s / 2
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import spearmanr, theilslopes

from tokt.inference.policy.temporal_cues import (
    GROWING,
    HORIZON_S,
    MIN_SLOTS,
    MIN_SPAN_S,
    SHRINKING,
    STEADY,
    STEADY_PER_S,
    TRENDS,
    Trend,
    TrendEstimator,
)
from tokt.inference.verdict import STATUS_MEAN_THRESHOLD

NOT_SAID = "not said"
MOVING = (GROWING, SHRINKING)
_MIN_RANKED = 5


@dataclass(frozen=True)
class FrameMean:
    """One method's mean value of one frame.

    Parameters
    ----------
    frame : int
    mean : float or None
        Of its 0/255 mask, 0..255; None where it did not judge.
    whole : bool
        Whether what it saw lies wholly in the picture.
    """

    frame: int
    mean: float | None
    whole: bool


@dataclass(frozen=True)
class TrendAgainstDepth:
    """A frame's trend beside the change of its depth.

    Parameters
    ----------
    frame : int
    mean : float or None
    said : Trend
        As a datagram would have it.
    unchecked_contact_s : float or None
        The time to contact that would be said if the picture's edge did not matter.
    depth_m : float
        nan where it is not known.
    true : str or None
        What the mean would do by the depth alone: one of `TRENDS`; None where it is not known.
    true_contact_s : float or None
        Depth over its closing speed, where it falls.
    """

    frame: int
    mean: float | None
    said: Trend
    unchecked_contact_s: float | None
    depth_m: float
    true: str | None
    true_contact_s: float | None


@dataclass(frozen=True)
class Depth:
    """Trend and time to contact of the last seconds of depth.

    Parameters
    ----------
    trend : str
        One of `TRENDS`.
    contact_s : float or None
    """

    trend: str
    contact_s: float | None


def trend_against_depth(
    seen: Sequence[FrameMean], depth_m: dict[int, float], seconds_a_frame: float
) -> list[TrendAgainstDepth]:
    """Follow a method's means, and hold each trend against the depth.

    Parameters
    ----------
    seen : sequence of FrameMean
        In the order of their frames.
    depth_m : dict of int to float
        By frame; nan where nothing was measured.
    seconds_a_frame : float
        From one frame number to the next.
    """
    sent, unchecked = TrendEstimator(), TrendEstimator()
    times = np.array([one.frame * seconds_a_frame for one in seen])
    depths = np.array([depth_m.get(one.frame, math.nan) for one in seen])
    found = []
    for place, one in enumerate(seen):
        said = sent.add(float(times[place]), one.mean, one.whole)
        known = depth_trend(times[: place + 1], depths[: place + 1])
        found.append(
            TrendAgainstDepth(
                one.frame,
                one.mean,
                said,
                unchecked.add(float(times[place]), one.mean, True).contact_s,
                float(depths[place]),
                None if known is None else known.trend,
                None if known is None else known.contact_s,
            )
        )
    return found


def depth_trend(times_s: NDArray[np.float64], depths_m: NDArray[np.float64]) -> Depth | None:
    """How the depth changes at the last of some times, over the seconds that a trend looks at.

    Parameters
    ----------
    times_s, depths_m : array of float, shape (n,)
        In order; nan where no depth was measured.

    Returns
    -------
    Depth or None
        None where the last depth is not known, or too few before it are.
    """
    if not len(depths_m) or not np.isfinite(depths_m[-1]):
        return None
    used = np.isfinite(depths_m) & (times_s > times_s[-1] - HORIZON_S)
    t, z = times_s[used] - times_s[-1], depths_m[used]
    if len(z) < MIN_SLOTS or -t[0] < MIN_SPAN_S:
        return None
    line = theilslopes(z, t)
    slope, now = float(line.slope), float(line.intercept)
    of_the_mean = -2 * slope / now
    if of_the_mean > STEADY_PER_S:
        return Depth(GROWING, -now / slope)
    if of_the_mean < -STEADY_PER_S:
        return Depth(SHRINKING, None)
    return Depth(STEADY, None)


def confusion(held: Sequence[TrendAgainstDepth]) -> pd.DataFrame:
    """Counts of frames whose depth's change is known: rows by depth, columns as said.

    Only frames in which something is seen: without, no trend is asked for.
    """
    asked = [one for one in held if _asked(one)]
    counts = pd.DataFrame(0, index=list(TRENDS), columns=[*TRENDS, NOT_SAID])
    for one in asked:
        counts.loc[one.true, one.said.trend or NOT_SAID] += 1
    return counts


def _asked(one: TrendAgainstDepth) -> bool:
    seen = one.mean is not None and one.mean > STATUS_MEAN_THRESHOLD
    return seen and one.true is not None


@dataclass(frozen=True)
class TrendScore:
    """Scores of a trend against depth.

    Parameters
    ----------
    asked : int
        Frames in which something is seen and the depth's change is known.
    said : int
        Of these, frames with a trend.
    same : int
        Of the frames in which depth changes and the trend is growing or shrinking, those of the
        same sign.
    opposite : int
        Of those, of the opposite sign.
    missed_approach : int
        Frames in which the thing comes nearer and *steady* or *shrinking* is said.
    rank_correlation : float or None
        Spearman's, of mean and depth: -1 would be a relative distance.
    ratios : tuple of float
        Time to contact from expansion over that of the depth, where both are known.
    unchecked_ratios : tuple of float
        The same if the picture's edge did not matter.
    """

    asked: int
    said: int
    same: int
    opposite: int
    missed_approach: int
    rank_correlation: float | None
    ratios: tuple[float, ...]
    unchecked_ratios: tuple[float, ...]

    @property
    def agreement(self) -> float | None:
        """Share of the frames with a sign in both whose signs are the same."""
        both = self.same + self.opposite
        return self.same / both if both else None


def score(held: Sequence[TrendAgainstDepth]) -> TrendScore:
    """Sum the comparison up."""
    asked = [one for one in held if _asked(one)]
    signed = [one for one in asked if one.true in MOVING and one.said.trend in MOVING]
    same = sum(one.true == one.said.trend for one in signed)
    missed = [one for one in asked if one.true == GROWING and one.said.trend in (STEADY, SHRINKING)]
    return TrendScore(
        len(asked),
        sum(one.said.trend is not None for one in asked),
        same,
        len(signed) - same,
        len(missed),
        _ranks(held),
        _ratios([(one.said.contact_s, one.true_contact_s) for one in held]),
        _ratios([(one.unchecked_contact_s, one.true_contact_s) for one in held]),
    )


def _ranks(held: Sequence[TrendAgainstDepth]) -> float | None:
    pairs = [
        (one.mean, one.depth_m)
        for one in held
        if one.mean is not None and one.mean > STATUS_MEAN_THRESHOLD and np.isfinite(one.depth_m)
    ]
    if len(pairs) < _MIN_RANKED or len({mean for mean, _ in pairs}) < 2:
        return None
    means, depths = np.array(pairs).T
    return float(spearmanr(means, depths).statistic)


def _ratios(contacts: Sequence[tuple[float | None, float | None]]) -> tuple[float, ...]:
    return tuple(said / true for said, true in contacts if said is not None and true)
