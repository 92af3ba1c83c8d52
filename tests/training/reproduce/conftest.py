"""What the tests of tokt reproduce's curves, times and report share: one small rendered mission."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from tokt.labels.synthetic.mission import simulate_mission
from tokt.training.reproduce.material import Material, ReproduceRequest

FRAMES = 16
"""Open water to frame 7, the tower from frame 8 on; nearest at 12."""


@pytest.fixture(scope="session")
def reproduce_mission(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rendered mission with labels and calibration; not to be changed."""
    folder = tmp_path_factory.mktemp("reproduce") / "dive"
    simulate_mission(folder, seed=1, n_frames=FRAMES, width=360, jobs=1)
    return folder


@pytest.fixture(scope="session")
def material_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Material]:
    """A material of a mission, in one process and with two frames for slow methods."""

    def make(mission: Path, **asked: object) -> Material:
        asked.setdefault("out", tmp_path_factory.mktemp("reproduced"))
        request = ReproduceRequest(mission, sample=2, jobs=1, **asked)
        return Material(request, lambda line: None, lambda items, total, what: items)

    return make


@pytest.fixture(scope="session")
def reproduced(reproduce_mission: Path, material_of: Callable[..., Material]) -> Material:
    """The rendered mission's material; not to be changed."""
    return material_of(reproduce_mission)
