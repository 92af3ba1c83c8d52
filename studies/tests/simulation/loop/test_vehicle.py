"""The vehicle, by what is known of its equations, and the autopilot that steers it."""

import math

import numpy as np
import pytest

from tokt_studies.simulation.loop.autopilot import STEP_S, Autopilot, Mode, Setpoint
from tokt_studies.simulation.loop.vehicle import MINERVA, Forces, State, Vehicle


def at_rest(heading=0.0):
    return State(np.zeros(3), heading, np.zeros(3))


AT_REST = at_rest()


def run(vehicle, seconds, forces, step_s=STEP_S):
    for _ in range(round(seconds / step_s)):
        vehicle.step(step_s, forces)
    return vehicle


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_thrust_and_drag_balance_at_the_speed_that_the_coefficients_give(axis):
    newtons = 120.0
    forces = [Forces(surge=newtons), Forces(sway=newtons), Forces(heave=newtons)][axis]
    linear, quadratic = MINERVA.linear_drag[axis], MINERVA.quadratic_drag[axis]
    expected = (-linear + math.sqrt(linear**2 + 4 * quadratic * newtons)) / (2 * quadratic)
    vehicle = run(Vehicle(AT_REST), 60.0, forces)
    assert vehicle.state.velocity_body[axis] == pytest.approx(expected, rel=1e-3)


def test_it_goes_where_it_looks():
    east = Vehicle(State(np.zeros(3), math.pi / 2, np.zeros(3)))
    x, y, z = run(east, 10.0, Forces(surge=100.0)).state.position
    assert x > 1.0 and abs(y) < 1e-9 and abs(z) < 1e-9
    starboard = run(Vehicle(AT_REST), 10.0, Forces(sway=100.0)).state.position
    assert starboard[0] > 0.5 and abs(starboard[2]) < 1e-9
    turned = run(Vehicle(AT_REST), 2.0, Forces(yaw=20.0)).state
    assert turned.heading_rad > 0.05
    assert turned.camera[0] == pytest.approx(0.5 * math.sin(turned.heading_rad))


def test_what_drifts_goes_with_the_water_however_it_turns():
    """Nothing pushes it: relative to the water it stays at rest, and only the turning dies away."""
    current = (0.3, 0.05, -0.2)
    heading = 0.7
    sine, cosine = math.sin(heading), math.cos(heading)
    surge, sway = current[2] * cosine + current[0] * sine, current[0] * cosine - current[2] * sine
    body = np.array([surge, sway, current[1]])
    vehicle = Vehicle(State(np.zeros(3), heading, body, yaw_rate=0.6), current)
    run(vehicle, 10.0, Forces())
    assert abs(vehicle.state.heading_rad - heading) > 0.2
    assert vehicle.state.velocity_world == pytest.approx(current, abs=1e-6)
    assert vehicle.state.position == pytest.approx(10.0 * np.array(current), abs=1e-5)


def test_thrusters_have_an_end_and_take_their_time():
    vehicle = Vehicle(AT_REST)
    vehicle.step(STEP_S, Forces(surge=1e6))
    assert vehicle.applied.surge == pytest.approx(MINERVA.greatest.surge * STEP_S / MINERVA.rise_s)
    run(vehicle, 2.0, Forces(surge=1e6))
    assert vehicle.applied.surge == MINERVA.greatest.surge
    vehicle.step(STEP_S, Forces(surge=-1e6))
    assert vehicle.applied.surge > 0.9 * MINERVA.greatest.surge


def steer(vehicle, target, seconds):
    autopilot, states = Autopilot(), []
    for _ in range(round(seconds / STEP_S)):
        vehicle.step(STEP_S, autopilot.forces(vehicle.state, target))
        states.append(vehicle.state)
    return states


@pytest.mark.parametrize("heading", [0.0, 2.0, -2.5])
def test_it_keeps_its_station_in_a_current(heading):
    vehicle = Vehicle(at_rest(heading), (0.2, 0.0, 0.1))
    states = steer(vehicle, Setpoint(np.zeros(3), heading, Mode.HOLD), 60.0)
    off = np.array([np.linalg.norm(state.position) for state in states])
    assert off.max() < 0.5
    # The integral leaves no offset: without it, it stays 0.1 m away.
    assert off[-100:].max() < 0.03


def test_it_arrives_without_passing_by_and_no_faster_than_asked():
    goal = np.array([0.0, 0.5, 10.0])
    states = steer(Vehicle(AT_REST), Setpoint(goal, 0.0, Mode.TRANSIT, 0.6), 60.0)
    assert max(state.position[2] for state in states) < 10.25
    assert states[-1].position == pytest.approx(goal, abs=0.05)
    assert 0.55 < max(state.velocity_body[0] for state in states) < 0.72


def test_it_turns_the_short_way():
    states = steer(Vehicle(at_rest(3.0)), Setpoint(np.zeros(3), -3.0, Mode.HOLD), 20.0)
    headings = np.array([state.heading_rad for state in states])
    assert headings.min() > 2.9
    assert math.remainder(headings[-1] + 3.0, 2 * math.pi) == pytest.approx(0.0, abs=0.02)


def test_errors_are_taken_in_the_body_fixed_frame():
    """Looking east, a target in the north is to port: it must sway, not surge."""
    north = Setpoint(np.array([0, 0, 3.0]), 1.57, Mode.AVOID)
    forces = Autopilot().forces(at_rest(math.pi / 2), north)
    assert forces.sway < -50 and abs(forces.surge) < 1
