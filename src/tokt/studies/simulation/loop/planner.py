"""The planner on the receiving side: from datagrams to where the vehicle is to be.

The rule of the thesis's LabVIEW program, as it was told to this project (its source is not at
hand): while the status is 1, a new waypoint beside the obstacle, on the side that Xpos says, in the
body-fixed frame; back to the goal when it is reached. Added here, and why:

- *Beside, then past.* The camera sees 17 degrees to either side. The obstacle leaves the view long
  before the vehicle is past it, and a planner that goes back to the goal at the first clear verdict
  turns into it. So what was seen is remembered in the frame of the manoeuvre (`Manoeuvre`), by
  bearing and distance, or every distance it may have where the datagram has none: first sideways
  until the hull fits past what is remembered *and* the water ahead is clear, then ahead until it is
  behind.
- *Glance.* Before it goes back it stops and looks to the inner side: there may be another one.
- *One side.* The side of the first verdict is kept until the obstacle is passed.
- *Back off.* A large mean value, a small distance or a short time to contact: first straight back
  the way it came, as sideways is where a trap (thesis figure 6.2) has its walls.
- *Hold.* Unknown verdicts, and silence, which is v1's only word for them: the vehicle keeps its
  station until something is known again.
- *Dismiss.* What is not seen any more though it should be in view (a fish, a false alarm) is
  forgotten.

Time comes from the caller: seconds of any clock that does not step back.
"""

import math
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64
from tokt.inference.verdict import OBSTACLE, UNKNOWN

from .autopilot import CRUISE_M_S, Mode, Setpoint
from .manoeuvre import HALF_VIEW, MASK_WIDTH, Manoeuvre, bearing
from .vehicle import State, turn

STOPPING_S = 0.6
"""Metres to a stop, a metre a second of speed: of `MINERVA` with its autopilot, about."""
REACHED_M, ARRIVED_M = 0.25, 0.4
"""Nearer to a place than this is there; nearer to the goal."""
SILENCE_S = 1.5
"""Nothing heard for longer is taken for unknown (docs/reference/udp.md)."""
BESIDE_M, PAST_M = 1.5, 1.3
"""From the edge of what is remembered to the hull's centre, beside it and along the way: the hull's
radius and what is to be left free."""
CLEAR_FRAMES = 3
"""Clear verdicts in a row before going ahead past the obstacle."""
DISMISS_FRAMES, WELL_INSIDE = 10, 0.7
"""Clear verdicts in a row to forget what is remembered, if it is this well inside the view: nearer
to the middle than this share of half of it, where it must be seen if it is there."""
GLANCE_FRAMES, FARTHEST_GLANCE = 6, math.radians(60)
"""Clear verdicts, looking to where the way back to the goal leads, before taking it; and how far
from the way past the obstacle it looks."""
WIDE_MEAN, WIDE_BOX = 60.0, 0.85
"""Mean of the 0/255 mask, and share of the frame's width in the box, above which an obstacle is
wide, and it backs off."""
BACK_OFF_WIDE_M = 5.5
"""A wide obstacle that is known to be farther away is gone around from here: a trap 3 m deep is not
entered yet."""
BACK_OFF_DISTANCE_M, BACK_OFF_CONTACT_S = 2.2, 3.0
"""Distance and time to contact below which it backs off."""
SURE_TREND = 0.8
"""Confidence below which the time to contact by expansion does not count."""
BACK_OFF_M, BACK_OFF_MOST_M = 3.0, 6.0
"""How far back at least, and at most, from where it was nearest."""


class Planner:
    """One transit to one goal, a world place (3,) in metres.

    A `deaf` one ignores every datagram, and silence: the control that avoids nothing.
    """

    def __init__(self, goal: F64, deaf: bool = False) -> None:
        self.goal = np.asarray(goal, np.float64)
        self.reached = False  # whether the vehicle was at the goal at the last `target`
        self.avoidances: list[float] = []  # when each manoeuvre began, s
        self._deaf = deaf
        self._heard_s: float | None = None
        self._known = False
        self._manoeuvre: Manoeuvre | None = None
        self._held: tuple[F64, float] | None = None

    def target(self, t_s: float, nav: State, heard: dict[str, Any] | None = None) -> Setpoint:
        """The setpoint for now, from the vehicle's navigation and a datagram that has come.

        The datagram is as `tokt.inference.outputs.udp.decode` gives it.
        """
        if self._deaf:
            return self._transit(nav)
        if heard is not None:
            self._heard_s = t_s
            self._take_in(t_s, heard, nav)
        silent = self._heard_s is None or t_s - self._heard_s > SILENCE_S
        if silent or not self._known:
            return self._hold(nav)
        self._held = None
        if self._manoeuvre is not None and self._manoeuvre.glances >= GLANCE_FRAMES:
            self._manoeuvre = None
        if self._manoeuvre is None:
            return self._transit(nav)
        if self._passed(self._manoeuvre, nav):
            return self._glance(self._manoeuvre, nav)
        return self._avoid(self._manoeuvre, nav)

    def _take_in(self, t_s: float, datagram: dict[str, Any], nav: State) -> None:
        status = datagram["status"]
        self._known = status != UNKNOWN
        if status == OBSTACLE:
            self._take_in_obstacle(t_s, datagram, nav)
        elif self._manoeuvre is not None and self._known:
            self._manoeuvre.clear(nav, WELL_INSIDE * HALF_VIEW)
            if self._manoeuvre.absent >= DISMISS_FRAMES:
                self._manoeuvre = None

    def _take_in_obstacle(self, t_s: float, datagram: dict[str, Any], nav: State) -> None:
        if self._manoeuvre is None:
            self.avoidances.append(t_s)
            self._manoeuvre = self._new_manoeuvre(datagram, nav)
        wide = self._is_wide(datagram)
        glanced = self._manoeuvre.glance is not None
        self._manoeuvre.see(datagram, nav, wide)
        if glanced and self._passed(self._manoeuvre, nav):
            # It is beside, and not on the way past: on the way back the camera will face it.
            self._manoeuvre = None
            return
        if self._too_near(datagram, wide):
            self._manoeuvre.back_off(nav, BACK_OFF_M, BACK_OFF_MOST_M)

    def _new_manoeuvre(self, datagram: dict[str, Any], nav: State) -> Manoeuvre:
        """A manoeuvre that begins here, beside the way on which the vehicle is."""
        look = self._course(nav)
        # While it still turns to its way, what it sees is beside that, not ahead.
        seen = turn(nav.heading_rad - look) + bearing(-(datagram["x"] or 0))
        # Away from it; the thesis's program goes left where it is right ahead.
        side = 1 if seen < 0 else -1
        return Manoeuvre(nav.position, look, side, _stopping_m(nav))

    def _course(self, nav: State) -> float:
        """The heading that transit goes on: to the goal; close to it, as it is."""
        way = self.goal - nav.position
        # There the bearing turns fast, and means nothing.
        if math.hypot(way[0], way[2]) < 2 * ARRIVED_M:
            return nav.heading_rad
        return math.atan2(way[0], way[2])

    def _is_wide(self, datagram: dict[str, Any]) -> bool:
        """Whether it fills so much of the view that it may go on on either side."""
        box = datagram.get("box")
        if box is not None and box[2] > WIDE_BOX * MASK_WIDTH:
            return True
        return (datagram["mean"] or 0.0) > WIDE_MEAN

    def _too_near(self, datagram: dict[str, Any], wide: bool) -> bool:
        distance_m = datagram.get("distance_m")
        if wide and (distance_m is None or distance_m < BACK_OFF_WIDE_M):
            return True
        # By expansion alone, in frames with few patches: only where it is sure.
        sure = (datagram.get("trend_confidence") or 0.0) >= SURE_TREND
        expansion_s = datagram.get("expansion_contact_s") if sure else None
        contacts = (datagram.get("contact_s"), expansion_s)
        near = distance_m is not None and distance_m < BACK_OFF_DISTANCE_M
        return near or any(one is not None and one < BACK_OFF_CONTACT_S for one in contacts)

    def _passed(self, manoeuvre: Manoeuvre, nav: State) -> bool:
        """Whether all that is remembered is behind, or the goal is beside."""
        return manoeuvre.place(nav.position)[0] > self._end(manoeuvre) - REACHED_M

    def _end(self, manoeuvre: Manoeuvre) -> float:
        """How far along to go: past what is remembered, and no farther than the goal."""
        return min(manoeuvre.end() + PAST_M, manoeuvre.place(self.goal)[0])

    def _hold(self, nav: State) -> Setpoint:
        if self._held is None:
            self._held = nav.position + STOPPING_S * nav.velocity_world, nav.heading_rad
        return Setpoint(*self._held, Mode.HOLD)

    def _transit(self, nav: State) -> Setpoint:
        """To the goal, looking where it goes: turned first, where the goal is not ahead."""
        way = self.goal - nav.position
        self.reached = float(np.linalg.norm(way)) < ARRIVED_M
        heading = self._course(nav)
        off = abs(turn(heading - nav.heading_rad))
        speed = CRUISE_M_S * max(0.0, 1.0 - off / HALF_VIEW)
        return Setpoint(self.goal, heading, Mode.TRANSIT, speed)

    def _avoid(self, manoeuvre: Manoeuvre, nav: State) -> Setpoint:
        """Back, then beside, then past."""
        along, beside = manoeuvre.place(nav.position)
        if manoeuvre.retreat is not None and along > manoeuvre.retreat + REACHED_M:
            back = manoeuvre.retreat, manoeuvre.retreat_beside
            return self._on_manoeuvre(manoeuvre, *back, Mode.BACK_OFF)
        if manoeuvre.retreat is not None:
            manoeuvre.retreat = None
            manoeuvre.hold_along = along
        need = manoeuvre.edge(along) + BESIDE_M
        if beside > need - REACHED_M and manoeuvre.settled >= CLEAR_FRAMES:
            # Farther out than it need be, it does not come back in beside the obstacle.
            manoeuvre.hold_along = along + _stopping_m(nav)
            return self._on_manoeuvre(manoeuvre, self._end(manoeuvre), max(need, beside))
        return self._on_manoeuvre(manoeuvre, manoeuvre.hold_along, max(need, beside))

    def _glance(self, manoeuvre: Manoeuvre, nav: State) -> Setpoint:
        """Past it: look where the way back leads, farther to the side than the way itself.

        On the way back the camera sees what is ahead, but not what is beside and near already.
        """
        if manoeuvre.glance is None:
            inward = -manoeuvre.side * 2 * HALF_VIEW
            turned = turn(self._course(nav) + inward - manoeuvre.look)
            # Farther round than that it would look at what it has passed.
            turned = min(max(turned, -FARTHEST_GLANCE), FARTHEST_GLANCE)
            manoeuvre.glance = nav.position, manoeuvre.look + turned
        return Setpoint(*manoeuvre.glance, Mode.AVOID)

    def _on_manoeuvre(
        self, manoeuvre: Manoeuvre, along: float, beside: float, mode: Mode = Mode.AVOID
    ) -> Setpoint:
        place = manoeuvre.world(along, beside, float(self.goal[1]))
        return Setpoint(place, manoeuvre.look, mode)


def _stopping_m(nav: State) -> float:
    """How far ahead the vehicle comes to rest, about; 0 where it goes back."""
    speed = max(float(nav.velocity_body[0]), 0.0)
    return STOPPING_S * speed
