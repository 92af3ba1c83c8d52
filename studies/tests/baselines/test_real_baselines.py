"""The baselines on the real mission: water is water, and the tower is seen where they say."""

import pytest

from tokt.features.frames.mission import open_mission
from tokt.inference.frame import Frame
from tokt.training.fitting.train import rendered_other_image
from tokt_studies.baselines.size_change import SizeChange
from tokt_studies.baselines.slic import SlicTexture
from tokt_studies.baselines.thesis_texture import describe_lbp_10_5

pytestmark = [pytest.mark.xdist_group("baselines"), pytest.mark.mission]

WATER, NEAR = 46, 178
"""Frames: open water, and the tower a few metres away and coming nearer."""


def test_superpixels_and_growing_keypoints(mission_dir):
    mission = open_mission(mission_dir)
    texture = SlicTexture.train(
        mission.read(1), rendered_other_image(), describe_lbp_10_5, "lbp_10_5"
    )

    def grown(number: int) -> float:
        """The mean by keypoints that grew over four frames."""
        method = SizeChange()
        frames = (Frame(n, n / 4, mission.read(n), None) for n in range(number - 4, number + 1))
        *_, last = [method.judge(frame) for frame in frames]
        assert last.verdict.mean is not None
        return last.verdict.mean

    water, near = (texture.mask(mission.read(number)).mean() for number in (WATER, NEAR))
    assert water < 8 < 25 < near
    assert grown(WATER) < 1 < 3 < grown(NEAR)
