"""Dives along a pipeline: the same bytes again, faults where the pictures show them."""

import csv
import json

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.calls import refused, succeeds
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import open_mission
from tokt.inference.stereo.calibration import load_calibration
from tokt.inference.stereo.odometry import load_odometry
from tokt.labels.taxonomy import Taxonomy
from tokt_studies.simulation.rendering.pipeline_scene import PipelineScene
from tokt_studies.simulation.rendering.synthetic_mission import simulate_mission
from tokt_studies.simulation.scene.pipeline import plan_faults

N_FRAMES = 94
"""Enough for a fault of each class."""


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    out = tmp_path_factory.mktemp("pipeline") / "dive"
    return out, simulate_mission(
        out, draw=PipelineScene.draw, seed=1, n_frames=N_FRAMES, width=240, jobs=1
    )


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def labels_of(folder):
    labels = {}
    for row in rows(folder / "labels.csv"):
        labels[int(row["frame"]), int(row["row"]), int(row["col"])] = row["label"]
    return labels


def centre(fault):
    return np.array([float(fault[axis]) for axis in ("x_m", "y_m", "z_m")])


def views(folder, fault):
    """Frames that show a fault's centre well inside: their numbers, its places in both cameras."""
    calibration = load_calibration(folder / "calibration.yml")
    for frame, pose in load_odometry(folder / "odometry.csv").items():
        left = pose.rotation.T @ (centre(fault) - pose.position_m)
        right = calibration.R @ left + calibration.T_mm.ravel() / 1000
        places = []
        for matrix, seen in ((calibration.K1, left), (calibration.K2, right)):
            place = matrix @ seen
            places.append(place[:2] / place[2])
        if 1 < left[2] < 3 and all(27 < x < 213 and 27 < y < 153 for x, y in places):
            yield frame, *places


def test_same_seed_same_bytes_whatever_the_jobs(tmp_path):
    one, again = tmp_path / "a" / "dive", tmp_path / "b" / "dive"
    size = {"n_frames": 40, "width": 120}
    simulate_mission(one, draw=PipelineScene.draw, seed=7, jobs=3, **size)
    options = ("--pipeline", "--frames", 40, "--width", 120, "--seed", 7, "--jobs", 1)
    assert "40 stereo pairs of 120x90" in succeeds("simulate", again, *options).out
    found, other = (
        {path.relative_to(out): path.read_bytes() for path in out.rglob("*") if path.is_file()}
        for out in (one, again)
    )
    assert len(found) == 40 * 2 + 6
    assert found == other


def test_readers_of_tokt_read_it(dive):
    out, summary = dive
    assert open_mission(out).cameras == ("left", "right")
    assert load_calibration(out / "calibration.yml").frame_size == (240, 181)
    poses = load_odometry(out / "odometry.csv")
    told = json.loads((out / "scene.json").read_text())["frames"]
    assert list(poses) == [frame["frame"] for frame in told] == list(range(1, N_FRAMES + 1))
    down = [np.degrees(np.arcsin(pose.rotation[1, 2])) for pose in poses.values()]
    assert down == pytest.approx([frame["pitch_deg"] for frame in told], abs=1e-3)
    heights = [-pose.position_m[1] for pose in poses.values()]
    assert heights == pytest.approx([frame["altitude_m"] for frame in told], abs=1e-3)
    assert max(down[:5] + down[-5:]) < -10
    assert min(down[16:-16]) > 50
    names = Taxonomy.load(out / "taxonomy.toml").names
    assert names == ("ocean", "sand", "pipe", "damage", "growth", "net")
    assert set(summary.patches) == {*names, "unsure"}
    assert len({fault["class"] for fault in rows(out / "faults.csv")}) == 3
    assert summary.ocean_frames >= 16
    assert 1.65 < summary.nearest_m < 2  # stereo finds nothing nearer


def test_labels_name_a_fault_where_its_centre_is_seen(dive):
    out, _ = dive
    labels = labels_of(out)
    for fault in rows(out / "faults.csv"):
        seen = list(views(out, fault))
        assert len(seen) >= 3
        for frame, (x, y), _ in seen:
            row, col = int(y // 18), int(x // 24)
            assert labels[frame, row, col] == fault["class"]
            around = [labels[frame, row + i, col + j] for i in (-1, 0, 1) for j in (-1, 0, 1)]
            assert around.count(fault["class"]) >= 3


def test_pictures_show_a_fault_where_its_centre_is(dive):
    """What the left camera shows there, the right one shows at the place that follows."""
    out, _ = dive
    mission = open_mission(out)
    for fault in rows(out / "faults.csv"):
        frame, (x, y), (u, v) = next(iter(views(out, fault)))
        left, right = (
            cv2.cvtColor(mission.read(frame, camera), cv2.COLOR_BGR2GRAY)
            for camera in ("left", "right")
        )
        patch = cv2.getRectSubPix(left, (17, 17), (x, y))
        match = cv2.matchTemplate(
            cv2.getRectSubPix(right, (43, 43), (u, v)), patch, cv2.TM_CCOEFF_NORMED
        )
        _, best, _, place = cv2.minMaxLoc(match)
        assert best > 0.6
        assert np.abs(np.subtract(place, 13)).max() <= 1


def test_begins_and_ends_in_open_water(dive):
    out, _ = dive
    labels = labels_of(out)
    for frame in range(1, N_FRAMES + 1):
        seen = {labels[frame, *divmod(cell, 10)] for cell in range(DEFAULT_GRID.n_patches)}
        from_end = min(frame, N_FRAMES + 1 - frame)
        if from_end <= 8:
            assert seen == {"ocean"}
        elif from_end >= 17:
            assert "ocean" not in seen


@given(st.integers(0, 2**32), st.integers(1, 40), st.floats(0.15, 0.35))
def test_faults_lie_apart_and_off_the_ends(seed, count, half_arc):
    length = 10 + 4.5 * count
    faults = plan_faults(np.random.default_rng(seed), length, count, half_arc)
    along = np.array([fault.along_m for fault in faults])
    assert len(faults) == count
    assert (np.diff(along) >= 3).all()
    assert 5 <= along[0] <= along[-1] <= length - 5
    kinds = [fault.kind for fault in faults]
    assert max(kinds.count(kind) for kind in set(kinds)) <= -(-count // 3)


def test_what_is_no_dive_along_a_pipeline(tmp_path):
    command = ("simulate", tmp_path / "dive", "--pipeline")
    refused("has at least 40 frames, not 39", *command, "--frames", 39)
    refused("--pipeline is for a mission, not for --closed-loop", *command, "--closed-loop")
    assert not list(tmp_path.iterdir())
