"""The thesis's own planner: its LabVIEW program's waypoint rule, as printed, and its fault at sea.

At status 1 a new waypoint ahead and to the side, for a certain time *or* until the obstacle is out
of view (paper, part 2); at status 0 the goal again. It goes from waypoint to waypoint, looking
where it goes. At sea the offset was taken in another frame than the vehicle's own: the waypoint
came to lie behind the vehicle, or behind the obstacle (table 4.2, attempts 2 and 4).
"""

import math
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64
from tokt.inference.verdict import OBSTACLE

from .autopilot import Mode, Setpoint
from .planner import ARRIVED_M, REACHED_M, SILENCE_S, Planner, steered
from .vehicle import State

OFFSET_M = 3.0
"""From the vehicle to its new waypoint, ahead and aside; the thesis prints no figures."""
BEHIND_IT = (math.pi, OFFSET_M)
BEHIND_OBSTACLE = (math.pi / 4, 8.5)
"""The fault: how far the offset's frame is turned to the other side, and the offset. A waypoint
12 m right ahead is beyond a tower, wherever that is seen first."""
AVOID_S = 10.0
"""How long it avoids, where that goes by time."""


class LabviewPlanner:
    """One transit to one goal, by the printed rule.

    `avoid_s` is how long it avoids; None is until the obstacle is out of view. `end_m` is as for
    `Planner`. `fault` is the sea trial's, `BEHIND_IT` or `BEHIND_OBSTACLE`; without one the offset
    is in the body-fixed frame.
    """

    def __init__(
        self, goal: F64, avoid_s: float | None = None, end_m: float | None = None,
        fault: tuple[float, float] = (0.0, OFFSET_M),
    ) -> None:  # fmt: skip
        self.goal = np.asarray(goal, np.float64)
        self.reached = False
        self.avoidances: list[float] = []
        self._avoid_s, (self._turned, self._offset_m) = avoid_s, fault
        self._straight = Planner(goal, deaf=True, end_m=end_m)
        self._waypoint: F64 | None = None
        self._began_s, self._heard_s = 0.0, -math.inf

    def target(
        self, t_s: float, nav: State, heard: dict[str, Any] | None = None, pilot: F64 | None = None
    ) -> Setpoint:
        """See `tokt_studies.simulation.loop.planner.Planner.target`; unknown is no status 1."""
        if pilot is not None:
            return Setpoint(pilot, nav.heading_rad, Mode.PILOT)
        if heard is not None:
            self._heard_s = t_s
            self._take_in(t_s, heard, nav)
        straight = self._straight.target(t_s, nav)
        if straight.mode is Mode.HOLD:
            self.reached = self._straight.reached
            return straight
        if self._waypoint is None:
            self.reached = float(np.linalg.norm(self.goal - nav.position)) < ARRIVED_M
            return steered(nav, self.goal, Mode.TRANSIT)
        near = np.linalg.norm(self._waypoint - nav.position) < REACHED_M
        over = self._avoid_s is not None and t_s - self._began_s > self._avoid_s
        if near or over or t_s - self._heard_s > SILENCE_S:
            self._waypoint = None
            return steered(nav, self.goal, Mode.TRANSIT)
        return steered(nav, self._waypoint, Mode.AVOID)

    def _take_in(self, t_s: float, heard: dict[str, Any], nav: State) -> None:
        if heard["status"] != OBSTACLE:
            if self._avoid_s is None:
                self._waypoint = None
            return
        if self._waypoint is None:
            self.avoidances.append(t_s)
            self._began_s = t_s
        elif self._avoid_s is not None:
            return
        # Away from it; to the left where it is right ahead.
        side = 1 if (heard["x"] or 0) > 0 else -1
        way = nav.heading_rad - side * self._turned
        sine, cosine = math.sin(way), math.cos(way)
        offset = np.array([sine + side * cosine, 0.0, cosine - side * sine])
        self._waypoint = nav.position + self._offset_m * offset
