r"""An anchor: the errors of an object from where it is to be held in the picture.

Three errors for a control system that keeps the vehicle before an object, such as one that is
looked at from all sides (L. S. Brusletto, NTNU 2016, section 7.2). They say where the object is,
not where to steer: `Verdict.x` and `Verdict.y` point away from it.

::

    -1        0        1  x          x, y   the object's centre in the picture: 0, 0 in its middle,
     +--------+--------+ -1                 1 at its right and its lower edge
     |        |        |             size   ln of the wanted distance over the distance, were the
     |        |  ###   |                    object wholly in view: half the ln of the share of the
     |--------+--###---|  0                 picture that it covers over the share that is wanted
     |        |  ###   |
     |        |        |             x > 0     it is right: turn, or sway, to the right
     +--------+--------+  1          y > 0     it is below: go down
                         y           size > 0  it is too large, too near: go back
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from tokt.features.common.errors import ToktError
from tokt.inference.verdict import OBSTACLE, Verdict

MIN_SIZE, MAX_SIZE = 0.01, 0.9
"""Wanted shares of the picture that can be held: from one patch of a 10x10 grid, smaller than which
nothing is seen, up to a picture that is full."""


class AnchorErrors(NamedTuple):
    """Errors of the object from where it is wanted; None where none is seen.

    Parameters
    ----------
    x, y : float or None
        Its centre from the picture's, -1..1: right and down are positive; three decimals.
    size : float or None
        ln(sqrt(share / wanted share)), which is ln(wanted distance / distance) of an object wholly
        in view: positive too near, negative too far; three decimals.
    """

    x: float | None = None
    y: float | None = None
    size: float | None = None


@dataclass(frozen=True)
class Anchor:
    """The object's wanted size in the picture's centre.

    Parameters
    ----------
    size : float
        Wanted share of the picture that the object covers.

    Raises
    ------
    ToktError
        If that is not `MIN_SIZE` to `MAX_SIZE`.
    """

    size: float

    def __post_init__(self) -> None:
        if not MIN_SIZE <= self.size <= MAX_SIZE:
            raise ToktError(
                f"an anchor is the share of the frame that the object is to cover, "
                f"{MIN_SIZE:g} to {MAX_SIZE:g}, not {self.size:g} (--anchor SIZE)"
            )

    def errors(self, verdict: Verdict) -> AnchorErrors:
        """The errors of what a frame's verdict says is there; none without an obstacle."""
        x, y, mean, size = verdict.x, verdict.y, verdict.mean, verdict.mask_size
        if verdict.status != OBSTACLE or x is None or y is None or mean is None or size is None:
            return AnchorErrors()
        if not mean > 0:
            return AnchorErrors()
        height, width = size
        too_large = 0.5 * math.log(mean / 255 / self.size)
        return AnchorErrors(_share(-x, width), _share(-y, height), round(too_large, 3))


def _share(from_centre_px: int, length_px: int) -> float:
    """A place in pixels from the picture's centre, over the half of its length."""
    share = from_centre_px / max(length_px // 2, 1)
    return round(min(max(share, -1.0), 1.0), 3) + 0.0  # + 0.0: no -0.0
