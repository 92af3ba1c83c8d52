"""The autopilot: setpoints, and the thrusters' forces that bring the vehicle there.

Position error -> velocity over ground -> force, each in the body-fixed frame; the velocity error
is integrated, so that a steady current leaves no offset. As a ship's dynamic positioning works
(Fossen 2011, chapter 12), without an observer: the navigation is taken as it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from .vehicle import MINERVA, Float, Forces, State, VehicleParameters, turn


class Mode(StrEnum):
    """The planner's mode."""

    TRANSIT = "transit"
    AVOID = "avoid"
    BACK_OFF = "back off"
    HOLD = "hold"


@dataclass(frozen=True)
class Setpoint:
    """The position, heading and speed that the planner asks the autopilot for.

    Parameters
    ----------
    position : (3,) float64
        World, metres.
    heading : float
        Radians.
    mode : Mode
    speed_m_s : float
        Not to be exceeded on the way.
    """

    position: Float
    heading: float
    mode: Mode
    speed_m_s: float = 0.6


STEP_S = 0.05
"""Of the control loop and of the vehicle's steps: 20 a second."""


@dataclass(frozen=True)
class AutopilotSettings:
    """Gains; chosen for the masses and thrusters of `MINERVA`.

    Parameters
    ----------
    position : 1/s
        Speed asked for, a metre of position error.
    velocity : 1/s
        Acceleration asked for, a metre a second of velocity error.
    integral : 1/s2
        The same of its integral.
    heading, yaw_rate, yaw_integral : the same of the heading
    sway_m_s : float
        The fastest it goes sideways, or back.
    yaw_rad_s : float
        The fastest it turns.
    """

    position: float = 0.5
    velocity: float = 1.2
    integral: float = 0.25
    heading: float = 0.8
    yaw_rate: float = 2.0
    yaw_integral: float = 0.4
    sway_m_s: float = 0.35
    yaw_rad_s: float = 0.35


class Autopilot:
    """Forces for a target, once a control step.

    Parameters
    ----------
    settings : AutopilotSettings
    parameters : VehicleParameters
        Of the vehicle it steers.
    dt_s : float
        Time between two calls of `forces`.
    """

    def __init__(
        self,
        settings: AutopilotSettings | None = None,
        parameters: VehicleParameters = MINERVA,
        dt_s: float = STEP_S,
    ) -> None:
        self.settings = settings or AutopilotSettings()
        self.parameters = parameters
        self.dt_s = dt_s
        self._sums = [0.0, 0.0, 0.0, 0.0]

    def forces(self, state: State, target: Setpoint) -> Forces:
        """Forces to ask of the thrusters now."""
        wanted = [*self._velocity(state, target), self._yaw_rate(state, target)]
        have = [*state.velocity_body.tolist(), state.yaw_rate]
        return Forces(*(self._force(axis, wanted[axis], have[axis]) for axis in range(4)))

    def _velocity(self, state: State, target: Setpoint) -> tuple[float, float, float]:
        """Surge, sway and heave over ground to ask for, m/s."""
        own = self.settings
        east, down, north = (target.position - state.position).tolist()
        sine, cosine = math.sin(state.heading_rad), math.cos(state.heading_rad)
        surge, sway = north * cosine + east * sine, east * cosine - north * sine
        # One factor for all: the way stays straight.
        over = max(
            own.position * math.hypot(surge, sway, down) / target.speed_m_s
            if target.speed_m_s > 0
            else math.inf,
            -own.position * surge / own.sway_m_s,
            own.position * abs(sway) / own.sway_m_s,
            own.position * abs(down) / own.sway_m_s,
            1.0,
        )
        gain = own.position / over
        return gain * surge, gain * sway, gain * down

    def _yaw_rate(self, state: State, target: Setpoint) -> float:
        most = self.settings.yaw_rad_s
        error = turn(target.heading - state.heading_rad)
        return min(max(self.settings.heading * error, -most), most)

    def _force(self, axis: int, wanted: float, have: float) -> float:
        own, body = self.settings, self.parameters
        gain, integral = (
            (own.velocity, own.integral) if axis < 3 else (own.yaw_rate, own.yaw_integral)
        )
        error = wanted - have
        mass = body.mass[axis] + body.added_mass[axis]
        most = (body.greatest.surge, body.greatest.sway, body.greatest.heave, body.greatest.yaw)
        force = body.drag(axis, wanted) + mass * (gain * error + integral * self._sums[axis])
        # What the thrusters cannot give must not pile up, or it overshoots afterwards.
        if abs(force) < most[axis] or force * error < 0:
            self._sums[axis] += error * self.dt_s
        return force
