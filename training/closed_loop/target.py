"""What the planner asks of the autopilot: where to be, looking which way, how fast, and why."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from .vehicle import Float


class Mode(StrEnum):
    """What the planner is at."""

    TRANSIT = "transit"
    AVOID = "avoid"
    BACK_OFF = "back off"
    HOLD = "hold"


@dataclass(frozen=True)
class Target:
    """Where to be.

    Parameters
    ----------
    position : (3,) float64
        World, metres.
    heading : float
        Radians.
    mode : Mode
    speed_m_s : float
        Not to be exceeded on the way.
    """

    position: Float
    heading: float
    mode: Mode
    speed_m_s: float = 0.6
