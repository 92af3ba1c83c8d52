"""Temporal cues: the trend of a policy's verdicts over time, and the anchor's errors.

::

    frame ──> policy ──> verdict ──> trend of its mean      (its method, its model: else anew)
                                └──> errors of the anchor   (where one was asked for)
"""

from __future__ import annotations

from dataclasses import replace

from tokt.inference.frame import Frame
from tokt.inference.texture.detector import ReloadableTextureDetector
from tokt.inference.verdict import UNKNOWN, Verdict

from .anchor import Anchor, AnchorErrors
from .policy import Judgement, Policy
from .trend import Trend, TrendEstimator

EDGE = 0.04
"""What comes nearer to the picture's edge than this share of its length may be cut off by it: more
than the rows and columns that a grid leaves over, less than one of its patches."""


def wholly_in_view(verdict: Verdict, blind_m: float = 0.0) -> bool:
    """Whether what was seen lies wholly in the picture.

    Parameters
    ----------
    verdict : Verdict
    blind_m : float
        Of a stereo pair: the part of the picture's width at the left edge that the right camera
        does not see, times the distance in metres. It holds where the verdict has a distance.
    """
    if verdict.box is None or verdict.mask_size is None:
        return False
    x0, y0, box_width, box_height = verdict.box
    height, width = verdict.mask_size
    blind = 0.0
    if verdict.distance_m is not None:
        blind = blind_m / max(verdict.distance_m, blind_m) if blind_m > 0 else 0.0
    return (
        x0 >= (EDGE + blind) * width
        and x0 + box_width <= (1 - EDGE) * width
        and y0 >= EDGE * height
        and y0 + box_height <= (1 - EDGE) * height
    )


class TemporalCues:
    """Another policy's verdicts, with their trend over time and the anchor's errors.

    A trend is that of one method and one model: where another one judges, it begins anew. It
    needs frames with times (`Frame.timed`).

    Parameters
    ----------
    policy : Policy
    texture : ReloadableTextureDetector or None
        Where the policy's model may be exchanged.
    anchor : Anchor or None
        What is to be held, if anything is.
    blind_m : float
        As in `wholly_in_view`.
    """

    def __init__(
        self,
        policy: Policy,
        texture: ReloadableTextureDetector | None = None,
        anchor: Anchor | None = None,
        blind_m: float = 0.0,
    ) -> None:
        self.policy = policy
        self.anchor = anchor
        self._texture = texture
        self._blind_m = blind_m
        self._watch = TrendEstimator()
        self._detector = None if texture is None else texture.detector
        self._method = ""

    def judge(self, frame: Frame) -> Judgement:
        """The policy's answer, with what follows from it."""
        judgement = self.policy.judge(frame)
        verdict = judgement.verdict
        trend = self._trend(frame, verdict)
        errors = AnchorErrors() if self.anchor is None else self.anchor.errors(verdict)
        if trend.trend is None and errors.x is None:
            return judgement
        with_cues = replace(
            verdict,
            trend=trend.trend,
            trend_confidence=trend.confidence,
            expansion_contact_s=trend.contact_s,
            anchor_x=errors.x,
            anchor_y=errors.y,
            anchor_size=errors.size,
        )
        return replace(judgement, verdict=with_cues)

    def _trend(self, frame: Frame, verdict: Verdict) -> Trend:
        if not frame.timed:
            return Trend()
        detector = None if self._texture is None else self._texture.detector
        judged = verdict.status != UNKNOWN
        if detector is not self._detector or (judged and verdict.method != self._method):
            self._watch = TrendEstimator()
            self._detector = detector
        if not judged:
            return self._watch.add(frame.t, None)
        self._method = verdict.method
        return self._watch.add(frame.t, verdict.mean, wholly_in_view(verdict, self._blind_m))
