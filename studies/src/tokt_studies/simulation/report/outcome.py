"""Outcomes of flights: collisions, clearance, detours, false avoidance; tables over many."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from tokt_studies.simulation.loop.autopilot import Mode
from tokt_studies.simulation.loop.track import Track
from tokt_studies.simulation.loop.vehicle import HULL_RADIUS_M

CONFIDENCE = 0.95
FRESH_S = 2.5
"""An avoidance is of what was in view at most this long before: the frame rule and the way of the
datagram take up to a second and a half."""
GROUND_IN_VIEW = ("floor",)
"""Scenes in which something solid is always in view: no avoidance can be told to be false."""


@dataclass(frozen=True)
class FlightOutcome:
    """The outcome of one flight.

    An avoidance is false where it began while nothing solid had been in view for `FRESH_S`: what
    else may have been avoided while something solid was in view, is not told apart. A status is
    false while nothing solid is in view: with a frame rule also just after it left the view.
    """

    scene: str
    method: str
    seed: int
    collided: bool  # the hull, a sphere of `HULL_RADIUS_M`, touched something solid
    reached: bool  # it came to the goal
    clearance_m: float  # least, from the hull; 0 or less where it collided, infinite in open water
    path_m: float
    detour: float  # the path over the straight line between its ends, less 1; NaN if not arrived
    time_s: float
    avoidances: int
    false_avoidances: int
    false_retreats: int  # it began to go back, and nothing solid had been in view
    false_statuses: int
    frames: int
    unknown_frames: int
    # Before an object; NaN and 0 without one.
    off_m: float  # the farthest from the wanted place
    held: float  # share of the frames in which the object is held
    held_another: int  # frames in which what is held is not that object

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form; what is not finite is None."""
        return {
            key: None if isinstance(value, float) and not math.isfinite(value) else value
            for key, value in asdict(self).items()
        }


def outcome_of(track: Track) -> FlightOutcome:
    """Judge a flight by its track."""
    going_back = track.mode == Mode.BACK_OFF
    retreats_s = track.t_s[1:][going_back[1:] & ~going_back[:-1]]
    path_m = float(np.linalg.norm(np.diff(track.position, axis=0), axis=1).sum())
    straight_m = float(np.linalg.norm(track.position[-1] - track.position[0]))
    off_m = float(np.linalg.norm(track.position - track.station, axis=1).max())
    arrived = track.reached and not track.collided
    station = not math.isnan(off_m)
    return FlightOutcome(
        scene=track.scene,
        method=track.method,
        seed=track.seed,
        collided=track.collided,
        reached=arrived,
        clearance_m=track.least_m - HULL_RADIUS_M,
        path_m=path_m,
        detour=path_m / straight_m - 1.0 if arrived and not station else math.nan,
        time_s=float(track.t_s[-1]),
        avoidances=len(track.avoidances_s),
        false_avoidances=sum(_is_false(track, t_s) for t_s in track.avoidances_s),
        false_retreats=sum(_is_false(track, t_s) for t_s in retreats_s),
        false_statuses=int(((track.frame_status == 1) & ~track.frame_in_view).sum()),
        frames=len(track.frame_status),
        unknown_frames=int((track.frame_status == -1).sum()),
        off_m=off_m,
        held=float((track.frame_anchor > 0).mean())
        if station and len(track.frame_anchor)
        else math.nan,
        held_another=int((track.frame_anchor == 2).sum()),
    )


def _is_false(track: Track, t_s: float) -> bool:
    """Whether nothing solid was in any frame of the time before."""
    recent = (track.frame_t_s <= t_s) & (track.frame_t_s >= t_s - FRESH_S)
    return not track.frame_in_view[recent].any()


def bounds(happened: int, runs: int) -> tuple[float, float]:
    """Bounds at 95 % confidence of the rate of what happened in so many runs.

    Exact (Clopper and Pearson 1934), two-sided.
    """
    found = stats.binomtest(happened, runs).proportion_ci(CONFIDENCE, method="exact")
    return float(found.low), float(found.high)


def table(outcomes: Sequence[FlightOutcome]) -> pd.DataFrame:
    """A row for each scene and method, in the order in which they first occur.

    Of what happened in so many runs ``_low`` and ``_high`` are the bounds of its rate at 95 %
    confidence. Detours and times are of the runs that arrived; what no run has is NaN.
    """
    frame = pd.DataFrame([asdict(outcome) for outcome in outcomes])
    frame["false_avoidance"] = frame["false_avoidances"] > 0
    frame["went_back"] = frame["false_retreats"] > 0
    groups = frame.groupby(["scene", "method"], sort=False)
    return pd.DataFrame(
        [{"scene": scene, "method": method, **_row(part)} for (scene, method), part in groups]
    )


def _row(part: pd.DataFrame) -> dict[str, float | int]:
    row: dict[str, float | int] = {"runs": len(part)}
    for name in ("collided", "reached", "false_avoidance", "went_back"):
        happened = int(part[name].sum())
        row[name] = happened
        row[f"{name}_low"], row[f"{name}_high"] = bounds(happened, len(part))
    clearance = part["clearance_m"][np.isfinite(part["clearance_m"])]
    arrived = part[part["reached"]]
    return row | {
        "clearance_min_m": float(clearance.min()),
        "clearance_median_m": float(clearance.median()),
        "detour_median": float(arrived["detour"].median()),
        "detour_most": float(arrived["detour"].max()),
        "time_median_s": float(arrived["time_s"].median()),
        "off_most_m": float(part["off_m"].max()),
        "held_median": float(part["held"].median()),
        "held_another_frames": int(part["held_another"].sum()),
        "false_status_frames": int(part["false_statuses"].sum()),
        "frames": int(part["frames"].sum()),
    }
