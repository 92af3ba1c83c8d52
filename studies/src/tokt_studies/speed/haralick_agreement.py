"""Agreement of Haralick's features with mahotas's, within the accuracy of their formulas.

A value must agree to `RELATIVE`. Some of mahotas's own values are not that accurate: a variance
computed as the mean square minus the squared mean loses digits where the picture is bright and
nearly constant, and what is divided by such a variance loses them too. There, and only there, a
floor takes over, which follows from the features themselves: `SUM_ERROR` times the numbers that
were subtracted from each other.

References
----------
Haralick, Shanmugam, Dinstein (1973), IEEE TSMC 3(6): f1 to f13.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64

RELATIVE = 1e-9
SUM_ERROR = 1e-13
"""Relative rounding error of a sum of some hundred float64 terms (each 1.1e-16)."""

COMPARED = (
    f"|difference| <= {RELATIVE:g} |mahotas| + floor, where the floor is mahotas's own rounding: "
    f"{SUM_ERROR:g} of the numbers whose difference a value is"
)

_CORRELATION, _SUM_OF_SQUARES, _SUM_AVERAGE, _SUM_VARIANCE = 2, 3, 5, 6
_ENTROPIES = [7, 8, 10]
_ENTROPY, _INFORMATION_1, _INFORMATION_2 = 8, 11, 12


def floors(directions: F64) -> F64:
    """Absolute error (13,) that the means of mahotas's values (4, 13) may have by its formulas.

    Infinite where a value is undetermined: the correlation of a patch without variance.
    """
    floor = np.zeros_like(directions)
    squares = SUM_ERROR * directions[:, _SUM_AVERAGE] ** 2
    floor[:, [_SUM_OF_SQUARES, _SUM_VARIANCE]] = squares[:, None]
    variance = directions[:, _SUM_OF_SQUARES]
    determined = variance > squares
    floor[:, _CORRELATION] = np.inf
    floor[determined, _CORRELATION] = squares[determined] / variance[determined]
    floor[:, _ENTROPIES] = SUM_ERROR
    # f12 = (HXY - HXY1) / max(HX, HY), and max(HX, HY) is at least half of HXY.
    floor[:, _INFORMATION_1] = 2 * SUM_ERROR
    # f13 = sqrt(1 - exp(-2 d)): near 0 the root turns an error of d into a much larger one.
    bits = SUM_ERROR * np.maximum(1.0, directions[:, _ENTROPY])
    value = np.maximum(directions[:, _INFORMATION_2], np.sqrt(bits))
    floor[:, _INFORMATION_2] = 2 * bits / value
    mean: F64 = floor.mean(axis=0)
    return mean


@dataclass
class HaralickAgreement:
    """Collects comparisons of features with mahotas's."""

    agree: bool = True  # every value so far was near enough, as `COMPARED` says
    worst: float = 0.0  # relative difference of values that mahotas has accurate to `RELATIVE`
    compared: int = 0  # how many those are
    left_out: int = 0  # how many only had to be within the floor

    def add(self, ours: F64, directions: F64) -> None:
        """Compare the features of one patch, shape (13,), with mahotas's, shape (4, 13)."""
        theirs, floor = directions.mean(axis=0), floors(directions)
        difference = np.abs(ours - theirs)
        near = difference <= RELATIVE * np.abs(theirs) + floor
        self.agree = self.agree and bool(near.all()) and bool(np.isfinite(ours).all())
        accurate = floor <= RELATIVE * np.abs(theirs)
        self.compared += int(accurate.sum())
        self.left_out += int((~accurate).sum())
        known = accurate & (theirs != 0)
        relative = difference[known] / np.abs(theirs[known])
        self.worst = max(self.worst, float(relative.max(initial=0.0)))

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form; a difference that is not finite has no figure."""
        return {
            "max_relative_difference": self.worst if math.isfinite(self.worst) else None,
            "values_compared": self.compared,
            "values_within_floor_only": self.left_out,
            "compared": COMPARED,
        }
