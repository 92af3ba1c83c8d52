"""Reasons: the codes that say why a verdict is unknown or doubtful, and the words with them."""

from __future__ import annotations

from enum import StrEnum


class Reason(StrEnum):
    """Codes of what was not as it should be, as datagrams, logs and counters carry them.

    docs/reference/udp.md has them all.
    """

    OK = "ok"

    # No frame, or one that is too old.
    NO_FRAME = "no_frame"  # none has come since the start
    STALE = "stale"  # none has come for too long, or one that was too old already, or may have been
    LATE = "late"  # judging took so long that a clear is of a frame that is gone
    STALLED = "stalled"  # a frame is being judged for too long
    OVERLOAD = "overload"  # frames come faster than they are judged, and were left out

    # A frame without a picture.
    MISSING = "missing"  # a camera gave none
    UNREADABLE = "unreadable"  # it cannot be decoded
    INCOMPLETE = "incomplete"  # the camera gave only a part of it
    UNPAIRED = "unpaired"  # the other camera has none of the same moment
    CAMERA_LOST = "camera_lost"  # the camera does not answer

    # A picture that cannot be judged.
    DARK = "dark"
    SATURATED = "saturated"
    BLANK = "blank"
    DAMAGED = "damaged"
    FROZEN = "frozen"  # the camera repeats its last picture
    WRONG_SIZE = "wrong_size"  # unlike those the model learnt from, or the calibration is for
    NO_COLOUR = "no_colour"  # the frame is gray, and the model looks at colours

    # A detector that cannot judge.
    DETECTOR_FAILED = "detector_failed"
    NOT_FINITE = "not_finite"
    FRAME_RULE = "frame_rule"  # frames before, which the rule needs, are not known
    STEREO = "stereo"  # the two views of a pair do not fit together, or show too little
    DRIFT = "drift"  # the picture is unlike those that the model learnt from
    NOVEL = "novel"  # a patch is unlike all that the model learnt from
    NO_MODEL = "no_model"


class Fault(str):
    """Why something could not be judged, in words; empty where nothing is wrong."""

    __slots__ = ("reason",)
    reason: Reason

    def __new__(cls, reason: Reason, words: str) -> Fault:
        """Words with a code."""
        made = super().__new__(cls, words)
        made.reason = reason
        return made

    def __getnewargs__(self) -> tuple[Reason, str]:  # type: ignore[override]
        """What pickle and copy make it anew from."""
        return self.reason, str(self)

    def about(self, what: str) -> Fault:
        """The same of one part of a frame, such as ``"left"``."""
        return Fault(self.reason, f"{what}: {self}")


NO_FAULT = Fault(Reason.OK, "")
