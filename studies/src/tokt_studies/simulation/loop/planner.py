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
- *Wait.* Before it avoids it stops and looks. What keeps its place in the view is avoided; what
  moves across, as fish do, is waited for. What comes near meanwhile is backed off from.
- *Hold.* Unknown verdicts, and silence, which is v1's only word for them: the vehicle keeps its
  station until something is known again. Where it goes on to be unknown (too near to a wall to be
  matched), it goes back the way it came, step by step.
- *Stuck.* Without progress it backs off and tries the other side (thesis, figure 6.2; paper, part
  2).
- *Pilot.* The pilot can take over at any time: first the vehicle keeps its station, and so it does
  after him until something is known.
- *Dismiss.* What is not seen any more though it should be in view (a fish, a false alarm) is
  forgotten.

Time comes from the caller: seconds of any clock that does not step back.
"""

import math
from itertools import pairwise, takewhile
from typing import Any, NamedTuple

import numpy as np

from tokt.features.common.arrays import F64
from tokt.inference.verdict import OBSTACLE, UNKNOWN

from .autopilot import CRUISE_M_S, Mode, Setpoint
from .manoeuvre import BACK_OFF_MOST_M, HALF_VIEW, MASK_WIDTH, Manoeuvre, bearing
from .vehicle import State, turn

STEADY_S, STEADY_PX = 3.0, 25
"""What stays for so long within so many columns, seen by a vehicle at rest, stands still or comes
straight on."""
GROWS_S, GROWS = 2.0, 1.4
"""What has grown in the view of a vehicle at rest for so long, to so many times its size, comes
towards it; what swims into the view is not all in it meanwhile."""
STEADY_GAP_S = 1.0
"""What is away for longer is not steady."""
WAIT_S = 15.0
"""The longest that it stands and looks before it avoids."""
PASSED_FRAMES = 4
"""Clear verdicts in a row, while it stands, after which it goes on."""
PATIENCE_S, RETREAT_M = 10.0, 1.5
"""How long it holds its station before it goes back, and how far each time."""
STUCK_S, PROGRESS_M = 60.0, 0.5
"""It is stuck if for so long it has not come so much nearer to the goal."""
AT_REST_M_S = 0.1
"""Slower than this it keeps its station."""
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
HURRY_M = 1.5
"""A vehicle on its way does not stop to look what it is that is so near: a stop takes 0.4 m, and
its hull begins 0.3 m before the camera."""
SURE_TREND = 0.8
"""Confidence below which the time to contact by expansion does not count."""


class Look(NamedTuple):
    """What one verdict shows to a vehicle at rest."""

    t_s: float
    column: int  # of its middle, from the frame's, px
    mean: float
    whole: bool  # whether all of it is in the view, as far as its box says


class Wait(NamedTuple):
    """A stop before an obstacle: since when (s), where, and what was seen at rest."""

    since_s: float
    place: F64
    heading: float
    seen: list[Look]

    def keeps_its_place(self, t_s: float) -> bool:
        """Whether what is seen has kept its place in the view, ever since."""
        times = [look.t_s for look in self.seen]
        columns = [look.column for look in self.seen]
        if not times or t_s - times[0] < STEADY_S:
            return False
        gap = max(later - earlier for earlier, later in pairwise([*times, t_s]))
        return gap <= STEADY_GAP_S and max(columns) - min(columns) <= STEADY_PX

    def comes_here(self) -> bool:
        """Whether what is seen has grown of late, with all of it in the view."""
        lately = list(takewhile(lambda look: look.whole, reversed(self.seen)))
        if not lately or lately[0].t_s - lately[-1].t_s < GROWS_S:
            return False
        return lately[0].mean > GROWS * lately[-1].mean


class Progress:
    """How near the goal was come to, and for how long no nearer; time on station does not count."""

    def __init__(self) -> None:
        self._best_m, self._stalled_s = math.inf, 0.0
        self._asked_s: float | None = None

    def hold(self) -> None:
        """The vehicle is on station now."""
        self._asked_s = None

    def stuck(self, t_s: float, to_goal_m: float) -> bool:
        """Whether there was none for `STUCK_S`; then it begins anew."""
        self._stalled_s += 0.0 if self._asked_s is None else t_s - self._asked_s
        self._asked_s = t_s
        stuck = self._stalled_s > STUCK_S
        if stuck or to_goal_m < self._best_m - PROGRESS_M:
            self._best_m, self._stalled_s = to_goal_m, 0.0
        return stuck


class Planner:
    """One transit to one goal, a world place (3,) in metres.

    It ends at the goal, or on station within `end_m` of it. A `deaf` one ignores every datagram,
    and silence: the control that avoids nothing.
    """

    def __init__(self, goal: F64, deaf: bool = False, end_m: float | None = None) -> None:
        self.goal = np.asarray(goal, np.float64)
        self.reached = False  # whether the vehicle was at the goal at the last `target`
        self.avoidances: list[float] = []  # when each manoeuvre began, s
        self._deaf, self._end_m = deaf, end_m
        self._heard_s: float | None = None
        self._known = False
        self._manoeuvre: Manoeuvre | None = None
        self._held: tuple[float, F64, float] | None = None  # since when (s), where, which way
        self._wait: Wait | None = None
        self._clear = 0  # verdicts in a row while it waits
        self._handed_over = False  # to the pilot
        self._progress = Progress()

    def target(
        self, t_s: float, nav: State, heard: dict[str, Any] | None = None,
        pilot: F64 | None = None,
    ) -> Setpoint:  # fmt: skip
        """The setpoint for now, from the vehicle's navigation and a datagram that has come.

        The datagram is as `tokt.inference.outputs.udp.decode` gives it. `pilot` is the world place
        (3,) that a pilot who has taken over steers to.
        """
        if self._deaf:
            return self._hold(t_s, nav) if self._ends(nav) else self._transit(nav)
        if pilot is not None:
            return self._piloted(t_s, nav, pilot)
        if heard is not None:
            self._heard_s = t_s
            self._take_in(t_s, heard, nav)
        self._handed_over = self._handed_over and heard is None
        if self._handed_over or self._ends(nav):
            return self._hold(t_s, nav)
        silent = self._heard_s is None or t_s - self._heard_s > SILENCE_S
        if silent or not self._known:
            return self._hold(t_s, nav, patient=silent)
        self._held = None
        self._unstick(t_s, nav)
        if self._wait is not None:
            return Setpoint(self._wait.place, self._wait.heading, Mode.HOLD)
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
        if not self._known:
            self._wait = None
        if status == OBSTACLE:
            self._take_in_obstacle(t_s, datagram, nav)
            return
        self._clear = self._clear + 1 if self._known else 0
        if self._clear >= PASSED_FRAMES:
            self._wait = None
        if self._manoeuvre is not None and self._known:
            self._manoeuvre.clear(nav, WELL_INSIDE * HALF_VIEW)
            if self._manoeuvre.absent >= DISMISS_FRAMES:
                self._manoeuvre = None

    def _take_in_obstacle(self, t_s: float, datagram: dict[str, Any], nav: State) -> None:
        self._clear = 0
        wide = self._is_wide(datagram)
        if self._manoeuvre is None:
            if not self._hurries(datagram, nav) and self._waits(t_s, datagram, nav):
                return
            self.avoidances.append(t_s)
            self._manoeuvre = self._new_manoeuvre(datagram, nav)
            self._wait = None
        glanced = self._manoeuvre.glance is not None
        self._manoeuvre.see(datagram, nav, wide)
        if glanced and self._passed(self._manoeuvre, nav):
            # It is beside, and not on the way past: on the way back the camera will face it.
            self._manoeuvre = None
            return
        # What comes straight on is not outrun backwards.
        if self._too_near(datagram, wide) and not self._manoeuvre.oncoming:
            self._manoeuvre.back_off(nav)

    def _waits(self, t_s: float, datagram: dict[str, Any], nav: State) -> bool:
        """Whether it goes on to stand and look before it avoids what a verdict says."""
        if self._wait is None:
            self._wait = Wait(t_s, _stop(nav), nav.heading_rad, [])
        if _at_rest(nav):
            box = datagram.get("box")
            whole = box is not None and box[0] > 0 and box[0] + box[2] < MASK_WIDTH
            self._wait.seen.append(Look(t_s, datagram["x"] or 0, datagram["mean"] or 0.0, whole))
        if self._wait.keeps_its_place(t_s) or self._wait.comes_here():
            return False
        return t_s - self._wait.since_s < WAIT_S

    def _new_manoeuvre(self, datagram: dict[str, Any], nav: State) -> Manoeuvre:
        """A manoeuvre that begins here, beside the way on which the vehicle is."""
        look = self._course(nav)
        # While it still turns to its way, what it sees is beside that, not ahead.
        seen = turn(nav.heading_rad - look) + bearing(-(datagram["x"] or 0))
        # Away from it; the thesis's program goes left where it is right ahead.
        side = 1 if seen < 0 else -1
        oncoming = self._wait is not None and self._wait.comes_here()
        return Manoeuvre(nav.position, look, side, _stopping_m(nav), oncoming)

    def _course(self, nav: State) -> float:
        """The heading that transit goes on: to the goal; close to it, as it is."""
        way = self.goal - nav.position
        # There the bearing turns fast, and means nothing.
        if math.hypot(way[0], way[2]) < 2 * ARRIVED_M:
            return nav.heading_rad
        return math.atan2(way[0], way[2])

    def _is_wide(self, datagram: dict[str, Any]) -> bool:
        """Whether it fills so much of the view that it may go on on either side."""
        _, _, width, _ = datagram.get("box") or (0, 0, 0, 0)
        return width > WIDE_BOX * MASK_WIDTH or (datagram["mean"] or 0.0) > WIDE_MEAN

    def _too_near(self, datagram: dict[str, Any], wide: bool) -> bool:
        distance_m = datagram.get("distance_m")
        least_m = BACK_OFF_WIDE_M if wide else BACK_OFF_DISTANCE_M
        near = wide if distance_m is None else distance_m < least_m
        return near or self._contact_is_near(datagram)

    def _hurries(self, datagram: dict[str, Any], nav: State) -> bool:
        """Whether there is no time to stand and look.

        What is wide may swim on; what is near stays so, where the vehicle stops well before it.
        """
        distance_m = datagram.get("distance_m")
        ahead = float(nav.velocity_body[0]) > AT_REST_M_S
        near = ahead and distance_m is not None and distance_m < HURRY_M
        return near or self._contact_is_near(datagram)

    def _contact_is_near(self, datagram: dict[str, Any]) -> bool:
        # By expansion alone, in frames with few patches: only where it is sure.
        sure = (datagram.get("trend_confidence") or 0.0) >= SURE_TREND
        expansion_s = datagram.get("expansion_contact_s") if sure else None
        contacts = (datagram.get("contact_s"), expansion_s)
        return any(one is not None and one < BACK_OFF_CONTACT_S for one in contacts)

    def _passed(self, manoeuvre: Manoeuvre, nav: State) -> bool:
        """Whether all that is remembered is behind, or the goal is beside."""
        return manoeuvre.place(nav.position)[0] > self._end(manoeuvre) - REACHED_M

    def _end(self, manoeuvre: Manoeuvre) -> float:
        """How far along to go: past what is remembered, and no farther than the goal."""
        return min(manoeuvre.end() + PAST_M, manoeuvre.place(self.goal)[0])

    def _hold(self, t_s: float, nav: State, patient: bool = True) -> Setpoint:
        """On station; one that is not patient goes back the way it came after a while."""
        self._progress.hold()
        if self._held is None:
            self._held = t_s, _stop(nav), nav.heading_rad
        since_s, place, heading = self._held
        steps = 0 if patient else int((t_s - since_s) / PATIENCE_S)
        back = min(steps * RETREAT_M, BACK_OFF_MOST_M)
        ahead = np.array([math.sin(heading), 0.0, math.cos(heading)])
        mode = Mode.BACK_OFF if back else Mode.HOLD
        return Setpoint(place - back * ahead, heading, mode)

    def _piloted(self, t_s: float, nav: State, wanted: F64) -> Setpoint:
        """On station first, then where the pilot steers to.

        What was avoided has to be seen anew.
        """
        self._wait = self._manoeuvre = None
        self._progress = Progress()
        held = self._hold(t_s, nav)
        self._handed_over |= _at_rest(nav)
        if not self._handed_over:
            return held
        self._held = None
        return Setpoint(wanted, nav.heading_rad, Mode.PILOT)

    def _ends(self, nav: State) -> bool:
        """Whether it is near enough to end, on station."""
        if self._end_m is None or float(np.linalg.norm(self.goal - nav.position)) > self._end_m:
            return False
        self.reached = _at_rest(nav)
        return True

    def _unstick(self, t_s: float, nav: State) -> None:
        """Without progress: back off, and try the other side of what may be ahead."""
        if not self._progress.stuck(t_s, float(np.linalg.norm(self.goal - nav.position))):
            return
        side = -1 if self._manoeuvre is None else -self._manoeuvre.side
        self._wait = None
        self.avoidances.append(t_s)
        self._manoeuvre = Manoeuvre(nav.position, self._course(nav), side, 0.0)
        self._manoeuvre.suppose_wall()
        self._manoeuvre.back_off(nav)

    def _transit(self, nav: State) -> Setpoint:
        """To the goal."""
        way = self.goal - nav.position
        self.reached = float(np.linalg.norm(way)) < ARRIVED_M
        return steered(nav, self.goal, Mode.TRANSIT, self._course(nav))

    def _avoid(self, manoeuvre: Manoeuvre, nav: State) -> Setpoint:
        """Back, then beside, then past."""
        along, beside = manoeuvre.place(nav.position)
        if manoeuvre.retreat is not None:
            if along > manoeuvre.retreat[0] + REACHED_M:
                return self._on_manoeuvre(manoeuvre, *manoeuvre.retreat, Mode.BACK_OFF)
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


def steered(nav: State, place: F64, mode: Mode, heading: float | None = None) -> Setpoint:
    """To a place, looking where it goes (or along `heading`): turned first, where that is aside."""
    if heading is None:
        east, _, north = place - nav.position
        heading = math.atan2(east, north)
    off = abs(turn(heading - nav.heading_rad))
    return Setpoint(place, heading, mode, CRUISE_M_S * max(0.0, 1.0 - off / HALF_VIEW))


def _stop(nav: State) -> F64:
    """Where the vehicle comes to rest, about."""
    return np.asarray(nav.position + STOPPING_S * nav.velocity_world, np.float64)


def _at_rest(nav: State) -> bool:
    return float(np.linalg.norm(nav.velocity_body)) < AT_REST_M_S


def _stopping_m(nav: State) -> float:
    """How far ahead the vehicle comes to rest, about; 0 where it goes back."""
    return STOPPING_S * max(float(nav.velocity_body[0]), 0.0)
