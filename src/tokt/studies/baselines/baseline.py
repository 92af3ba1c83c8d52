"""The interface of every method that tokt is compared with, and its result for one frame."""

from dataclasses import dataclass
from typing import Protocol

from tokt.features.common.arrays import U8
from tokt.inference.reason import Fault
from tokt.inference.verdict import Verdict, unknown_verdict


@dataclass(frozen=True)
class BaselineResult:
    """A method's result for one frame.

    Parameters
    ----------
    verdict : Verdict
        Its status is decided by the method's own rule; `Verdict.mean` is of `mask`, 0..255.
    mask : array of uint8, shape (height, width), or None
        255 where the method sees an obstacle, at the grid's width; None where it cannot judge.
    """

    verdict: Verdict
    mask: U8 | None


class Baseline(Protocol):
    """A method that judges the frames of one run, in their order."""

    @property
    def name(self) -> str:
        """Of files and columns, such as ``slic_lbp_10_5``."""

    @property
    def title(self) -> str:
        """For people."""

    @property
    def source(self) -> str:
        """Who published it, and when."""

    def judge(self, left: U8, right: U8 | None, t_s: float) -> BaselineResult:
        """Judge one frame.

        Parameters
        ----------
        left, right : array of uint8, shape (height, width) or (height, width, 3)
            As decoded, BGR or gray. A method of one camera does not look at `right`.
        t_s : float
            Time of the frame in seconds, from any start.

        Raises
        ------
        ToktError
            If the method needs a right frame and there is none.
        """


def not_judged(fault: Fault) -> BaselineResult:
    """A frame that a method cannot judge, and why."""
    return BaselineResult(unknown_verdict(fault), None)
