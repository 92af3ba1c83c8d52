"""Labels of the camera asked for: its own, else those that are carried from the left one."""

import csv

import numpy as np
import pytest

from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.simulation.rendering.patch_labels import MIN_COVERAGE, coverage
from tokt_studies.simulation.rendering.raycast import View
from tokt_studies.simulation.rendering.synthetic_mission import MissionScene

from .conftest import FRAMES

pytestmark = pytest.mark.xdist_group("reproduce")


@pytest.fixture(scope="module")
def right(reproduce_mission, context_of):
    """The rendered mission through its right camera, which has no labels of its own."""
    return context_of(reproduce_mission, camera="right")


def test_left_labels_are_carried_to_a_camera_that_has_none(right):
    """Held against what the right camera's rays meet."""
    scene = MissionScene.draw(1, FRAMES, 360)
    assert right.carried_labels and {one.camera for one in right.labels} == {"right"}
    said = there = clear = 0
    for number, truth in right.labelled.items():
        view = View(scene.poses[number - 1].cameras(scene.rig)[1], scene.tower)
        covered = coverage(np.isfinite(view.image(view.depth)), GRID)
        said += int((truth == 1).sum())
        there += int((covered[truth == 1] >= MIN_COVERAGE).sum())
        clear += int((truth == 0).sum())
        assert (covered[truth == 0] < MIN_COVERAGE).all()
    assert said > 40 and there > 0.8 * said and clear > 400
    assert max(right.obstacle_patches, key=right.obstacle_patches.__getitem__) in range(10, 15)


def test_labels_of_its_own_come_first(reproduce_mission, context_of, tmp_path):
    file = tmp_path / "labels.csv"
    rows = [["mission", "camera", "frame", "row", "col", "label"]]
    rows += [["dive", "left", 12, 4, 4, "other"], ["dive", "right", 9, 3, 2, "other"]]
    with file.open("w", newline="") as text:
        csv.writer(text).writerows(rows)
    context = context_of(reproduce_mission, camera="right", labels=file)
    assert not context.carried_labels and context.obstacle_patches == {9: 1}
    assert context_of(reproduce_mission, labels=file).obstacle_patches == {12: 1}


def test_without_a_calibration_nothing_is_carried_and_that_is_said(reproduce_mission, context_of):
    lines: list[str] = []
    given = {"_cameras": (None, "none was given"), "say": lines.append}
    context = context_of(reproduce_mission, given, camera="right")
    assert not context.labels and not context.carried_labels
    said = "needs a calibration of the two cameras: none was given"
    assert lines == [f"no labels of right frames, nor carried from left ones: {said}"]
