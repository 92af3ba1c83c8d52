"""The vehicle: surge, sway, heave and yaw of a light work-class ROV, its thrusters and the current.

Equations of motion: T. I. Fossen, *Handbook of Marine Craft Hydrodynamics and Motion Control*
(Wiley 2011), chapters 6 to 8, for four degrees of freedom with diagonal matrices. With the body's
velocity over ground nu, that of the water seen from it nu_c, and nu_r = nu - nu_c::

    (M_RB + M_A) dnu/dt = tau - C_RB(nu) nu - C_A(nu_r) nu_r - D(nu_r) nu_r + M_A dnu_c/dt

World axes are the synthetic mission's: x east, y down, z north. Heading 0 looks north, positive
turns to the east (clockwise seen from above). So (z, x, y) are Fossen's north, east, down.
"""

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from tokt.features.common.arrays import F64

Axes = tuple[float, float, float, float]
HULL_RADIUS_M = 0.8
"""Of the sphere about the vehicle's centre that must touch nothing: half the length of Minerva
(1.44 m), whose motions these are, and a little more. The SUB-fighter 30k is 2.6 m long and 1.5 m
wide over its frame: the sphere is as wide, and shorter."""
CAMERA_AHEAD_M = 0.5
"""The left camera, ahead of the vehicle's centre."""


class Forces(NamedTuple):
    """Forces of the thrusters, real or asked for: N along surge, sway, heave; N m about yaw."""

    surge: float = 0.0
    sway: float = 0.0
    heave: float = 0.0
    yaw: float = 0.0


@dataclass(frozen=True)
class State:
    """Position and motion of the vehicle's centre over ground."""

    position: F64  # (3,): east, down, north, m
    heading_rad: float  # 0 is north, positive towards east
    velocity_body: F64  # (3,): surge (ahead), sway (to starboard), heave (down), m/s
    yaw_rate: float = 0.0  # rad/s

    @property
    def camera(self) -> F64:
        """(3,) Where the left camera is, in metres."""
        ahead = CAMERA_AHEAD_M * np.array(
            [math.sin(self.heading_rad), 0, math.cos(self.heading_rad)]
        )
        return np.asarray(self.position + ahead, np.float64)

    @property
    def velocity_world(self) -> F64:
        """(3,) Metres a second: east, down, north."""
        surge, sway, heave = self.velocity_body
        sine, cosine = math.sin(self.heading_rad), math.cos(self.heading_rad)
        return np.array([surge * sine + sway * cosine, heave, surge * cosine - sway * sine])


@dataclass(frozen=True)
class VehicleParameters:
    """Masses, drag and thrusters; four numbers are for surge, sway, heave and yaw.

    They are those of NTNU's ROV Minerva, a SUB-fighter 7500: the published model nearest to the
    SUB-fighter 30k, of the same maker and laboratory. Masses and drag: S. M. Mo, *Development of a
    Simulation Platform for ROV Systems* (NTNU 2015), main diagonals. Greatest thrust, by order of
    magnitude: rho n^2 D^4 K_T at 24 revolutions a second with the propellers' D (0.19 and 0.22 m),
    K_T (about 0.25) and losses (0.72 and 0.58) given there. The rise time is assumed.
    """

    mass: Axes = (460.0, 460.0, 460.0, 50.31)  # of the rigid body, in air; kg, and kg m2 of yaw
    added_mass: Axes = (293.0, 302.0, 326.0, 57.0)
    linear_drag: Axes = (29.0, 41.0, 254.0, 45.0)  # N s/m, and N m s of yaw
    quadratic_drag: Axes = (292.0, 584.0, 635.0, 100.0)  # N s2/m2, and N m s2 of yaw
    # What the thrusters can do either way.
    greatest: Forces = field(default=Forces(480.0, 190.0, 390.0, 100.0))
    rise_s: float = 0.8  # seconds from nothing to that: they change no faster

    def drag(self, axis: int, speed: float) -> float:
        """Drag along an axis (0 surge, 1 sway, 2 heave, 3 yaw) at a speed through the water."""
        return (self.linear_drag[axis] + self.quadratic_drag[axis] * abs(speed)) * speed


MINERVA = VehicleParameters()


class Vehicle:
    """One vehicle, `MINERVA`, in one current: the water's velocity east, down and north."""

    def __init__(
        self, start: State, current_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> None:
        self.state = start
        self.applied = Forces()  # what the thrusters do now
        self.current = current_m_s

    @property
    def through_water(self) -> State:
        """The same state, its speeds through the water."""
        east, down, north = self.current
        sine, cosine = math.sin(self.state.heading_rad), math.cos(self.state.heading_rad)
        current = np.array([north * cosine + east * sine, east * cosine - north * sine, down])
        return replace(self.state, velocity_body=self.state.velocity_body - current)

    def step(self, dt_s: float, forces: Forces) -> None:
        """Go on for `dt_s` seconds while the thrusters are asked for `forces` (Runge-Kutta 4)."""
        self.applied = self._thrust(dt_s, forces)
        old = self.state
        y = np.array([*old.position, old.heading_rad, *old.velocity_body, old.yaw_rate])
        k1 = self._rate(y)
        k2 = self._rate(y + dt_s / 2 * k1)
        k3 = self._rate(y + dt_s / 2 * k2)
        k4 = self._rate(y + dt_s * k3)
        y += dt_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self.state = State(y[:3], float(y[3]), y[4:7], float(y[7]))

    def _thrust(self, dt_s: float, asked: Forces) -> Forces:
        """What the thrusters reach in this step of what is asked."""
        now, most = np.array(self.applied), np.array(MINERVA.greatest)
        at_once = most * (dt_s / MINERVA.rise_s)
        change = np.clip(np.clip(asked, -most, most) - now, -at_once, at_once)
        return Forces(*(now + change).tolist())

    def _rate(self, y: F64) -> F64:
        heading, u, v, w, r = y[3:].tolist()
        sine, cosine = math.sin(heading), math.cos(heading)
        east, down, north = self.current
        uc, vc = north * cosine + east * sine, east * cosine - north * sine
        ur, vr, wr = u - uc, v - vc, w - down
        own, tau = MINERVA, self.applied
        m, (a_surge, a_sway, _, _) = own.mass, own.added_mass
        surge = tau.surge - own.drag(0, ur) + m[0] * v * r + a_sway * vr * r + a_surge * r * vc
        sway = tau.sway - own.drag(1, vr) - m[1] * u * r - a_surge * ur * r - a_sway * r * uc
        heave = tau.heave - own.drag(2, wr)
        yaw = tau.yaw - own.drag(3, r) - (a_sway - a_surge) * ur * vr
        force, mass = np.array([surge, sway, heave, yaw]), np.add(m, own.added_mass)
        return np.array([u * sine + v * cosine, w, u * cosine - v * sine, r, *(force / mass)])


def turn(angle: float) -> float:
    """The same angle in -pi..pi."""
    return math.remainder(angle, 2 * math.pi)
