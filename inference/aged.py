"""What a verdict is worth once its frame has become old."""

from __future__ import annotations

from dataclasses import replace

from .reason import Fault, Reason
from .verdict import CLEAR, OBSTACLE, Verdict, health_of, unknown_verdict


def aged(verdict: Verdict, age_s: float, judging_s: float, stale_s: float) -> Verdict:
    """The same verdict while its frame is young; a clear of an old one is unknown.

    An old obstacle stays one, and says so.

    Parameters
    ----------
    verdict : Verdict
    age_s : float
        Seconds since the frame arrived.
    judging_s : float
        Seconds of them that it was being judged.
    stale_s : float
        Age in seconds that is old.
    """
    if age_s <= stale_s or verdict.status not in (CLEAR, OBSTACLE):
        return verdict
    came_old = age_s - judging_s > stale_s
    reason, word = (Reason.STALE, "stale") if came_old else (Reason.LATE, "late")
    health = health_of(f"{word}: the frame is {1000 * age_s:.0f} ms old", verdict.health)
    if verdict.status == CLEAR:
        return unknown_verdict(Fault(reason, health))
    return replace(verdict, health=health, reason=reason)


def overloaded(verdict: Verdict, left_out: int) -> Verdict:
    """The same verdict, which says how many frames before it there was no time for."""
    if left_out == 0:
        return verdict
    frames = "1 frame" if left_out == 1 else f"{left_out} frames"
    health = health_of(verdict.health, f"overload: no time for {frames} before this one")
    reason = Reason.OVERLOAD if verdict.reason is Reason.OK else verdict.reason
    return replace(verdict, health=health, reason=reason)
