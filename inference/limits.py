"""How old, how late and how often the same a frame may be."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from ..features.errors import ToktError

STALE_S = 0.5


@dataclass(frozen=True)
class Limits:
    """When the runtime no longer believes what it sees.

    Parameters
    ----------
    stale_s : float
        Seconds from a frame's arrival after which it is clear no more.
    heartbeat_s : float
        Seconds without a report after which unknown is said.
    frozen_repeats : int
        Times that a camera may repeat its picture exactly, which its noise forbids; and no longer
        than `stale_s`, where frames have times.

    Raises
    ------
    ToktError
        If a time is not positive.
    """

    stale_s: float = STALE_S
    heartbeat_s: float = STALE_S
    frozen_repeats: int = 5

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value > 0):
                raise ToktError(f"{field.name} is a positive number, not {value}")
