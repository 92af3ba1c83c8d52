"""Policies: one verdict from the answers of one or two detectors.

A detector that raises is taken for one that could not judge. Unknown never becomes clear: a
frame is clear only where at least one detector judged it and none saw an obstacle, and whatever
could not be judged is told in the verdict's health.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np

from tokt.features.common.arrays import F64, I64, U8
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.inference.clock import SYSTEM_STOPWATCH, Stopwatch
from tokt.inference.frame import Frame
from tokt.inference.reason import Fault, Reason
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import (
    CLEAR,
    STATUS_MEAN_THRESHOLD,
    ClassPatches,
    Detection,
    Detector,
    Verdict,
    class_boxes,
    health_of,
    unknown_verdict,
    verdict_from_mask,
)

if TYPE_CHECKING:
    from tokt.models.bundle.bundle import Bundle

    from .object_model import Box

POLICIES = ("texture", "disparity", "either", "fallback")


@dataclass(frozen=True)
class Judgement:
    """A verdict, and what is behind it: fields without a word are as in `Detection`."""

    verdict: Verdict
    decision_values: F64 | None = None
    features: F64 | None = None  # the texture model's, also where the verdict is from elsewhere
    counts: I64 | None = None
    texture_s: float | None = None  # seconds that texture took, where the verdict hangs on them
    boundary: float | None = None
    mask: U8 | None = None
    grid: Grid | None = None
    class_patches: ClassPatches | None = None
    held: Box | None = None  # around the named object


class Policy(Protocol):
    """Something that always has a verdict on a frame."""

    def judge(self, frame: Frame) -> Judgement:
        """Judge one frame; never raises for what a detector does."""


def guarded(detector: Detector, frame: Frame, unasked: int = 0) -> Detection:
    """Ask a detector; whatever it raises is its reason for not judging.

    It was not asked about `unasked` frames before this one, which are missing to it.
    """
    try:
        # Covered once for all who look at the frame, and so measured once.
        covered = frame.covered
        if unasked:
            covered = replace(covered, missed=covered.missed + unasked)
        return detector.detect(covered)
    # The one place where any exception is caught: a defect in a detector must cost one verdict,
    # which is then unknown, and never the loop that keeps the vehicle's pilot informed.
    except Exception as error:  # noqa: BLE001
        words = f"the {detector.method} detector failed: {type(error).__name__}: {error}"
        fault = Fault(Reason.DETECTOR_FAILED, " ".join(words.split()))
        return Detection(None, detector.method, fault=fault)


def _judgement(detection: Detection, health: str, reason: Reason) -> Judgement:
    behind = {name: getattr(detection, name) for name in _BEHIND}
    sight = None if detection.sight is None else detection.sight.to_fields()
    if detection.mask is None:
        unknown = unknown_verdict(Fault(reason, health))
        return Judgement(replace(unknown, sight=sight), **behind)
    verdict = verdict_from_mask(
        detection.mask, detection.method, detection.model, detection.distance_m, health
    )
    classes = None
    if detection.class_patches is not None and detection.grid is not None:
        classes = class_boxes(detection.class_patches, detection.grid, *detection.mask.shape)
    whole = replace(
        verdict,
        closing_m_s=detection.closing_m_s,
        contact_s=detection.contact_s,
        reason=reason,
        classes=classes,
        sight=sight,
    )
    return Judgement(whole, **behind)


_BEHIND = ("decision_values", "features", "counts", "boundary", "mask", "grid", "class_patches")
"""What a judgement has of a detection besides its verdict."""


def _not_clear(judgement: Judgement) -> Judgement:
    """The same where it does not say clear, otherwise unknown."""
    if judgement.verdict.status != CLEAR:
        return judgement
    verdict = judgement.verdict
    unknown = unknown_verdict(Fault(verdict.reason, verdict.health))
    return replace(judgement, verdict=replace(unknown, sight=verdict.sight))


@dataclass(eq=False)
class SinglePolicy:
    """One detector alone: its answer on a frame is the verdict."""

    detector: Detector
    note: str = ""  # what is not as it should be throughout, for the health of every verdict

    def judge(self, frame: Frame) -> Judgement:
        """The detector's answer."""
        detection = guarded(self.detector, frame)
        health = health_of(detection.fault, detection.note, self.note)
        return _judgement(detection, health, _reason(detection))


def judge_image(scorer: Bundle, image: U8) -> Judgement:
    """Judge one picture in memory exactly as policy ``texture`` judges a source's only frame.

    A frame rule of several frames calls a picture that alarms unknown. For the frames of a
    mission use one `TextureDetector` for all of them.

    Parameters
    ----------
    scorer : Bundle
    image : array of uint8, shape (height, width) or (height, width, 3)
        As the camera gave it, not resized. Where it cannot be judged, or the scorer fails, the
        verdict is unknown, with the reason in its health; neither raises.

    Raises
    ------
    ToktError
        If something else than a model and an array is given, such as the name of a file.
    """
    if isinstance(scorer, str | Path) or not isinstance(image, np.ndarray):
        raise ToktError(
            "judge_image takes a model of tokt.load_model, then a picture as cv2.imread reads it "
            f"(None where it could not), not {type(scorer).__name__} and {type(image).__name__}"
        )
    return SinglePolicy(TextureDetector(scorer)).judge(Frame(0, 0.0, image, None))


MAX_TEXTURE_S = 0.5
"""Seconds that texture may take for a clear that is believed: after more it is of a frame that is
gone, and disparity is asked. Of texture alone, and no option; a frame's age is ``--stale``'s."""


@dataclass(eq=False)
class FallbackPolicy:
    """Texture where it can judge and is not late, otherwise disparity.

    A late obstacle is an obstacle all the same; a late clear is not believed.

    Where texture alarmed and only its frame rule keeps it from a status, disparity's *clear* is
    unknown (`Detection.vetoes_clear`).
    """

    texture: Detector
    disparity: Detector
    stopwatch: Stopwatch = SYSTEM_STOPWATCH

    def __post_init__(self) -> None:
        self._unasked = 0

    def judge(self, frame: Frame) -> Judgement:
        """The first detector's answer, or the second's where the first has none."""
        found, took_s = self.stopwatch.took(lambda: guarded(self.texture, frame))
        first = self._in_time(found, took_s)
        if first.mask is not None:
            self._unasked += 1 + frame.missed
            judgement = _judgement(first, health_of(first.fault, first.note), first.fault.reason)
            return replace(judgement, texture_s=took_s)
        # Frames that it is not asked about are missing to it: what it remembers is older by them.
        second = guarded(self.disparity, frame, self._unasked)
        self._unasked = 0
        health = health_of(_unable(first), _unable(second))
        second = replace(second, sight=second.sight or first.sight)
        judgement = _judgement(second, health, _reason(first, second))
        judgement = replace(
            judgement, features=found.features, texture_s=took_s, boundary=found.boundary
        )
        return _not_clear(judgement) if first.vetoes_clear else judgement

    def _in_time(self, found: Detection, took_s: float) -> Detection:
        """Texture's answer, or why there is none in time."""
        if took_s <= MAX_TEXTURE_S or found.mask is None:
            return found
        late = Fault(Reason.LATE, f"late: {1000 * took_s:.0f} ms")
        if cv2.mean(found.mask)[0] > STATUS_MEAN_THRESHOLD:
            return replace(found, fault=late)
        return replace(found, mask=None, fault=late)


@dataclass(eq=False)
class EitherPolicy:
    """Both detectors, with masks of one size: an obstacle where either sees one.

    The masks of those that judged are joined, and the verdict is that of the joined mask: its mean
    is at least that of each, so it is an obstacle whenever one of them is. Where one could not
    judge, the other's answer stands, and health says so; but a clear one is unknown when the
    first's reason is itself a sign of danger (`Detection.vetoes_clear`).
    """

    texture: Detector
    disparity: Detector

    def judge(self, frame: Frame) -> Judgement:
        """Both detectors' answers joined."""
        first, second = guarded(self.texture, frame), guarded(self.disparity, frame)
        health = health_of(*(_told(found) for found in (first, second)))
        if first.mask is None or second.mask is None:
            able = second if first.mask is None else first
            able = replace(able, sight=first.sight or second.sight)
            judgement = _judgement(able, health, _reason(first, second))
            judgement = replace(judgement, features=first.features, boundary=first.boundary)
            warned = first.vetoes_clear or second.vetoes_clear
            return _not_clear(judgement) if warned else judgement
        health = health_of(health, _disagreement(first.mask, second.mask, second.method))
        joined = replace(
            first,
            mask=np.asarray(cv2.bitwise_or(first.mask, second.mask), np.uint8),
            method=f"{first.method}+{second.method}",
            distance_m=second.distance_m,
            closing_m_s=second.closing_m_s,
            contact_s=second.contact_s,
        )
        return _judgement(joined, health, _reason(first, second))


def _disagreement(texture: U8, stereo: U8, method: str) -> str:
    """Say that one of two detectors alone sees an obstacle; an empty string where both agree."""
    seen = [float(cv2.mean(mask)[0]) > STATUS_MEAN_THRESHOLD for mask in (texture, stereo)]
    if seen == [True, False]:
        return f"texture that {method} does not see: far off, flat, or on the port"
    if seen == [False, True]:
        return f"{method} sees what the model takes for water"
    return ""


def _told(detection: Detection) -> str:
    return _unable(detection) or "; ".join(filter(None, (detection.fault, detection.note)))


def _unable(detection: Detection) -> str:
    return "" if detection.mask is not None else f"{detection.method}: {detection.fault}"


def _reason(*found: Detection) -> Reason:
    """Of the first with a fault; that there is no model is said if nothing else is."""
    reasons = [detection.fault.reason for detection in found if detection.fault]
    return min(reasons, key=lambda reason: reason is Reason.NO_MODEL, default=Reason.OK)
