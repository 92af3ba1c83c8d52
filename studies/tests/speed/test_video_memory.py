"""The ceiling of a run's memory with video in, on a small computer."""

import pytest

from tokt.features.frames.mission import open_mission
from tokt_studies.simulation.rendering.synthetic_mission import simulate_mission
from tokt_studies.speed.models import examples_from_two_images, fit_preset_bundle
from tokt_studies.speed.video_memory import FRAMES, can_be_measured, measure_video_memory

CEILING_MB = 110
"""What all processes of a run together may allocate, with preset best and frames of 1360x1024. With
the pages of programs and libraries that are used, 37 MB at most, that is 150 MB."""


@pytest.mark.skipif(not can_be_measured(), reason="Linux, and apt-get install ffmpeg")
def test_a_run_with_video_in_stays_below_the_ceiling(tmp_path):
    simulate_mission(tmp_path / "sea", n_frames=8)
    mission = open_mission(tmp_path / "sea")
    pictures = [mission.read(number) for number in mission.frames()]
    assert pictures[0].shape == (1024, 1360, 3)
    model = fit_preset_bundle("best", examples_from_two_images(mission), pictures[0])
    found = measure_video_memory(model, pictures, tmp_path / "video", FRAMES)
    assert max(found.values()) < CEILING_MB, found
