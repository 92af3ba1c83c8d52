"""The planner's rules, a datagram at a time."""

import math

import numpy as np
import pytest

from tokt.inference.outputs.udp import decode
from tokt.studies.simulation.loop.autopilot import Mode
from tokt.studies.simulation.loop.planner import SILENCE_S, Planner
from tokt.studies.simulation.loop.vehicle import State

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


def beside(target, nav):
    """How far to starboard of the vehicle a target is."""
    east, _, north = target.position - nav.position
    return east * math.cos(nav.heading_rad) - north * math.sin(nav.heading_rad)


def test_clear_goes_to_the_goal_and_arrives():
    talk = Talk()
    target = talk.say(v1(0), state())
    assert target.mode is Mode.TRANSIT and target.position == pytest.approx(GOAL)
    assert target.heading == 0.0 and target.speed_m_s == 0.6
    assert not talk.planner.reached
    talk.say(v1(0), state(north=19.7))
    assert talk.planner.reached


@pytest.mark.parametrize("say", [v1, v2])
@pytest.mark.parametrize("heading", [0.0, 1.2, -2.0])
@pytest.mark.parametrize("x", [-100, 100])
def test_the_new_waypoint_is_on_the_side_to_steer_to(say, heading, x):
    talk = Talk()
    ahead = np.array([math.sin(heading), 0.0, math.cos(heading)])
    talk.planner.goal = 20.0 * ahead
    nav = state(heading=heading)
    target = talk.say(say(1, x), nav)
    assert target.mode is Mode.AVOID
    off = beside(target, nav)
    # Away from it, by its half width, the hull and what is left free.
    assert 1.5 < abs(off) < 2.5 and np.sign(off) == np.sign(x)
    assert abs((target.position - nav.position) @ ahead) < 0.5


def test_it_stays_on_its_side_whatever_x_says_next():
    talk = Talk()
    first = talk.say(v1(1, -40), state())
    assert beside(first, state()) < -1.5
    for x in (40, 0, 150):
        assert beside(talk.say(v1(1, x), state(-0.2)), state(-0.2)) < -1.0


def test_while_the_status_is_1_the_waypoint_moves_on():
    """Of an obstacle that goes on to the side, each verdict sets it farther out."""
    talk = Talk()
    offs = [talk.say(v1(1, -20), state(-east)).position[0] for east in (0.0, 1.0, 2.0)]
    assert offs[0] - 0.9 > offs[1] and offs[1] - 0.9 > offs[2]


def test_past_the_obstacle_and_not_back_into_it():
    """The obstacle has left the view, every verdict is clear, and it is still beside the hull."""
    talk = Talk()
    talk.say(v2(1, 60, distance_m=4.0), state())
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


def test_what_the_glance_finds_is_passed_too():
    talk = Talk()
    talk.say(v2(1, 60, distance_m=4.0), state())
    for _ in range(4):
        talk.say(v2(0), state(2.6))
    glance = talk.say(v2(0), state(2.6, 8.5))
    target = talk.say(v2(1, 0, distance_m=3.0), state(2.6, 8.5, glance.heading))
    target = talk.say(v2(0), state(2.6, 8.6, glance.heading))
    assert target.mode is Mode.AVOID
    for _ in range(4):
        target = talk.say(v2(0), state(2.6, 8.6, 0.0))
    assert target.position[2] > 11.0 and target.heading == 0.0


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
    target = talk.say(datagram, state())
    assert target.mode is Mode.BACK_OFF
    assert target.position == pytest.approx([0.0, 0.0, -3.0]) and target.heading == 0.0
    # While it goes on to be so, farther; but not without end.
    for north in (-1.0, -2.5, -4.0, -5.5, -5.9):
        target = talk.say(datagram, state(north=north))
    assert -6.0 <= target.position[2] < -5.6
    after = talk.say(v2(0), state(north=-6.0))
    assert after.mode is Mode.AVOID
    assert abs(after.position[0]) > 2.0 and after.position[2] == pytest.approx(-6.0, abs=0.3)


def test_an_unsure_expansion_is_no_reason_to_back_off():
    for unsure in (0.3, None):
        said = v2(1, 3, expansion_contact_s=2.0, trend_confidence=unsure)
        assert Talk().say(said, state()).mode is Mode.AVOID


def test_a_wide_obstacle_that_is_far_is_gone_around_from_here():
    target = Talk().say(v2(1, 3, mean=200.0, distance_m=8.0), state())
    assert target.mode is Mode.AVOID and abs(target.position[0]) > 4.0


def test_what_is_gone_is_forgotten():
    talk = Talk()
    talk.say(v1(1, 5), state())
    modes = [talk.say(v1(0), state()).mode for _ in range(12)]
    assert modes[0] is Mode.AVOID and modes[-1] is Mode.TRANSIT


def test_what_cannot_be_seen_from_here_is_not_forgotten():
    """It has gone sideways: that nothing is seen there says nothing."""
    talk = Talk()
    talk.say(v1(1, 5), state())
    for _ in range(40):
        target = talk.say(v1(0), state(2.6))
    assert target.mode is Mode.AVOID


def test_the_control_hears_nothing():
    talk = Talk(deaf=True)
    assert talk.planner.target(0.0, state()).mode is Mode.TRANSIT
    assert talk.say(v1(1, 50, 200.0), state()).mode is Mode.TRANSIT
