"""The thesis's own planner: its LabVIEW program's waypoint rule, as printed, and its fault at sea.

At status 1 a new waypoint ahead and to the side, for a certain time *or* until the obstacle is out
of view (paper, part 2); at status 0 the goal again. It goes from waypoint to waypoint, looking
where it goes. At sea the offset was taken as north and east, not as ahead and to starboard: the
waypoint came to lie behind the vehicle, or behind the obstacle (table 4.2, attempts 2 and 4).
"""

import math
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64
from tokt.inference.verdict import OBSTACLE

from .autopilot import Mode, Setpoint
from .planner import ARRIVED_M, REACHED_M, SILENCE_S, steered
from .vehicle import State

AHEAD_M, ASIDE_M = 3.0, 3.0
"""From the vehicle to its new waypoint; the thesis prints no figures."""
AVOID_S = 10.0
"""How long it avoids, where that goes by time."""


class LabviewPlanner:
    """One transit to one goal, by the printed rule.

    `avoid_s` is how long it avoids; None is until the obstacle is out of view. `heading_rad` makes
    the fault of the sea trial: the offset is taken as one in the world's frame, on a way that leads
    there. None is right: the offset is one of the body-fixed frame.
    """

    def __init__(
        self, goal: F64, avoid_s: float | None = None, heading_rad: float | None = None
    ) -> None:
        self.goal = np.asarray(goal, np.float64)
        self.reached = False
        self.avoidances: list[float] = []
        self._avoid_s, self._turned = avoid_s, -(heading_rad or 0.0)
        self._waypoint: F64 | None = None
        self._began_s, self._heard_s = 0.0, -math.inf

    def target(
        self, t_s: float, nav: State, heard: dict[str, Any] | None = None, pilot: F64 | None = None
    ) -> Setpoint:
        """See `tokt.studies.simulation.loop.planner.Planner.target`; unknown is no status 1."""
        if pilot is not None:
            return Setpoint(pilot, nav.heading_rad, Mode.PILOT)
        if heard is not None:
            self._heard_s = t_s
            self._take_in(t_s, heard, nav)
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
        aside = ASIDE_M if (heard["x"] or 0) > 0 else -ASIDE_M
        way = nav.heading_rad + self._turned
        sine, cosine = math.sin(way), math.cos(way)
        offset = [AHEAD_M * sine + aside * cosine, 0.0, AHEAD_M * cosine - aside * sine]
        self._waypoint = nav.position + offset
