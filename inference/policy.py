"""Policies: which detectors judge a frame, and what their answers come to.

A detector that raises is taken for one that could not judge. Unknown never becomes clear: a
frame is clear only where at least one detector judged it and none saw an obstacle, and whatever
could not be judged is told in the verdict's health.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from .clock import SYSTEM_CLOCK, Clock
from .detector import Detection, Detector, GridDetector, PatchScorer
from .sources import Frame
from .verdict import (
    CLEAR,
    HEALTHY,
    STATUS_MEAN_THRESHOLD,
    Verdict,
    unknown_verdict,
    verdict_from_mask,
)

POLICIES = ("texture", "disparity", "either", "fallback")


@dataclass(frozen=True)
class Judgement:
    """A verdict, and the decision values behind it where a model gave some.

    Parameters
    ----------
    verdict : Verdict
    decision_values : array of float64, shape (n_patches, n_outputs), or None
    """

    verdict: Verdict
    decision_values: NDArray[np.float64] | None = None


class Policy(Protocol):
    """Something that always has a verdict on a frame."""

    def judge(self, frame: Frame) -> Judgement:
        """Judge one frame; never raises for what a detector does."""


def guarded(detector: Detector, frame: Frame) -> Detection:
    """Ask a detector; whatever it raises is its reason for not judging."""
    try:
        return detector.detect(frame)
    # The one place where any exception is caught: a defect in a detector must cost one verdict,
    # which is then unknown, and never the loop that keeps the vehicle's pilot informed.
    except Exception as error:  # noqa: BLE001
        fault = f"the {detector.method} detector failed: {type(error).__name__}: {error}"
        return Detection(None, detector.method, fault=" ".join(fault.split()))


def _judgement(detection: Detection, health: str) -> Judgement:
    if detection.mask is None:
        return Judgement(unknown_verdict(health), detection.decision_values)
    verdict = verdict_from_mask(
        detection.mask, detection.method, detection.model, detection.distance_m, health
    )
    moving = replace(verdict, closing_m_s=detection.closing_m_s, contact_s=detection.contact_s)
    return Judgement(moving, detection.decision_values)


def _not_clear(judgement: Judgement) -> Judgement:
    """The same where it does not say clear, otherwise unknown."""
    if judgement.verdict.status != CLEAR:
        return judgement
    return replace(judgement, verdict=unknown_verdict(judgement.verdict.health))


class SinglePolicy:
    """One detector alone.

    Parameters
    ----------
    detector : Detector
    note : str
        What is not as it should be throughout, for the health of every verdict.
    """

    def __init__(self, detector: Detector, note: str = "") -> None:
        self.detector = detector
        self.note = note

    def judge(self, frame: Frame) -> Judgement:
        """The detector's answer."""
        detection = guarded(self.detector, frame)
        return _judgement(detection, _health(self.note, detection.fault, detection.note))


def judge_image(scorer: PatchScorer, image: NDArray[np.uint8]) -> Judgement:
    """Judge one picture in memory exactly as policy ``texture`` judges a source's only frame.

    A frame rule that needs several alarms calls a picture that alarms unknown: for the frames of
    a mission use one `GridDetector` for all of them.

    Parameters
    ----------
    scorer : PatchScorer
        Such as a bundle.
    image : array of uint8, shape (height, width) or (height, width, 3)
        As the camera gave it, not resized.

    Returns
    -------
    Judgement
        Unknown, with the reason in its health, where the picture cannot be judged or the scorer
        fails; never raises for either.
    """
    return SinglePolicy(GridDetector(scorer)).judge(Frame(0, 0.0, image, None))


LATE_S = 0.5
"""Seconds. A clear that took longer was said of a frame that is gone."""


class FallbackPolicy:
    """Texture where it can judge and is not late, otherwise disparity.

    A late obstacle is an obstacle all the same; a late clear is not believed.

    Where texture alarmed and only its frame rule keeps it from a status, disparity's *clear* is
    unknown (`Detection.against_clear`).

    Parameters
    ----------
    texture, disparity : Detector
    clock : Clock
        Lateness comes from its `monotonic`.
    late_s : float
    """

    def __init__(
        self,
        texture: Detector,
        disparity: Detector,
        clock: Clock = SYSTEM_CLOCK,
        late_s: float = LATE_S,
    ) -> None:
        self.texture = texture
        self.disparity = disparity
        self.clock = clock
        self.late_s = late_s

    def judge(self, frame: Frame) -> Judgement:
        """The first detector's answer, or the second's where the first has none."""
        first = self._in_time(frame)
        if first.mask is not None:
            return _judgement(first, _health(first.note))
        second = guarded(self.disparity, frame)
        judgement = _judgement(second, _health(_unable(first), _unable(second)))
        return _not_clear(judgement) if first.against_clear else judgement

    def _in_time(self, frame: Frame) -> Detection:
        """Texture's answer, or why there is none in time."""
        start = self.clock.monotonic()
        found = guarded(self.texture, frame)
        took_s = self.clock.monotonic() - start
        if took_s <= self.late_s or found.mask is None:
            return found
        late = f"late: {1000 * took_s:.0f} ms"
        if cv2.mean(found.mask)[0] > STATUS_MEAN_THRESHOLD:
            return replace(found, note="; ".join(filter(None, (found.note, late))))
        return replace(found, mask=None, fault=late)


class EitherPolicy:
    """Both detectors: an obstacle where either sees one.

    The masks of those that judged are joined, and the verdict is that of the joined mask: its
    mean is at least that of each, so it is an obstacle whenever one of them is. Where one could
    not judge, the other's answer stands, and health says so; but a clear one is unknown when the
    first's reason is itself a sign of danger (`Detection.against_clear`).

    Parameters
    ----------
    texture, disparity : Detector
        With masks of one size.
    """

    def __init__(self, texture: Detector, disparity: Detector) -> None:
        self.texture = texture
        self.disparity = disparity

    def judge(self, frame: Frame) -> Judgement:
        """Both detectors' answers joined."""
        first, second = guarded(self.texture, frame), guarded(self.disparity, frame)
        health = _health(*(_unable(found) or found.note for found in (first, second)))
        if first.mask is None or second.mask is None:
            judgement = _judgement(second if first.mask is None else first, health)
            warned = first.against_clear or second.against_clear
            return _not_clear(judgement) if warned else judgement
        joined = replace(
            first,
            mask=np.asarray(cv2.bitwise_or(first.mask, second.mask), np.uint8),
            method=f"{first.method}+{second.method}",
            distance_m=second.distance_m,
            closing_m_s=second.closing_m_s,
            contact_s=second.contact_s,
        )
        return _judgement(joined, health)


def _unable(detection: Detection) -> str:
    return "" if detection.mask is not None else f"{detection.method}: {detection.fault}"


def _health(*faults: str) -> str:
    return "; ".join(fault for fault in faults if fault) or HEALTHY
