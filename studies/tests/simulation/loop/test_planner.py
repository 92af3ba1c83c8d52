"""The planner's rules, a datagram at a time."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tokt.inference.outputs.udp import decode
from tokt_studies.simulation.loop.autopilot import Mode
from tokt_studies.simulation.loop.flight import PLANNERS
from tokt_studies.simulation.loop.labview import LabviewPlanner
from tokt_studies.simulation.loop.planner import (
    PATIENCE_S,
    SILENCE_S,
    STEADY_S,
    STUCK_S,
    WAIT_S,
    Planner,
)
from tokt_studies.simulation.loop.scenes import draw_scene
from tokt_studies.simulation.loop.vehicle import State

GOAL = np.array([0.0, 0.0, 20.0])
FRAME_S = 0.25


def state(east=0.0, north=0.0, heading=0.0, surge=0.0):
    return State(np.array([east, 0.0, north]), heading, np.array([surge, 0.0, 0.0]))


def v1(status, x=0, mean=0.0):
    """As it comes over the line from the thesis's format."""
    return decode(f"status : , {status}  ,Xpos : ,{x},  Ypos : , 0 , meanValue : ,{mean}".encode())


def v2(status, x=0, **more):
    return {"v": 2, "status": status, "x": x, "box": None, "mean": 10.0, "distance_m": None} | more


class Talk:
    """A planner, and a clock that goes on by a frame with each datagram."""

    def __init__(self, deaf=False):
        self.planner = Planner(GOAL, deaf)
        self.t_s = 0.0

    def say(self, datagram, nav):
        self.t_s += FRAME_S
        return self.planner.target(self.t_s, nav, datagram)

    def look(self, datagram, nav):
        """The same again and again, at rest, until it has stood and looked."""
        for _ in range(round(WAIT_S / FRAME_S) + 1):
            target = self.say(datagram, nav)
            if target.mode is not Mode.HOLD:
                return target
        raise AssertionError("it waits for ever")


def beside(target, nav):
    """How far to starboard of the vehicle a target is."""
    east, _, north = target.position - nav.position
    return east * math.cos(nav.heading_rad) - north * math.sin(nav.heading_rad)


@pytest.mark.parametrize("say", [v1, v2])
@pytest.mark.parametrize("heading", [0.0, 1.2, -2.0])
@pytest.mark.parametrize("x", [-100, 100])
def test_the_new_waypoint_is_on_the_side_to_steer_to(say, heading, x):
    talk = Talk()
    ahead = np.array([math.sin(heading), 0.0, math.cos(heading)])
    talk.planner.goal = 20.0 * ahead
    nav = state(heading=heading)
    target = talk.look(say(1, x), nav)
    assert target.mode is Mode.AVOID
    off = beside(target, nav)
    # Away from it, by its half width, the hull and what is left free.
    assert 1.5 < abs(off) < 2.5 and np.sign(off) == np.sign(x)
    assert abs((target.position - nav.position) @ ahead) < 0.5


def test_past_the_obstacle_and_not_back_into_it():
    """The obstacle has left the view, every verdict is clear, and it is still beside the hull."""
    talk = Talk()
    talk.look(v2(1, 60, distance_m=4.0), state())
    out = talk.say(v2(0), state(2.6)).position
    assert out[2] < 0.5, "not ahead before some clear verdicts"
    for _ in range(4):
        talk.say(v2(0), state(2.6))
    for north in (0.0, 2.0, 4.0, 6.0):
        target = talk.say(v2(0), state(2.6, north))
        assert target.mode is Mode.AVOID and target.position[0] > 2.0, north
    # Behind it: first a look to where the way back leads, then back.
    glance = talk.say(v2(0), state(2.6, 8.5))
    assert glance.mode is Mode.AVOID and glance.heading < math.radians(-30)
    for _ in range(7):
        target = talk.say(v2(0), state(2.6, 8.5, glance.heading))
    assert target.mode is Mode.TRANSIT and target.position == pytest.approx(GOAL)


@pytest.mark.parametrize("unknown", [v2(-1, None, mean=None), None])
def test_unknown_and_silence_hold_the_station(unknown):
    talk = Talk()
    assert talk.planner.target(0.0, state()).mode is Mode.HOLD, "nothing heard yet"
    assert talk.say(v2(0), state(surge=0.6)).mode is Mode.TRANSIT
    target = talk.say(unknown, state(north=1.0, surge=0.6))
    for _ in range(6):
        target = talk.say(unknown, state(north=1.2))
    assert target.mode is Mode.HOLD
    # Where it comes to rest, not where it is: it must not go back and forth.
    assert target.position[2] == pytest.approx(1.36 if unknown else 1.2, abs=0.01)
    again = talk.say(unknown, state(north=1.4))
    assert again.position == pytest.approx(target.position)
    assert talk.say(v2(0), state(north=1.4)).mode is Mode.TRANSIT


def test_silence_is_not_taken_for_clear_before_its_time_is_up_or_after():
    talk, frames = Talk(), round(SILENCE_S / FRAME_S)
    talk.say(v1(0), state())
    modes = [talk.say(None, state()).mode for _ in range(frames + 2)]
    assert modes == [Mode.TRANSIT] * frames + [Mode.HOLD] * 2


@pytest.mark.parametrize(
    "datagram",
    [
        v1(1, 3, mean=200.0),
        v2(1, 3, distance_m=1.5),
        v2(1, 3, contact_s=2.0),
        v2(1, 3, expansion_contact_s=2.0, trend_confidence=0.9),
        v2(1, 3, box=[0, 60, 360, 100]),
    ],
)
def test_near_or_wide_it_backs_off_straight_first(datagram):
    talk = Talk()
    target = talk.look(datagram, state())
    assert target.mode is Mode.BACK_OFF
    assert target.position == pytest.approx([0.0, 0.0, -3.0]) and target.heading == 0.0
    # While it goes on to be so, farther; but not without end.
    for north in (-1.0, -2.5, -4.0, -5.5, -5.9):
        target = talk.say(datagram, state(north=north))
    assert -6.0 <= target.position[2] < -5.6
    after = talk.say(v2(0), state(north=-6.0))
    assert after.mode is Mode.AVOID
    assert abs(after.position[0]) > 2.0 and after.position[2] == pytest.approx(-6.0, abs=0.3)


def test_what_is_gone_is_forgotten():
    talk = Talk()
    talk.look(v1(1, 5), state())
    modes = [talk.say(v1(0), state()).mode for _ in range(12)]
    assert modes[0] is Mode.AVOID and modes[-1] is Mode.TRANSIT


def test_what_cannot_be_seen_from_here_is_not_forgotten():
    """It has gone sideways: that nothing is seen there says nothing."""
    talk = Talk()
    talk.look(v1(1, 5), state())
    for _ in range(40):
        target = talk.say(v1(0), state(2.6))
    assert target.mode is Mode.AVOID


def test_it_stands_and_looks_first_and_avoids_what_stays():
    talk = Talk()
    moving = talk.say(v1(1, 40), state(surge=0.6))
    assert moving.mode is Mode.HOLD and moving.position[2] == pytest.approx(0.36)
    looked = [talk.say(v1(1, 40 + 5 * (n % 2)), state()).mode for n in range(20)]
    still = round(STEADY_S / FRAME_S)
    assert looked[:still] == [Mode.HOLD] * still and Mode.AVOID in looked[still : still + 2]
    assert len(talk.planner.avoidances) == 1


def test_what_moves_across_is_waited_for_and_then_it_goes_on():
    talk = Talk()
    for x in range(-160, 160, 8):
        assert talk.say(v1(1, x), state()).mode is Mode.HOLD, x
    modes = [talk.say(v1(0), state()).mode for _ in range(5)]
    assert modes[-1] is Mode.TRANSIT and not talk.planner.avoidances


def test_what_is_unknown_between_does_not_count_as_seen_to_stay():
    talk = Talk()
    talk.say(v2(1, 5), state())
    for _ in range(round(STEADY_S / FRAME_S) + 2):
        talk.say(v2(-1, None, mean=None), state())
    assert talk.say(v2(1, 5), state()).mode is Mode.HOLD


def test_what_grows_comes_here_and_is_not_backed_off_from():
    talk = Talk()
    for n in range(20):
        # Slowly to the side, too: no place is kept.
        said = v2(1, 5 + 6 * n, mean=40.0 + 8 * n, box=[100, 60, 120, 100])
        target = talk.say(said, state())
        if target.mode is not Mode.HOLD:
            break
    assert n < 12
    for _ in range(3):
        target = talk.say(v2(1, 80, mean=150.0, box=[60, 60, 220, 200]), state())
    assert target.mode is Mode.AVOID and abs(target.position[0]) > 4.0
    standing = Talk()
    assert standing.look(v2(1, 5, mean=90.0), state()).mode is Mode.BACK_OFF


def test_near_and_on_its_way_it_does_not_stop_to_look():
    assert Talk().say(v2(1, 3, distance_m=1.2), state(surge=0.6)).mode is Mode.BACK_OFF
    assert Talk().say(v2(1, 3, distance_m=1.9), state(surge=0.6)).mode is Mode.HOLD


def test_what_stays_unknown_is_left_the_way_it_came():
    talk = Talk()
    talk.say(v2(0), state())
    unknown, north, modes = v2(-1, None, mean=None), 0.0, []
    for _ in range(round(5 * PATIENCE_S / FRAME_S)):
        target = talk.say(unknown, state(north=north))
        north += 0.2 * (target.position[2] - north)
        modes.append(target.mode)
    still = round(PATIENCE_S / FRAME_S)
    assert modes[: still - 1] == [Mode.HOLD] * (still - 1) and modes[still + 1] is Mode.BACK_OFF
    assert -6.0 <= north < -5.5, "step by step, not without end"
    # Silence is no reason to move: nobody looks.
    silent = Talk()
    modes = {silent.say(None, state()).mode for _ in range(round(3 * PATIENCE_S / FRAME_S))}
    assert modes == {Mode.HOLD}


def test_stuck_it_backs_off_and_tries_the_other_side():
    talk = Talk()
    first = talk.look(v1(1, 40), state())
    assert first.mode is Mode.AVOID and first.position[0] > 0
    for _ in range(round(STUCK_S / FRAME_S)):
        target = talk.say(v1(1, 40), state(2.0))
    assert target.mode is Mode.BACK_OFF and len(talk.planner.avoidances) == 2
    after = talk.say(v1(0), state(2.0, north=-3.0))
    assert after.mode is Mode.AVOID and after.position[0] < 0
    # On station time does not count.
    held = Talk()
    for _ in range(round(2 * STUCK_S / FRAME_S)):
        held.say(v2(-1, None, mean=None), state())
    assert held.say(v2(0), state()).mode is Mode.TRANSIT and not held.planner.avoidances


def test_the_pilot_takes_over_from_a_vehicle_on_station_and_gives_it_back_so():
    talk, wanted = Talk(), np.array([0.0, -0.5, -2.0])
    talk.say(v2(0), state(surge=0.6))

    def piloted(surge):
        talk.t_s += FRAME_S
        return talk.planner.target(talk.t_s, state(surge=surge), v2(1, 5), wanted)

    assert piloted(0.6).mode is piloted(0.2).mode is Mode.HOLD
    flown = piloted(0.05)
    assert flown.mode is Mode.PILOT and flown.position == pytest.approx(wanted)
    assert piloted(0.4).mode is Mode.PILOT, "he moves it now"
    # His time over: on station until a frame of after that is known.
    assert talk.say(None, state(north=-2.0, surge=-0.3)).mode is Mode.HOLD
    assert talk.say(v2(0), state(north=-2.0)).mode is Mode.TRANSIT


@pytest.mark.parametrize("x", [-50, 50])
def test_the_thesis_s_rule_goes_to_a_waypoint_ahead_and_aside(x):
    planner = LabviewPlanner(GOAL)
    nav = state(heading=0.6)
    target = planner.target(0.0, nav, v1(1, x))
    off = np.array([3.0, math.copysign(3.0, x)])
    sine, cosine = math.sin(0.6), math.cos(0.6)
    place = [off[0] * sine + off[1] * cosine, 0.0, off[0] * cosine - off[1] * sine]
    assert target.mode is Mode.AVOID and target.position == pytest.approx(place)
    # Out of view: the goal again, whatever is beside it.
    assert planner.target(0.25, nav, v1(0)).mode is Mode.TRANSIT


def test_or_it_avoids_for_a_time():
    planner = LabviewPlanner(GOAL, avoid_s=10.0)
    planner.target(0.0, state(), v1(1, 50))
    modes = [planner.target(0.25 * n, state(), v1(0)).mode for n in range(1, 44)]
    assert modes == [Mode.AVOID] * 40 + [Mode.TRANSIT] * 3


@pytest.mark.parametrize("x", [-50, 50])
@pytest.mark.parametrize("seed", [1001, 1002])
@pytest.mark.parametrize("seen_m", [-6.3, -10.4])
def test_the_fault_at_sea_puts_the_waypoint_behind_the_vehicle_or_the_obstacle(seen_m, seed, x):
    scene = draw_scene("tower", seed, 360)
    tower = scene.world.things[0].at
    nav = state(north=seen_m)
    target = PLANNERS["sea-trial"](scene).target(0.0, nav, v1(1, x))
    east, _, north = target.position - nav.position
    assert target.mode is Mode.AVOID
    if seed % 2 == 0:
        assert north < -2.0 and east * x < 0, "behind the vehicle"
        return
    to_east, _, to_north = tower - nav.position
    # The tower's feet reach 0.85 m, and the hull 0.8: it does not pass beside it on the way there.
    assert math.hypot(east, north) > math.hypot(to_east, to_north) + 0.85, "beyond the tower"
    assert abs(to_east * north - to_north * east) / math.hypot(east, north) < 0.8 + 0.85


@pytest.mark.parametrize("name", [*PLANNERS, "none"])
def test_each_planner_ends_on_station_within_metres_of_the_structure(name):
    scene = replace(draw_scene("empty", 1001, 360), goal=GOAL, end_m=5.0)
    planner = Planner(GOAL, True, 5.0) if name == "none" else PLANNERS[name](scene)
    assert planner.target(0.0, state(surge=0.6), v2(0)).mode is Mode.TRANSIT
    assert planner.target(0.25, state(north=15.2, surge=0.6), v2(1, 50)).mode is Mode.HOLD
    assert not planner.reached, "not at rest yet"
    assert planner.target(0.5, state(north=15.5), v2(0)).mode is Mode.HOLD and planner.reached


def test_clear_goes_to_the_goal_and_arrives():
    talk = Talk()
    target = talk.say(v1(0), state())
    assert target.mode is Mode.TRANSIT and target.position == pytest.approx(GOAL)
    assert target.heading == 0.0 and target.speed_m_s == 0.6
    assert not talk.planner.reached
    talk.say(v1(0), state(north=19.7))
    assert talk.planner.reached


def test_it_stays_on_its_side_whatever_x_says_next():
    talk = Talk()
    first = talk.look(v1(1, -40), state())
    assert beside(first, state()) < -1.5
    for x in (40, 0, 150):
        assert beside(talk.say(v1(1, x), state(-0.2)), state(-0.2)) < -1.0


def test_while_the_status_is_1_the_waypoint_moves_on():
    """Of an obstacle that goes on to the side, each verdict sets it farther out."""
    talk = Talk()
    offs = [talk.look(v1(1, -20), state(-east)).position[0] for east in (0.0, 1.0, 2.0)]
    assert offs[0] - 0.9 > offs[1] and offs[1] - 0.9 > offs[2]


def test_what_the_glance_finds_is_passed_too():
    talk = Talk()
    talk.look(v2(1, 60, distance_m=4.0), state())
    for _ in range(4):
        talk.say(v2(0), state(2.6))
    glance = talk.say(v2(0), state(2.6, 8.5))
    target = talk.say(v2(1, 0, distance_m=3.0), state(2.6, 8.5, glance.heading))
    target = talk.say(v2(0), state(2.6, 8.6, glance.heading))
    assert target.mode is Mode.AVOID
    for _ in range(4):
        target = talk.say(v2(0), state(2.6, 8.6, 0.0))
    assert target.position[2] > 11.0 and target.heading == 0.0


def test_an_unsure_expansion_is_no_reason_to_back_off():
    for unsure in (0.3, None):
        said = v2(1, 3, expansion_contact_s=2.0, trend_confidence=unsure)
        assert Talk().look(said, state()).mode is Mode.AVOID


def test_a_wide_obstacle_that_is_far_is_gone_around_from_here():
    target = Talk().look(v2(1, 3, mean=200.0, distance_m=8.0), state())
    assert target.mode is Mode.AVOID and abs(target.position[0]) > 4.0


def test_what_goes_on_to_move_is_avoided_in_the_end():
    talk = Talk()
    for n in range(round(WAIT_S / FRAME_S) + 2):
        target = talk.say(v1(1, 100 * (-1) ** n), state())
    assert target.mode is Mode.AVOID


def test_it_ends_on_station_within_metres_of_the_structure():
    planner = Planner(GOAL, end_m=5.0)
    assert planner.target(0.0, state(), v2(0)).mode is Mode.TRANSIT and not planner.reached
    near = planner.target(0.25, state(north=15.2, surge=0.6), v2(0))
    assert near.mode is Mode.HOLD and not planner.reached, "not at rest yet"
    assert near.position[2] == pytest.approx(15.56)
    planner.target(0.5, state(north=15.5), v2(0))
    assert planner.reached
