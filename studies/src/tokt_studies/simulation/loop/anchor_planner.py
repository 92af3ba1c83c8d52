"""The planner that keeps station before an object, by the anchor's errors alone.

A PID controller an axis asks for a speed through the water. Where the object is not held, it asks
for what the current took till then, the integral.
"""

import math
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64

from .autopilot import POSITION_GAIN, Mode, Setpoint
from .planner import SILENCE_S
from .vehicle import State

GAIN, INTEGRAL, DERIVATIVE = 0.7, 0.1, 0.5
"""Of the error in metres: 1/s, 1/s2 and none. Chosen on seeds 1001 to 1060."""
VIEW_M = np.array([1.224, 0.92, -4.0])
"""Of errors of 1 at 4 m, which is assumed: half of the view, and the distance."""
MAX_M_S, STEP_S = 0.4, 0.25


class AnchorPlanner:
    """Station before one object; it never arrives."""

    def __init__(self) -> None:
        self.reached = False
        self.avoidances: list[float] = []
        self._heard_s = -math.inf
        self._before: F64 | None = None
        self._trim = self._asked = np.zeros(3)  # right, down, ahead, m/s

    def target(
        self, t_s: float, nav: State, heard: dict[str, Any] | None = None, pilot: F64 | None = None
    ) -> Setpoint:
        """The setpoint for now, from a datagram that has come; heading as it is wanted, north."""
        self._heard_s = self._heard_s if heard is None else t_s
        told = heard and heard["anchor_size"]
        if t_s - self._heard_s > SILENCE_S or (heard and told is None):
            self._asked, self._before = self._trim, None
        elif heard and told is not None:
            error = VIEW_M * (heard["anchor_x"], heard["anchor_y"], told)
            change = 0.0 if self._before is None else (error - self._before) / STEP_S
            self._before = error
            self._trim = (self._trim + INTEGRAL * STEP_S * error).clip(-MAX_M_S, MAX_M_S)
            self._asked = (GAIN * error + self._trim + DERIVATIVE * change).clip(-MAX_M_S, MAX_M_S)
        # Of the position only the difference is used: where the vehicle is it does not know.
        return Setpoint(nav.position + self._asked / POSITION_GAIN, 0.0, Mode.HOLD)
