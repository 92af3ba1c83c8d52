"""Synthetic missions: the same bytes again, truth by construction, likeness to the real one."""

import csv
import hashlib
import json
import os
import signal
import subprocess
import sys
from collections import defaultdict
from dataclasses import asdict

import cv2
import numpy as np
import pytest

from tests.calls import refuses
from tests.waiting import MAX_S, until
from tokt.features.common.atomic import remove_partials
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import open_mission
from tokt_studies.simulation.rendering.patch_labels import (
    MIN_CONTRAST,
    MIN_COVERAGE,
    contrast,
    coverage,
    patch_labels,
)
from tokt_studies.simulation.rendering.raycast import View
from tokt_studies.simulation.rendering.synthetic_mission import MissionScene, simulate_mission
from tokt_studies.simulation.scene.rig import Camera
from tokt_studies.simulation.scene.tower import NO_STALKS, WHITE, Cuboid, Frustum, Tower

N_FRAMES = 24


@pytest.fixture(scope="module")
def mission(tmp_path_factory):
    out = tmp_path_factory.mktemp("synthetic") / "dive"
    return out, simulate_mission(out, seed=1, n_frames=N_FRAMES, width=340, jobs=1)


@pytest.fixture(scope="module")
def short_missions(mission, tmp_path_factory):
    folders = {seed: tmp_path_factory.mktemp(f"seed-{seed}") for seed in (2, 3, 4, 5, 6)}
    for seed, folder in folders.items():
        simulate_mission(folder, seed=seed, n_frames=20, width=360, jobs=1)
    return [mission[0], *folders.values()]


def fingerprints(folder):
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


def read_labels(folder):
    labels = defaultdict(lambda: [None] * DEFAULT_GRID.n_patches)
    with (folder / "labels.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            assert (row["mission"], row["camera"]) == (folder.name, "left")
            labels[int(row["frame"])][int(row["row"]) * 10 + int(row["col"])] = row["label"]
    return dict(labels)


def read_depth_m(folder, frame):
    return cv2.imread(str(folder / "depth" / f"L_{frame}.png"), cv2.IMREAD_UNCHANGED) / 1000


def read_mask(folder, frame):
    return cv2.imread(str(folder / "masks" / f"L_{frame}.png"), cv2.IMREAD_UNCHANGED)


def nearest_frame(folder):
    frames = json.loads((folder / "scene.json").read_text())["frames"]
    return min((f for f in frames if f["nearest_m"]), key=lambda f: f["nearest_m"])["frame"]


def test_same_seed_same_bytes_whatever_the_jobs(tmp_path):
    folders = tmp_path / "a" / "dive", tmp_path / "b" / "dive", tmp_path / "c" / "dive"
    for folder, seed, jobs in zip(folders, (7, 7, 8), (1, 3, 1), strict=True):
        simulate_mission(folder, seed=seed, n_frames=5, width=160, jobs=jobs)
    first, again, other = (fingerprints(folder) for folder in folders)
    assert len(first) == 5 * 4 + 3
    assert first == again
    assert other.keys() == first.keys()
    same = {name for name in first if first[name] == other[name]}
    assert not {name for name in same if name.endswith((".jpg", ".yml", "scene.json"))}


def test_story_has_ocean_and_obstacles_everywhere_it_should(mission):
    out, summary = mission
    labels = read_labels(out)
    assert list(labels) == list(range(1, N_FRAMES + 1))
    assert summary.ocean_frames >= 0.3 * N_FRAMES
    assert summary.obstacle_frames >= 0.3 * N_FRAMES
    assert 1.6 < summary.nearest_m < 2.1
    quarter = N_FRAMES // 4
    for start in range(quarter, N_FRAMES, quarter):
        seen = {label for frame in range(start, start + quarter) for label in labels[frame + 1]}
        assert seen >= {"ocean", "subsea_installation"}
    assert summary.obstacle_frames == sum("subsea_installation" in v for v in labels.values())
    assert sum(summary.patches.values()) == 100 * N_FRAMES


def test_labels_follow_from_the_masks(mission):
    out, _ = mission
    labels = read_labels(out)
    for frame in range(1, N_FRAMES + 1):
        mask = read_mask(out, frame)
        assert set(np.unique(mask)) <= {0, 255}
        assert np.array_equal(mask > 0, read_depth_m(out, frame) > 0)
        covered = coverage(mask > 0, DEFAULT_GRID)
        for share, label in zip(covered, labels[frame], strict=True):
            if share == 0:
                assert label == "ocean"
            elif share < MIN_COVERAGE:
                assert label == "unsure"
            else:
                assert label in ("subsea_installation", "unsure")
    # Nearby nothing is too faint: there, coverage alone decides.
    near = nearest_frame(out)
    covered = coverage(read_mask(out, near) > 0, DEFAULT_GRID)
    sure = [label == "subsea_installation" for label in labels[near]]
    assert np.mean(sure == (covered >= MIN_COVERAGE)) >= 0.98


def test_coverage_is_the_share_of_a_patch():
    mask = np.zeros((271, 360), bool)
    mask[27:54, 36:54] = True
    mask[270:] = True  # the strip below the last patch belongs to none
    covered = coverage(mask, DEFAULT_GRID)
    assert covered[11] == pytest.approx(0.5)
    assert covered.sum() == pytest.approx(0.5)


def test_a_faint_or_small_part_of_the_tower_is_unsure():
    mask = np.zeros((271, 360), bool)
    mask[:27, :108] = True
    water = np.full((271, 360, 3), 20, np.float32)
    lit = water.copy()
    lit[:27, :36] += 5
    lit[:27, 36:72] += MIN_CONTRAST / 2
    lit[:27, 72:108] -= 5  # darker than the water is seen just as well
    lit[200:] += 50  # light where the tower is not says nothing
    seen = contrast(lit, water, mask, DEFAULT_GRID)
    assert seen[:4] == pytest.approx([5, MIN_CONTRAST / 2, 5, 0], abs=1e-3)
    assert not seen[3:].any()
    covered = np.array([1, 1, MIN_COVERAGE, MIN_COVERAGE / 2, 0])
    tower, unsure = "subsea_installation", "unsure"
    labels = patch_labels(covered, np.array([5, MIN_CONTRAST / 2, 5, 5, 0]))
    assert labels == [tower, unsure, tower, unsure, "ocean"]


def test_depth_of_a_cylinder_and_a_box_is_that_of_geometry():
    nothing = (np.zeros((1024, 1024, 2), np.float32),)
    matrix = np.array([[200.0, 0, 50], [0, 200.0, 40], [0, 0, 1]])
    camera = Camera(matrix, np.eye(3), np.array([0.0, 0.0, -3.0]), 101, 81)
    up, down = np.array([0.0, -0.4, 0.0]), np.array([0.0, 0.4, 0.0])
    pole = View(camera, Tower((Frustum(up, down, 0.25, 0.25, WHITE),), NO_STALKS, nothing))
    depth = pole.image(pole.depth)
    assert depth[40, 50] == pytest.approx(2.75)
    # Silhouette: tan of the tangent's angle is r / sqrt(d^2 - r^2), here 0.0836 or 16.7 px.
    assert np.flatnonzero(np.isfinite(depth[40])).tolist() == list(range(50 - 16, 50 + 17))
    # The nearest point of the upper end is at depth 2.75, 0.4 m up: 29.1 px.
    assert np.flatnonzero(np.isfinite(depth[:, 50])).tolist() == list(range(40 - 29, 40 + 30))
    cube = Cuboid(np.zeros(3), np.eye(3), np.array([0.3, 0.2, 0.5]), WHITE)
    box = View(camera, Tower((cube,), NO_STALKS, nothing))
    depth = box.image(box.depth)
    assert depth[np.isfinite(depth)] == pytest.approx(2.5)
    assert np.isfinite(depth).sum() == (2 * 24 + 1) * (2 * 16 + 1)


def test_both_cameras_see_the_same_tower_at_the_depth_written(tmp_path):
    """Warp the right frame onto the left by depth and calibration; texture must match."""
    out = tmp_path / "dive"
    simulate_mission(out, seed=3, n_frames=2, width=1020)  # open water, and the tower near
    frame = nearest_frame(out)
    storage = cv2.FileStorage(str(out / "calibration.yml"), cv2.FILE_STORAGE_READ)
    k1, d1, k2, d2, rotation, shift_mm, r1, r2 = (
        storage.getNode(key).mat() for key in ("K1", "D1", "K2", "D2", "R", "T_mm", "R1", "R2")
    )
    assert not d1.any() and not d2.any()
    assert np.linalg.norm(shift_mm) == pytest.approx(305.5, abs=0.1)
    assert np.allclose(r1 @ rotation.T @ r2.T, np.eye(3), atol=1e-6)
    depth = read_depth_m(out, frame)
    files = (out / side / f"sim_{side[0]}_{frame}.jpg" for side in ("Left", "Right"))
    left, right = (cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files)
    v, u = np.nonzero(depth)
    points = (np.linalg.inv(k1) @ np.stack([u, v, np.ones(len(u))])) * depth[v, u]
    seen = k2 @ (rotation @ points + shift_mm.reshape(3, 1) / 1000)
    x, y = (seen[:2] / seen[2]).astype(np.float32)

    def likeness(dx):
        maps = np.full(depth.shape, -1, np.float32), np.full(depth.shape, -1, np.float32)
        maps[0][v, u], maps[1][v, u] = x + dx, y
        warped = cv2.remap(right, *maps, cv2.INTER_LINEAR)
        solid = cv2.erode((depth > 0).astype(np.uint8), np.ones((15, 15))) > 0
        solid &= (maps[0] >= 0) & (maps[0] < depth.shape[1] - 1) & (maps[1] >= 0)
        solid &= (maps[1] < depth.shape[0] - 1) & (left < 250) & (warped < 250)
        images = (left.astype(np.float32), warped.astype(np.float32))
        fine = [image - cv2.GaussianBlur(image, (0, 0), 12) for image in images]
        assert solid.sum() > 20_000
        return np.corrcoef(fine[0][solid], fine[1][solid])[0, 1]

    there = likeness(0)
    assert there > 0.7
    assert likeness(11) < there - 0.3
    assert likeness(-11) < there - 0.3


def test_grey_levels_on_the_grid_do_not_depend_on_the_width(mission, tmp_path):
    wide, small = MissionScene.draw(1, N_FRAMES, 680), patch_deviations(mission[0], every=4)
    for part in ("Left", "Right", "masks", "depth"):
        (tmp_path / part).mkdir()
    for frame in range(1, N_FRAMES + 1, 4):  # water, far, near
        wide.render(tmp_path, frame)
    large = patch_deviations(tmp_path)
    for share in (0.05, 0.5, 0.9):
        assert np.quantile(small, share) == pytest.approx(np.quantile(large, share), rel=0.1)


def test_refuses_what_is_there_and_what_cannot_be(tmp_path):
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "notes.txt").write_text("mine")
    refuses("not empty", simulate_mission, taken, n_frames=1, width=160)
    refuses("is a file", simulate_mission, taken / "notes.txt", n_frames=1, width=160)
    assert [path.name for path in taken.iterdir()] == ["notes.txt"]
    for bad in ({"n_frames": 0}, {"width": 5000}, {"width": 40}, {"seed": -1}, {"jobs": 0}):
        refuses("", simulate_mission, tmp_path / "new", **bad)
    assert not (tmp_path / "new").exists()


def test_killed_half_way_leaves_no_mission(tmp_path):
    out = tmp_path / "dive"
    code = (
        "import sys; from pathlib import Path\n"
        "from tokt_studies.simulation.rendering.synthetic_mission import simulate_mission\n"
        "simulate_mission(Path(sys.argv[1]), n_frames=2000, width=160, jobs=1)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(out)])

    begun = ".partial-*/Left/sim_L_5.jpg"
    until(lambda: process.poll() is not None or list(tmp_path.glob(begun)))
    assert process.poll() is None
    process.send_signal(signal.SIGKILL if os.name != "nt" else signal.SIGTERM)
    process.wait(MAX_S)
    assert not out.exists()
    assert remove_partials(tmp_path) == 1
    assert list(tmp_path.iterdir()) == []


def test_scene_file_says_how_it_was_made(mission):
    out, _ = mission
    scene = json.loads((out / "scene.json").read_text())
    assert (scene["format"], scene["seed"], scene["n_frames"]) == (1, 1, N_FRAMES)
    water = MissionScene.draw(1, N_FRAMES, 340).water
    assert scene["water"] == json.loads(json.dumps(asdict(water)))
    for entry in scene["frames"]:
        depth = read_depth_m(out, entry["frame"])
        if entry["nearest_m"] is None:
            assert not depth.any()
        else:
            assert depth[depth > 0].min() == pytest.approx(entry["nearest_m"], abs=6e-4)


def patch_deviations(folder, every=1):
    """Standard deviation in grey levels of every patch of the left frames, or of some of them."""
    mission = open_mission(folder)
    deviations = []
    for number in mission.frames()[::every]:
        frame = mission.read(number)
        size = DEFAULT_GRID.resized(*frame.shape[:2])[::-1]
        small = cv2.resize(frame, size, interpolation=cv2.INTER_AREA)
        gray = cv2.cvtColor(small, cv2.COLOR_BGR2GRAY)
        deviations.append(DEFAULT_GRID.cells(gray).std(axis=(1, 2)))
    return np.concatenate(deviations)


EDGES = np.array([0, 0.5, 0.71, 1.0, 1.41, 2, 2.83, 4, 5.66, 8, 11.3, 16, 22.6, 32, 45, 256])
"""Half-octave bins of a patch's standard deviation in grey levels; the tails are one bin each."""
TOLERANCE_FACTOR, TOLERANCE_SHARE = 1.1, 0.001


@pytest.mark.mission
def test_the_real_mission_lies_in_the_range_of_the_synthetic_ones(mission_dir, short_missions):
    """Per bin, the real share is between the least and the most of six seeds.

    The tolerance, a factor of 1.1 and 0.1 % of the patches either way, is the sampling error of
    the small bins: 0.5 % of the patches of a simulated mission of 20 frames are 10 patches.
    """
    real = patch_deviations(mission_dir, every=3)
    shares, extremes = [], []
    for folder in short_missions:
        simulated = patch_deviations(folder)
        shares.append(np.histogram(simulated, EDGES)[0] / len(simulated))
        extremes.append((simulated.min(), simulated.max()))
    real_share = np.histogram(real, EDGES)[0] / len(real)
    least, most = np.min(shares, axis=0), np.max(shares, axis=0)
    table = "\n".join(
        f"{EDGES[i]:6.2f}..{EDGES[i + 1]:6.2f}: {100 * real_share[i]:6.2f} % real, "
        f"{100 * least[i]:6.2f} to {100 * most[i]:6.2f} % simulated"
        for i in range(len(real_share))
    )
    assert (real_share >= least / TOLERANCE_FACTOR - TOLERANCE_SHARE).all(), table
    assert (real_share <= most * TOLERANCE_FACTOR + TOLERANCE_SHARE).all(), table
    low, high = np.transpose(extremes)
    assert low.min() <= np.quantile(real, 0.001)
    assert high.max() >= np.quantile(real, 0.9999)
