"""A verdict in distances: clear up to where, an obstacle how far away and in which sectors.

A receiver that thinks in distances cannot be told "obstacle" or "clear" without one. Where the
verdict measured none, one has to be assumed, and the same figure serves both: an obstacle without
a distance is said to be that near, and a clear without a range to reach no farther. Smaller is
more careful either way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tokt.inference.detector import DISPARITY, PUSHBROOM
from tokt.inference.stereo.lens import SECTORS, Lens, sectors_touching, sectors_within
from tokt.inference.stereo.matching import FARTHEST_M
from tokt.inference.stereo.pushbroom import DISTANCES_M
from tokt.inference.verdict import CLEAR, OBSTACLE, Verdict

UNKNOWN_CM = 65535
"""OBSTACLE_DISTANCE's word for unknown, or not used (UINT16_MAX)."""
NEAREST_CM = 1
"""Least distance that is said: 0 and what is below a sensor's least distance, ArduPilot ignores."""

MEASURED_TO_M = {DISPARITY: FARTHEST_M, PUSHBROOM: max(DISTANCES_M)}
"""Metres up to which a detector's clear holds. Texture has no such distance."""


@dataclass(frozen=True)
class Ranges:
    """A judged frame in distances, all in whole centimetres.

    Parameters
    ----------
    nearest : int
        To the obstacle; `most` + 1 where there is none.
    most : int
        Up to where there would have been said to be one.
    sectors : tuple of int, length `SECTORS`
        For each sector `nearest`, or `UNKNOWN_CM` where nothing is said of it.
    """

    nearest: int
    most: int
    sectors: tuple[int, ...]


NOTHING_KNOWN = (UNKNOWN_CM,) * SECTORS


def ranges_of(verdict: Verdict, lens: Lens, assumed_m: float) -> Ranges | None:
    """A verdict in distances, or None of one that is unknown.

    A clear is one of the sectors that are wholly in view. An obstacle is in every sector that its
    box touches, or in all of the view where the verdict does not say in which picture its box is;
    of the rest of that view nothing is said: an obstacle's verdict judged the frame, not each of
    its columns.

    Parameters
    ----------
    verdict : Verdict
    lens : Lens
        Of the camera whose picture the box is in.
    assumed_m : float
        Metres that are said where nothing was measured.
    """
    if verdict.status == CLEAR:
        most = _cm(_reach_m(verdict.method, assumed_m))
        return Ranges(most + 1, most, _spread(most + 1, sectors_within(*lens.edges_deg)))
    if verdict.status == OBSTACLE:
        nearest, most = _obstacle_cm(verdict, assumed_m)
        return Ranges(nearest, most, _spread(nearest, sectors_touching(*_span_deg(verdict, lens))))
    return None


def _reach_m(method: str, otherwise_m: float) -> float:
    """Metres up to which a method, which may be two joined by ``+``, measures."""
    measured = [MEASURED_TO_M[part] for part in method.split("+") if part in MEASURED_TO_M]
    return max(measured, default=otherwise_m)


def _obstacle_cm(verdict: Verdict, assumed_m: float) -> tuple[int, int]:
    """The obstacle's distance, and the range it is in.

    It is kept inside the range, since an obstacle at its very end is taken for none by PX4, and
    one beyond it by ArduPilot too.
    """
    distance_m = verdict.distance_m
    if distance_m is None or not math.isfinite(distance_m):
        return _cm(assumed_m) - 1, _cm(assumed_m)
    most = _cm(_reach_m(verdict.method, max(MEASURED_TO_M.values())))
    return min(max(_cm(distance_m), NEAREST_CM), most - 1), most


def _span_deg(verdict: Verdict, lens: Lens) -> tuple[float, float]:
    """The obstacle's left and right edge as directions."""
    if verdict.box is None or verdict.mask_size is None:
        return lens.edges_deg
    x0, _, box_width, _ = verdict.box
    width = verdict.mask_size[1]
    return lens.angle_deg(x0 / width), lens.angle_deg((x0 + box_width) / width)


def _cm(metres: float) -> int:
    """Whole centimetres, rounded towards the nearer."""
    return math.floor(100 * min(max(metres, 0.0), 600.0) + 1e-6)


def _spread(distance_cm: int, sectors: list[int]) -> tuple[int, ...]:
    said = list(NOTHING_KNOWN)
    for index in sectors:
        said[index] = distance_cm
    return tuple(said)
