"""The autopilot: setpoints, and the thrusters' forces that bring the vehicle there.

Position error -> velocity over ground -> force, each in the body-fixed frame; the velocity error
is integrated, so that a steady current leaves no offset. As a ship's dynamic positioning works
(Fossen 2011, chapter 12), without an observer: the navigation is taken as it is.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

from tokt.features.common.arrays import F64

from .vehicle import MINERVA, Forces, State, turn

CRUISE_M_S = 0.6
"""Speed of transit."""


class Mode(StrEnum):
    """The planner's mode."""

    TRANSIT = "transit"
    AVOID = "avoid"
    BACK_OFF = "back off"
    HOLD = "hold"
    PILOT = "pilot"


@dataclass(frozen=True)
class Setpoint:
    """The position, heading and speed that the planner asks the autopilot for."""

    position: F64  # (3,), world, m
    heading: float  # rad
    mode: Mode
    speed_m_s: float = CRUISE_M_S  # not to be exceeded on the way


STEP_S = 0.05
"""Of the control loop and of the vehicle's steps: 20 a second."""


# Gains, chosen for the masses and thrusters of `MINERVA`. A metre of position error asks for
# POSITION_GAIN m/s; a metre a second of velocity error for _VELOCITY m/s2, and its integral for
# _INTEGRAL; the same of the heading.
POSITION_GAIN, _VELOCITY, _INTEGRAL = 0.5, 1.2, 0.25
_HEADING, _YAW_RATE, _YAW_INTEGRAL = 0.8, 2.0, 0.4
_MAX_SWAY_M_S = 0.35
"""The fastest it goes sideways, back, up or down."""
_MAX_YAW_RAD_S = 0.35
"""The fastest it turns."""


class Autopilot:
    """Forces for a target, once a control step of `STEP_S`."""

    def __init__(self) -> None:
        self._sums = [0.0, 0.0, 0.0, 0.0]

    def forces(self, state: State, target: Setpoint) -> Forces:
        """Forces to ask of the thrusters now."""
        yaw_rate = _HEADING * turn(target.heading - state.heading_rad)
        yaw_rate = min(max(yaw_rate, -_MAX_YAW_RAD_S), _MAX_YAW_RAD_S)
        wanted = [*self._velocity(state, target), yaw_rate]
        have = [*state.velocity_body.tolist(), state.yaw_rate]
        return Forces(*(self._force(axis, wanted[axis], have[axis]) for axis in range(4)))

    def _velocity(self, state: State, target: Setpoint) -> tuple[float, float, float]:
        """Surge, sway and heave over ground to ask for, m/s."""
        east, down, north = (target.position - state.position).tolist()
        sine, cosine = math.sin(state.heading_rad), math.cos(state.heading_rad)
        surge, sway = north * cosine + east * sine, east * cosine - north * sine
        speed, whole = target.speed_m_s, POSITION_GAIN * math.hypot(surge, sway)
        aside = (POSITION_GAIN * error / _MAX_SWAY_M_S for error in (-surge, abs(sway)))
        # One factor for both: the way stays straight. Depth has its own: over a slope the altitude
        # is held, however far it is to go.
        gain = POSITION_GAIN / max(whole / speed if speed > 0 else math.inf, *aside, 1.0)
        heave = min(max(POSITION_GAIN * down, -_MAX_SWAY_M_S), _MAX_SWAY_M_S)
        return gain * surge, gain * sway, heave

    def _force(self, axis: int, wanted: float, have: float) -> float:
        gain, integral = (_VELOCITY, _INTEGRAL) if axis < 3 else (_YAW_RATE, _YAW_INTEGRAL)
        error = wanted - have
        mass = MINERVA.mass[axis] + MINERVA.added_mass[axis]
        force = MINERVA.drag(axis, wanted) + mass * (gain * error + integral * self._sums[axis])
        # What the thrusters cannot give must not pile up, or it overshoots afterwards.
        if abs(force) < MINERVA.greatest[axis] or force * error < 0:
            self._sums[axis] += error * STEP_S
        return force
