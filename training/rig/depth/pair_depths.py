"""Depths of stereo pairs in their order, by the runtime's own detector, and their summary."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import attrgetter
from typing import Any

import numpy as np

from tokt.features.frames.mission import format_frames
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.matching import Matches
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN, Detection

FAR_PERCENTILE = 95.0
IN_A_ROW = 3
"""Frames with an obstacle, one after the other, that make a detection."""
MEASURES = ("median_m", "distance_m")


@dataclass(frozen=True)
class DepthRow:
    """Depths and verdict of one pair."""

    frame: int
    status: int  # as in `tokt.inference.verdict.Verdict`
    # Near percentile (the verdict's distance), median and 95th percentile of the matched depths;
    # None where nothing was matched, or the pair could not be judged.
    distance_m: float | None = None
    median_m: float | None = None
    far_m: float | None = None
    # Parts of the rectified left view that were matched, and that had contrast enough to be; None
    # where no matching was done.
    valid_fraction: float | None = None
    textured_fraction: float | None = None
    closing_m_s: float | None = None  # as the verdict has it; only with times, as the next
    contact_s: float | None = None
    row_trim_px: float = 0.0  # rows by which the right view was moved, in pixels of the frame
    health: str = "ok"  # as in the verdict


class _KeepsMatches:
    """The detector as a policy asks it, keeping the matches of the pair it was asked about."""

    def __init__(self, detector: DisparityDetector) -> None:
        self._detector = detector
        self.method = detector.method
        self.matches: Matches | None = None

    def detect(self, frame: Frame) -> Detection:
        self.matches = None
        detection, self.matches = self._detector.observe(frame)
        return detection


def measure_depths(
    detector: DisparityDetector, frames: Iterable[Frame], rate: float | None = None
) -> Iterator[DepthRow]:
    """Judge frames as ``tokt run --policy disparity`` does; a row for each, whatever it holds.

    Parameters
    ----------
    frames : iterable of Frame
        In order.
    rate : float, optional
        Frame numbers per second: what the moments of capture are worked out from. Without it
        there is no closing speed.
    """
    remembering = _KeepsMatches(detector)
    policy = SinglePolicy(remembering)
    for frame in frames:
        timed = frame if rate is None else replace(frame, t=frame.number / rate, timed=True)
        trim = detector.row_shift_px
        verdict = policy.judge(timed).verdict
        yield DepthRow(
            frame.number,
            verdict.status,
            verdict.distance_m,
            **_fractions(remembering.matches),
            **_depths(detector, remembering.matches, verdict.status),
            closing_m_s=verdict.closing_m_s,
            contact_s=verdict.contact_s,
            row_trim_px=trim,
            health=verdict.health,
        )


def _fractions(matches: Matches | None) -> dict[str, Any]:
    if matches is None:
        return {}
    return {
        "valid_fraction": float(matches.valid.mean()),
        "textured_fraction": float(matches.textured.mean()),
    }


def _depths(detector: DisparityDetector, matches: Matches | None, status: int) -> dict[str, Any]:
    """Of a pair that could be judged: what two wrong frames match by chance is no depth."""
    if matches is None or status == UNKNOWN or not matches.valid.any():
        return {}
    depths = detector.depth_m(matches)[matches.valid]
    return {
        "median_m": float(np.median(depths)),
        "far_m": float(np.percentile(depths, FAR_PERCENTILE)),
    }


Place = Callable[[int], int]
"""Gives where a frame, by its number, comes in the dive."""


def summary(rows: Sequence[DepthRow], place: Place = int) -> dict[str, Any]:
    """Figures over all frames, in their order.

    They are frames, obstacle, clear, unknown (counts); first_detection (the first of three frames
    in a row with an obstacle, or None); detected (first and last frame of the detected span, or
    None); gaps (frames within that span without an obstacle's depth: count and list); nearest (the
    frame of the least distance among all with an obstacle); of each measure of depth its
    `steadiness` over that span; clear_valid_fraction (mean and max over clear frames, and those of
    them with any match).
    """
    span = detected_span(rows, place)
    seen = [row for row in rows if row.status == OBSTACLE and row.median_m is not None]
    inside = _inside(seen, span, place) if span else []
    gaps = gaps_of(rows, span, place)
    return {
        "frames": len(rows),
        **{
            name: sum(row.status == status for row in rows)
            for name, status in (("obstacle", OBSTACLE), ("clear", CLEAR), ("unknown", UNKNOWN))
        },
        "first_detection": span[0] if span else None,
        "detected": list(span) if span else None,
        "gaps": {"count": len(gaps), "frames": format_frames(gaps)},
        "nearest": nearest(seen),
        **{measure: steadiness(inside, measure, place) for measure in MEASURES},
        "clear_valid_fraction": _clear_fractions(rows),
    }


def _inside(rows: Sequence[DepthRow], span: Sequence[int], place: Place) -> list[DepthRow]:
    first, last = map(place, span)
    return [row for row in rows if first <= place(row.frame) <= last]


def gaps_of(rows: Sequence[DepthRow], span: Sequence[int] | None, place: Place = int) -> list[int]:
    """Frames of the span that show no obstacle's depth: of a few stray matches there is none."""
    if span is None:
        return []
    inside = _inside(rows, span, place)
    return [row.frame for row in inside if row.status != OBSTACLE or row.median_m is None]


def nearest(rows: Sequence[DepthRow]) -> dict[str, Any] | None:
    """Frame, distance_m and median_m of the row with the least distance; None without any."""
    known = (row for row in rows if row.distance_m is not None)
    row = min(known, key=attrgetter("distance_m"), default=None)
    if row is None:
        return None
    return {"frame": row.frame, "distance_m": row.distance_m, "median_m": row.median_m}


def detected_span(rows: Sequence[DepthRow], place: Place = int) -> tuple[int, int] | None:
    """First and last frame of all runs of at least `IN_A_ROW` frames with an obstacle."""
    runs = runs_of([row.frame for row in rows if row.status == OBSTACLE], place)
    long = [run for run in runs if place(run[1]) - place(run[0]) >= IN_A_ROW - 1]
    return (long[0][0], long[-1][1]) if long else None


def runs_of(frames: Sequence[int], place: Place) -> list[tuple[int, int]]:
    """First and last of each stretch of successive frames."""
    runs: list[tuple[int, int]] = []
    for frame in frames:
        if runs and place(frame) == place(runs[-1][1]) + 1:
            runs[-1] = (runs[-1][0], frame)
        else:
            runs.append((frame, frame))
    return runs


def steadiness(rows: Sequence[DepthRow], measure: str, place: Place = int) -> dict[str, Any] | None:
    """How steadily a depth of `MEASURES` falls to the nearest frame and rises after it.

    Of the rows with an obstacle in the detected span; None without any depth. Found are
    nearest_frame, nearest_m; monotone; not_falling and not_rising (frames that break it, before and
    after the nearest); jitter_m: median, max and at_frame of how far a frame's depth is from the
    mean of the one before and the one after; second_difference_m: the same of twice that, the
    change from one step of depth to the next, which a vehicle that brakes has as well.
    """
    known = [
        (row.frame, float(value)) for row in rows if (value := getattr(row, measure)) is not None
    ]
    if not known:
        return None
    turn, nearest_m = min(known, key=lambda item: item[1])
    at = place(turn)
    not_falling = [b[0] for a, b in pairwise(known) if place(b[0]) <= at and b[1] >= a[1]]
    not_rising = [b[0] for a, b in pairwise(known) if place(a[0]) >= at and b[1] <= a[1]]
    return {
        "nearest_frame": turn,
        "nearest_m": nearest_m,
        "monotone": not not_falling and not not_rising,
        "not_falling": format_frames(not_falling),
        "not_rising": format_frames(not_rising),
        "jitter_m": _bends(known, place, 0.5),
        "second_difference_m": _bends(known, place, 1.0),
    }


def _bends(
    known: Sequence[tuple[int, float]], place: Place, factor: float
) -> dict[str, Any] | None:
    """Second differences over three successive frames, times `factor`."""
    seconds = [
        (factor * abs(a[1] - 2 * b[1] + c[1]), b[0])
        for a, b, c in zip(known, known[1:], known[2:], strict=False)
        if place(c[0]) - place(b[0]) == place(b[0]) - place(a[0]) == 1
    ]
    if not seconds:
        return None
    worst, at = max(seconds)
    return {
        "median": float(np.median([value for value, _ in seconds])),
        "max": worst,
        "at_frame": at,
        "count": len(seconds),
    }


def _clear_fractions(rows: Sequence[DepthRow]) -> dict[str, Any] | None:
    """Of frames without an obstacle: a match too small for a status is one all the same."""
    clear = [
        (row.valid_fraction, row.frame)
        for row in rows
        if row.status == CLEAR and row.valid_fraction is not None
    ]
    if not clear:
        return None
    return {
        "mean": float(np.mean([fraction for fraction, _ in clear])),
        "max": max(clear)[0],
        "frames_above_0": format_frames(frame for fraction, frame in clear if fraction),
    }
