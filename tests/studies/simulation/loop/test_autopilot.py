"""The autopilot on the vehicle it was made for."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tokt.studies.simulation.loop.autopilot import STEP_S, Autopilot, Mode, Setpoint
from tokt.studies.simulation.loop.vehicle import State, Vehicle


def steer(vehicle: Vehicle, target: Setpoint, seconds: float) -> list[State]:
    autopilot, states = Autopilot(), []
    for _ in range(round(seconds / STEP_S)):
        vehicle.step(STEP_S, autopilot.forces(vehicle.state, target))
        states.append(vehicle.state)
    return states


def start(heading: float = 0.0) -> State:
    return State(np.zeros(3), heading, np.zeros(3))


@pytest.mark.parametrize("heading", [0.0, 2.0, -2.5])
def test_it_keeps_its_station_in_a_current(heading: float) -> None:
    vehicle = Vehicle(start(heading), (0.2, 0.0, 0.1))
    states = steer(vehicle, Setpoint(np.zeros(3), heading, Mode.HOLD), 60.0)
    off = np.array([np.linalg.norm(state.position) for state in states])
    assert off.max() < 0.5
    # The integral leaves no offset: without it, it stays 0.1 m away.
    assert off[-100:].max() < 0.03


def test_it_arrives_without_passing_by_and_no_faster_than_asked() -> None:
    goal = np.array([0.0, 0.5, 10.0])
    states = steer(Vehicle(start()), Setpoint(goal, 0.0, Mode.TRANSIT, 0.6), 60.0)
    assert max(state.position[2] for state in states) < 10.25
    assert states[-1].position == pytest.approx(goal, abs=0.05)
    assert 0.55 < max(state.velocity_body[0] for state in states) < 0.72


def test_it_turns_the_short_way() -> None:
    states = steer(Vehicle(start(3.0)), Setpoint(np.zeros(3), -3.0, Mode.HOLD), 20.0)
    headings = np.array([state.heading_rad for state in states])
    assert headings.min() > 2.9
    assert math.remainder(headings[-1] + 3.0, 2 * math.pi) == pytest.approx(0.0, abs=0.02)


def test_errors_are_taken_in_the_body_fixed_frame() -> None:
    """Looking east, a target in the north is to port: it must sway, not surge."""
    forces = Autopilot().forces(
        start(math.pi / 2), Setpoint(np.array([0, 0, 3.0]), 1.57, Mode.AVOID)
    )
    assert forces.sway < -50 and abs(forces.surge) < 1


def test_a_speed_of_nothing_holds_it() -> None:
    states = steer(Vehicle(start()), Setpoint(np.array([0, 0, 9.0]), 0.0, Mode.TRANSIT, 0.0), 10.0)
    assert np.abs(states[-1].position).max() < 1e-6
