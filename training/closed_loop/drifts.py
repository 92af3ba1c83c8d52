"""Open water from a vehicle that goes, slips sideways and hovers: what a model must not alarm at.

In the missions of `tokt simulate` each frame has snow of its own. Seen four times a second from a
vehicle that hardly moves, a flake stays in one patch for several frames, which a frame rule takes
for something that is there. A model learns that from sequences like the closed loop's.
"""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np

from ...features.grid import DEFAULT_GRID
from ...labels.synthetic.eyes import Eyes
from ...labels.synthetic.patch_labels import OCEAN
from ...labels.synthetic.rig import Rig
from ...labels.synthetic.water import Water
from ...labels.synthetic.world import World
from .autopilot import STEP_S
from .loop import STEPS_A_FRAME

WAYS_M_S = ((0.0, 0.0, 0.6), (0.35, 0.0, 0.0), (0.02, 0.01, 0.02), (-0.1, 0.0, 0.2))
"""Velocities east, down and north, one after the other: transit, sideways, hovering, in between."""
_TURN_RAD_S = 0.02


def write_drift(folder: Path, seed: int, frames: int, width: int) -> None:
    """Render one sequence as a mission of left frames, all of its patches labelled ocean.

    Parameters
    ----------
    folder : Path
        To make; its name is the mission's.
    seed : int
        Of water, rig, snow and noise.
    frames : int
    width : int
        In pixels.
    """
    water, rig = (np.random.default_rng([seed, part]) for part in range(2))
    eyes = Eyes(World(Water.draw(water), seed=seed), Rig.draw(rig, width), seed)
    (folder / "Left").mkdir(parents=True)
    place, step_s = np.zeros(3), STEP_S * STEPS_A_FRAME
    for index in range(frames):
        velocity = np.array(WAYS_M_S[index * len(WAYS_M_S) // frames])
        t_s = index * step_s
        frame = eyes.left(t_s, place, _TURN_RAD_S * t_s, velocity)
        cv2.imwrite(str(folder / "Left" / f"drift_L_{index + 1}.png"), frame)
        place = place + step_s * velocity
    with (folder / "labels.csv").open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle, lineterminator="\n")
        writer.writerow(["mission", "camera", "frame", "row", "col", "label"])
        for number in range(1, frames + 1):
            for cell in range(DEFAULT_GRID.n_patches):
                writer.writerow(
                    [folder.name, "left", number, *divmod(cell, DEFAULT_GRID.cols), OCEAN]
                )
