r"""The trend of a mean value held against the change of a measured depth.

::

    mean   . . o o O   trend: growing, steady or shrinking      A ~ 1 / Z**2 for a thing wholly in
           .           (`policy/trend.py`)                     view, so a mean that changes by s a
    depth  o o o .     slope of the same last seconds,          second goes with a depth that
           ---------   by Theil and Sen                         changes by -s / 2
"""

from __future__ import annotations

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
    TrendEstimator,
)
from tokt.inference.verdict import STATUS_MEAN_THRESHOLD

NOT_SAID = "not said"
MOVING = (GROWING, SHRINKING)
_MIN_RANKED = 5


def trend_against_depth(
    seen: pd.DataFrame, depth_m: dict[int, float], seconds_a_frame: float
) -> pd.DataFrame:
    """Follow a method's means, and hold each trend against the depth.

    Parameters
    ----------
    seen : DataFrame
        Index ``frame``, in order. ``mean``: of the method's 0/255 mask, 0..255, nan where it did
        not judge; ``whole``: whether what it saw lies wholly in the picture.
    depth_m : dict of int to float
        By frame; nan where nothing was measured.
    seconds_a_frame : float
        From one frame number to the next.

    Returns
    -------
    DataFrame
        Index ``frame``. ``mean``, ``depth_m``; ``trend``, ``confidence``, ``contact_s`` as a
        datagram would have them; ``unchecked_contact_s``, which would be said if the picture's
        edge did not matter; ``by_depth`` and ``contact_s_by_depth``, what they would be by the
        depth alone. What is not known or not said is missing.
    """
    sent, unchecked = TrendEstimator(), TrendEstimator()
    times = seen.index.to_numpy() * seconds_a_frame
    depths = np.array([depth_m.get(number, np.nan) for number in seen.index])
    rows = []
    for place, (t_s, value, whole) in enumerate(zip(times, seen["mean"], seen.whole, strict=True)):
        mean = float(value) if np.isfinite(value) else None
        ignored = unchecked.add(float(t_s), mean, True).contact_s
        true = depth_trend(times[: place + 1], depths[: place + 1]) or (None, None)
        rows.append((*sent.add(float(t_s), mean, bool(whole)), ignored, *true))
    numbers = ("confidence", "contact_s", "unchecked_contact_s", "contact_s_by_depth")
    columns = ["trend", *numbers[:3], "by_depth", numbers[3]]
    held = pd.DataFrame(rows, seen.index, columns, dtype=object)
    return held.astype(dict.fromkeys(numbers, float)).assign(mean=seen["mean"], depth_m=depths)


def depth_trend(
    times_s: NDArray[np.float64], depths_m: NDArray[np.float64]
) -> tuple[str, float | None] | None:
    """How the depth changes at the last of some times, over the seconds that a trend looks at.

    Parameters
    ----------
    times_s, depths_m : array of float, shape (n,)
        In order; nan where no depth was measured.

    Returns
    -------
    trend : str
        What the mean would do: one of `TRENDS`.
    contact_s : float or None
        Depth over its closing speed, where it falls.

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
        return GROWING, -now / slope
    return (SHRINKING if of_the_mean < -STEADY_PER_S else STEADY), None


def _asked(held: pd.DataFrame) -> pd.DataFrame:
    """Frames in which something is seen (without, no trend is asked for) and the truth is known."""
    return held[(held["mean"] > STATUS_MEAN_THRESHOLD) & held.by_depth.notna()]


def confusion(held: pd.DataFrame) -> pd.DataFrame:
    """Counts of the frames that are asked about: rows by depth, columns as said."""
    counts = pd.DataFrame(0, index=list(TRENDS), columns=[*TRENDS, NOT_SAID])
    asked = _asked(held)
    for true, said in zip(asked.by_depth, asked.trend, strict=True):
        counts.loc[true, said or NOT_SAID] += 1
    return counts


def score(held: pd.DataFrame) -> dict[str, float | int | None]:
    """Sum the comparison up.

    Returns
    -------
    asked, said : int
        Frames in which something is seen and the depth's change is known; those with a trend.
    same_sign, opposite_sign : int
        Of those in which depth changes and the trend is growing or shrinking.
    sign_agreement : float or None
        Share of the frames with a sign in both whose signs are the same.
    missed_approach : int
        Frames in which the thing comes nearer and *steady* or *shrinking* is said.
    rank_correlation : float or None
        Spearman's, of mean and depth: -1 would be a relative distance.
    """
    asked = _asked(held)
    signed = asked[asked.by_depth.isin(MOVING) & asked.trend.isin(MOVING)]
    same = int((signed.by_depth == signed.trend).sum())
    missed = (asked.by_depth == GROWING) & asked.trend.isin((STEADY, SHRINKING))
    return {
        "asked": len(asked),
        "said": int(asked.trend.notna().sum()),
        "same_sign": same,
        "opposite_sign": len(signed) - same,
        "sign_agreement": same / len(signed) if len(signed) else None,
        "missed_approach": int(missed.sum()),
        "rank_correlation": _ranks(held),
    }


def _ranks(held: pd.DataFrame) -> float | None:
    both = held[(held["mean"] > STATUS_MEAN_THRESHOLD) & np.isfinite(held.depth_m)]
    if len(both) < _MIN_RANKED or both["mean"].nunique() < 2:
        return None
    return float(spearmanr(both["mean"], both.depth_m).statistic)


def contact_ratios(held: pd.DataFrame, unchecked: bool = False) -> pd.Series:
    """Time to contact from expansion over that of the depth, where both are known.

    Parameters
    ----------
    held : DataFrame
        As `trend_against_depth` gives it.
    unchecked : bool
        As if the picture's edge did not matter.
    """
    said = held.unchecked_contact_s if unchecked else held.contact_s
    return (said / held.contact_s_by_depth).dropna()
