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
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from tokt.features.common.arrays import F64
from tokt.inference.verdict import OBSTACLE, UNKNOWN

from .autopilot import Mode, Setpoint
from .manoeuvre import CameraAssumptions, Manoeuvre
from .vehicle import State, turn

STOPPING_S = 0.6
"""Metres to a stop, a metre a second of speed: of `MINERVA` with its autopilot, about."""
REACHED_M = 0.25
"""Nearer to a place than this is there."""
FARTHEST_GLANCE = math.radians(60)
"""From the way past the obstacle."""
WELL_INSIDE = 0.7
"""Of the half view: what is nearer to the middle must be seen, if it is there."""


@dataclass(frozen=True)
class PlannerSettings:
    """Settings of the planner, in metres, seconds and radians.

    Parameters
    ----------
    cruise_m_s : float
        Speed of transit.
    silence_s : float
        Nothing heard for longer is taken for unknown (docs/udp.md).
    camera : CameraAssumptions
        The camera and what is assumed of obstacles.
    beside_m : float
        From the edge of what is remembered to the hull's centre, on the way past: the hull's
        radius and what is to be left free.
    past_m : float
        The same along the way.
    clear_frames : int
        Clear verdicts in a row before going ahead past the obstacle.
    dismiss_frames : int
        Clear verdicts in a row, with what is remembered well inside the view, to forget it.
    glance_frames : int
        Clear verdicts, looking to where the way back to the goal leads, before taking it.
    back_off_mean : float
        Mean of the 0/255 mask above which an obstacle is wide, and it backs off.
    wide_box : float
        Of the frame's width: what has a wider box is wide, too.
    back_off_wide_m : float
        A wide obstacle that is known to be farther away is gone around from here: a trap 3 m
        deep is not entered yet.
    back_off_distance_m, back_off_contact_s : float
        Distance and time to contact below which it does.
    trend_confidence : float
        Below it the time to contact by expansion does not count.
    back_off_m, back_off_most_m : float
        How far back at least, and at most, from where it was nearest.
    reached_m : float
        Nearer to the goal than this is there.
    frame : {"body", "world"}
        Of the waypoint's offset. "world" repeats the fault of the sea trial, to show what it does.
    deaf : bool
        Ignore every datagram, and silence: the control that avoids nothing.
    """

    cruise_m_s: float = 0.6
    silence_s: float = 1.5
    camera: CameraAssumptions = field(default_factory=CameraAssumptions)
    beside_m: float = 1.5
    past_m: float = 1.3
    clear_frames: int = 3
    dismiss_frames: int = 10
    glance_frames: int = 6
    back_off_mean: float = 60.0
    wide_box: float = 0.85
    back_off_wide_m: float = 5.5
    back_off_distance_m: float = 2.2
    back_off_contact_s: float = 3.0
    trend_confidence: float = 0.8
    back_off_m: float = 3.0
    back_off_most_m: float = 6.0
    reached_m: float = 0.4
    frame: Literal["body", "world"] = "body"
    deaf: bool = False


class Planner:
    """One transit to one goal.

    Parameters
    ----------
    goal : (3,) floats
        World, metres.
    settings : PlannerSettings

    Attributes
    ----------
    mode : Mode
        As of the last `autopilot`.
    reached : bool
        Whether the vehicle was at the goal at the last `autopilot`.
    avoidances : list of float
        When each manoeuvre began, s.
    """

    def __init__(self, goal: F64, settings: PlannerSettings | None = None) -> None:
        self.goal = np.asarray(goal, np.float64)
        self.settings = settings or PlannerSettings()
        self.mode = Mode.TRANSIT
        self.reached = False
        self.avoidances: list[float] = []
        self._heard: list[dict[str, Any]] = []
        self._heard_s: float | None = None
        self._known = False
        self._manoeuvre: Manoeuvre | None = None
        self._held: tuple[F64, float] | None = None

    def hear(self, t_s: float, datagram: dict[str, Any] | None) -> None:
        """Take in a datagram as `tokt.inference.outputs.udp.decode` gives it, or None for nothing.

        What it says is judged from where the vehicle is at the next `autopilot`.
        """
        if datagram is not None:
            self._heard_s = t_s
            self._heard.append(datagram)

    def target(self, t_s: float, nav: State) -> Setpoint:
        """The setpoint for now.

        Parameters
        ----------
        t_s : float
        nav : State
            From the vehicle's navigation.
        """
        for datagram in self._heard:
            self._take_in(t_s, datagram, nav)
        self._heard.clear()
        if self.settings.deaf:
            return self._transit(nav)
        silent = self._heard_s is None or t_s - self._heard_s > self.settings.silence_s
        if silent or not self._known:
            return self._hold(nav)
        self._held = None
        if self._manoeuvre is not None and self._manoeuvre.glances >= self.settings.glance_frames:
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
            self._manoeuvre.clear(nav, WELL_INSIDE * self.settings.camera.half_view)
            if self._manoeuvre.absent >= self.settings.dismiss_frames:
                self._manoeuvre = None

    def _take_in_obstacle(self, t_s: float, datagram: dict[str, Any], nav: State) -> None:
        own = self.settings
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
            self._manoeuvre.back_off(nav, own.back_off_m, own.back_off_most_m)

    def _new_manoeuvre(self, datagram: dict[str, Any], nav: State) -> Manoeuvre:
        """A manoeuvre that begins here, beside the way on which the vehicle is."""
        own = self.settings
        look = self._course(nav)
        # While it still turns to its way, what it sees is beside that, not ahead.
        bearing = turn(nav.heading_rad - look) + own.camera.bearing(-(datagram["x"] or 0))
        # Away from it; the thesis's program goes left where it is right ahead.
        side = 1 if bearing < 0 else -1
        frame = look if own.frame == "body" else 0.0
        return Manoeuvre(nav.position, frame, look, side, own.camera, _stopping_m(nav))

    def _course(self, nav: State) -> float:
        """The heading that transit goes on: to the goal; close to it, as it is."""
        way = self.goal - nav.position
        # There the bearing turns fast, and means nothing.
        if math.hypot(way[0], way[2]) < 2 * self.settings.reached_m:
            return nav.heading_rad
        return math.atan2(way[0], way[2])

    def _is_wide(self, datagram: dict[str, Any]) -> bool:
        """Whether it fills so much of the view that it may go on on either side."""
        own, box = self.settings, datagram.get("box")
        if box is not None and box[2] > own.wide_box * own.camera.mask_width:
            return True
        return (datagram["mean"] or 0.0) > own.back_off_mean

    def _too_near(self, datagram: dict[str, Any], wide: bool) -> bool:
        own, distance_m = self.settings, datagram.get("distance_m")
        if wide and (distance_m is None or distance_m < own.back_off_wide_m):
            return True
        # By expansion alone, in frames with few patches: only where it is sure.
        sure = (datagram.get("trend_confidence") or 0.0) >= own.trend_confidence
        expansion_s = datagram.get("expansion_contact_s") if sure else None
        return any(
            value is not None and value < least
            for value, least in (
                (distance_m, own.back_off_distance_m),
                (datagram.get("contact_s"), own.back_off_contact_s),
                (expansion_s, own.back_off_contact_s),
            )
        )

    def _passed(self, manoeuvre: Manoeuvre, nav: State) -> bool:
        """Whether all that is remembered is behind, or the goal is beside."""
        return manoeuvre.place(nav.position)[0] > self._end(manoeuvre) - REACHED_M

    def _end(self, manoeuvre: Manoeuvre) -> float:
        """How far along to go: past what is remembered, and no farther than the goal."""
        return min(manoeuvre.end() + self.settings.past_m, manoeuvre.place(self.goal)[0])

    def _hold(self, nav: State) -> Setpoint:
        if self._held is None:
            self._held = nav.position + STOPPING_S * nav.velocity_world, nav.heading_rad
        self.mode = Mode.HOLD
        return Setpoint(*self._held, self.mode, self.settings.cruise_m_s)

    def _transit(self, nav: State) -> Setpoint:
        """To the goal, looking where it goes: turned first, where the goal is not ahead."""
        own = self.settings
        way = self.goal - nav.position
        self.reached = float(np.linalg.norm(way)) < own.reached_m
        self.mode = Mode.TRANSIT
        heading = self._course(nav)
        off = abs(turn(heading - nav.heading_rad))
        speed = own.cruise_m_s * max(0.0, 1.0 - off / own.camera.half_view)
        return Setpoint(self.goal, heading, self.mode, speed)

    def _avoid(self, manoeuvre: Manoeuvre, nav: State) -> Setpoint:
        """Back, then beside, then past."""
        own = self.settings
        along, beside = manoeuvre.place(nav.position)
        if manoeuvre.retreat is not None and along > manoeuvre.retreat + REACHED_M:
            self.mode = Mode.BACK_OFF
            return self._on_manoeuvre(manoeuvre, manoeuvre.retreat, manoeuvre.retreat_beside)
        if manoeuvre.retreat is not None:
            manoeuvre.retreat = None
            manoeuvre.hold_along = along
        self.mode = Mode.AVOID
        need = manoeuvre.edge(along) + own.beside_m
        if beside > need - REACHED_M and manoeuvre.settled >= own.clear_frames:
            # Farther out than it need be, it does not come back in beside the obstacle.
            manoeuvre.hold_along = along + _stopping_m(nav)
            return self._on_manoeuvre(manoeuvre, self._end(manoeuvre), max(need, beside))
        return self._on_manoeuvre(manoeuvre, manoeuvre.hold_along, max(need, beside))

    def _glance(self, manoeuvre: Manoeuvre, nav: State) -> Setpoint:
        """Past it: look where the way back leads, farther to the side than the way itself.

        On the way back the camera sees what is ahead, but not what is beside and near already.
        """
        if manoeuvre.glance is None:
            inward = -manoeuvre.side * 2 * self.settings.camera.half_view
            turned = turn(self._course(nav) + inward - manoeuvre.look)
            # Farther round than that it would look at what it has passed.
            turned = min(max(turned, -FARTHEST_GLANCE), FARTHEST_GLANCE)
            manoeuvre.glance = nav.position, manoeuvre.look + turned
        self.mode = Mode.AVOID
        return Setpoint(*manoeuvre.glance, self.mode, self.settings.cruise_m_s)

    def _on_manoeuvre(self, manoeuvre: Manoeuvre, along: float, beside: float) -> Setpoint:
        place = manoeuvre.world(along, beside, float(self.goal[1]))
        return Setpoint(place, manoeuvre.look, self.mode, self.settings.cruise_m_s)


def _stopping_m(nav: State) -> float:
    """How far ahead the vehicle comes to rest, about; 0 where it goes back."""
    speed = max(float(nav.velocity_body[0]), 0.0)
    return STOPPING_S * speed
