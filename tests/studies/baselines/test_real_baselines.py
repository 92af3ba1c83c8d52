"""The baselines on the real mission: water is water, and the tower is seen where they say."""

from typing import Any

import pytest

from tokt.features.frames.mission import open_mission
from tokt.studies.baselines.size_change import SizeChange
from tokt.studies.baselines.slic import SlicTexture
from tokt.studies.baselines.thesis_texture import describe_lbp_10_5
from tokt.training.fitting.train import rendered_other_image

pytestmark = [pytest.mark.xdist_group("baselines"), pytest.mark.mission]

WATER, NEAR = 46, 178
"""Frames: open water, and the tower a few metres away and coming nearer."""


def test_superpixels_and_growing_keypoints(mission_dir):
    mission = open_mission(mission_dir)
    texture = SlicTexture.train(
        mission.read(1), rendered_other_image(), describe_lbp_10_5, "lbp_10_5"
    )

    def mean(method: Any, number: int, before: int = 0) -> float:
        numbers = range(number - before, number + 1)
        last = [method.judge(mission.read(n), None, n / 4) for n in numbers][-1]
        assert last.verdict.mean is not None
        return last.verdict.mean

    assert mean(texture, WATER) < 8 < 25 < mean(texture, NEAR)
    assert mean(SizeChange(), WATER, before=4) < 1 < 3 < mean(SizeChange(), NEAR, before=4)
