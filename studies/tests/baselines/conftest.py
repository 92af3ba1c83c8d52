"""What the baselines' tests share: a rendered mission, and how well a mask fits the truth."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tokt.features.frames.mission import LEFT, RIGHT, Mission, open_mission
from tokt.inference.frame import Frame
from tokt.inference.verdict import verdict_from_mask
from tokt_studies.baselines import lab_colour, slic
from tokt_studies.baselines.slic import superpixels
from tokt_studies.simulation.rendering.synthetic_mission import simulate_mission

N_FRAMES = 20


class Dive:
    """A rendered mission: water up to frame 8, an approach, and a retreat after frame 15."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.mission: Mission = open_mission(folder)

    def left(self, number: int) -> NDArray[np.uint8]:
        return self.mission.read(number, LEFT)

    def right(self, number: int) -> NDArray[np.uint8]:
        return self.mission.read(number, RIGHT)

    def pair(self, number: int) -> Frame:
        return Frame(number, number / 4, self.left(number), self.right(number))

    def tower(self, number: int) -> NDArray[np.bool_]:
        """Where the tower is in a left frame."""
        return cv2.imread(str(self.folder / "masks" / f"L_{number}.png"), cv2.IMREAD_GRAYSCALE) > 0


@pytest.fixture(scope="session")
def dive(tmp_path_factory):
    """Twenty pairs 360 wide; not to be changed."""
    folder = tmp_path_factory.mktemp("baselines") / "dive"
    simulate_mission(folder, seed=1, n_frames=N_FRAMES, width=360, jobs=1)
    return Dive(folder)


CUTS: dict[bytes, NDArray[np.int64]] = {}
"""Superpixels by picture."""


def cut(picture: NDArray[np.uint8]) -> NDArray[np.int64]:
    key = picture.tobytes()
    if key not in CUTS:
        CUTS[key] = superpixels(picture)
    return CUTS[key]


@pytest.fixture(autouse=True)
def cut_once(monkeypatch):
    """Pictures that several tests cut into superpixels are cut once."""
    for module in (slic, lab_colour):
        monkeypatch.setattr(module, "superpixels", cut)


@pytest.fixture(scope="session")
def finds_tower(dive):
    """Whether masks of open water and of the tower, by frame, are empty and on the tower."""

    def finds(mask_of: Callable[[int], NDArray[np.uint8] | None]) -> bool:
        water, close = mask_of(5), mask_of(15)
        if water is None or close is None or verdict_from_mask(close, "a method").status != 1:
            return False
        tower = dive.tower(15)
        on, off = (close[tower] > 0).mean(), (close[~tower] > 0).mean()
        return bool((water > 0).mean() < 0.02 and on > 0.25 and on > 2 * off)

    return finds
