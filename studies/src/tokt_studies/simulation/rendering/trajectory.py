"""The vehicle's trajectory in a simulated mission: open water, an approach, a retreat.

Modelled on the mission of 20 April 2016: the tower comes into view 40 % into the dive, is nearest
three quarters into it, and sinks in the picture as the vehicle backs away and rises.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from tokt.features.common.arrays import F64
from tokt_studies.simulation.scene.rig import Camera, SyntheticRig

_TIME = [0.0, 0.35, 0.40, 0.45, 0.60, 0.705, 0.75, 0.785, 0.85, 1.0]
_RANGE_M = [30.0, 15.5, 12.0, 8.4, 5.6, 2.8, 1.92, 2.6, 4.8, 9.5]
_HEADING_DEG = [42.0, 34.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
_HEIGHT_M = [-0.9, -0.8, -0.7, -0.6, -0.55, -0.35, -0.25, -0.2, 0.5, 1.6]
"""By fraction of the dive: distance to the mast, heading off it, height above the collar."""


@dataclass(frozen=True)
class CameraPose:
    """The left camera in tower coordinates, and how far the vehicle moves a second."""

    centre: F64
    rotation: F64
    velocity: F64

    def cameras(self, rig: SyntheticRig) -> tuple[Camera, Camera]:
        """The left and the right camera of `rig` at this pose."""
        return rig.cameras(self.rotation, self.centre)


def draw_trajectory(rng: np.random.Generator, n_frames: int) -> list[CameraPose]:
    """The poses of a dive of `n_frames` frames; sway, heave and turns differ by seed."""
    time = (np.arange(n_frames) + 0.5) / n_frames
    side = rng.choice([-1.0, 1.0])
    distance, heading, height = (
        np.interp(time, _TIME, values) for values in (_RANGE_M, _HEADING_DEG, _HEIGHT_M)
    )
    distance = np.maximum(distance * (1 + 0.02 * sway(rng, time)), 1.90)
    # The same sway fills more of the picture from nearby, where a pilot holds the vehicle stiller.
    looseness = np.clip(distance / 4.0, 0.35, 1.5)
    centres = np.stack(
        [0.18 * looseness * sway(rng, time), -height - 0.08 * sway(rng, time), -distance], axis=1
    )
    turns = np.stack(
        [
            0.6 * sway(rng, time) + 1.5 * (time > 0.8) * (time - 0.8) / 0.2,
            side * heading + 2.0 * sway(rng, time) * np.sqrt(looseness),
            1.2 * sway(rng, time),
        ],
        axis=1,
    )
    drift = rng.normal(0.0, 0.08, (n_frames, 3))
    forward = -np.gradient(distance) if n_frames > 1 else np.zeros(n_frames)
    velocity = drift + np.outer(np.sign(forward) * 0.25, [0, 0, 1])
    return [
        CameraPose(centre, rotation(turn), speed)
        for centre, turn, speed in zip(centres, turns, velocity, strict=True)
    ]


def sway(rng: np.random.Generator, time: F64) -> F64:
    """A slow wave of about unit size: three periods of random length and phase."""
    periods = rng.uniform(0.06, 0.35, 3)
    phases = rng.uniform(0.0, 2 * np.pi, 3)
    waves = np.sin(2 * np.pi * time[:, None] / periods + phases)
    return np.asarray(waves.sum(axis=1) / np.sqrt(1.5))


def rotation(degrees: F64) -> F64:
    """Tower to camera: turned by `degrees` (pitch, heading, roll)."""
    pitch, heading, roll = (
        cv2.Rodrigues(axis * angle)[0]
        for axis, angle in zip(np.eye(3), np.radians(degrees), strict=True)
    )
    return np.asarray(roll @ pitch @ heading, np.float64)
