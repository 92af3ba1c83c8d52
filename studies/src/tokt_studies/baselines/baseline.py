"""The result of a compared method for a frame, where it looks at pairs or at frames before."""

from typing import NamedTuple

from tokt.features.common.arrays import U8
from tokt.inference.reason import Fault, Reason
from tokt.inference.verdict import Verdict, unknown_verdict

NO_PICTURE = Fault(Reason.MISSING, "a picture of it cannot be read")


class BaselineResult(NamedTuple):
    """A verdict by the method's own rule, and the mask, at the grid's width, that its mean is of.

    The mask is 255 where the method sees an obstacle, and None where it cannot judge.
    """

    verdict: Verdict
    mask: U8 | None


def not_judged(fault: Fault) -> BaselineResult:
    """A frame that a method cannot judge, and why."""
    return BaselineResult(unknown_verdict(fault), None)
