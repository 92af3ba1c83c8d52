"""Depths of stereo pairs in their order, by the runtime's own disparity detector."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from tokt.inference.frame import Frame
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.matching import Matches
from tokt.inference.verdict import UNKNOWN, Detection

FAR_PERCENTILE = 95.0


@dataclass(frozen=True)
class DepthRow:
    """Depths and verdict of one pair.

    Parameters
    ----------
    frame, status : int
        Status as in `tokt.inference.verdict.Verdict`.
    distance_m, median_m, far_m : float or None
        Near percentile (the verdict's distance), median and 95th percentile of the matched
        depths; None where nothing was matched, or the pair could not be judged.
    valid_fraction, textured_fraction : float or None
        Parts of the rectified left view that were matched, and that had contrast enough to be;
        None where no matching was done.
    closing_m_s, contact_s : float or None
        As the verdict has them; only with times.
    row_trim_px : float
        Rows by which the right view was moved, in pixels of the frame.
    health : str
        As in the verdict: why the pair could not be judged, or what else is not as it should be.
    """

    frame: int
    status: int
    distance_m: float | None = None
    median_m: float | None = None
    far_m: float | None = None
    valid_fraction: float | None = None
    textured_fraction: float | None = None
    closing_m_s: float | None = None
    contact_s: float | None = None
    row_trim_px: float = 0.0
    health: str = "ok"

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return asdict(self)


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
    detector : DisparityDetector
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
