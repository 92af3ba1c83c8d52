"""`tokt depth --fused` and `--export` on a rendered wall whose place is known exactly."""

import json
import math
import shutil

import cv2
import numpy as np
import pytest

from tests.calls import refuses
from tests.training.rig.test_depth import read_ply
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.calibration_writer import write_calibration
from tokt.inference.stereo.odometry import COLUMNS, Motion, load_odometry, motion_between
from tokt.inference.stereo.rectify import Rectifier
from tokt.training.rig.depth.export import COLMAP, OPENSFM, Export

pytestmark = pytest.mark.xdist_group("several_frames")  # what they share is made once

SIZE, FRAMES = (680, 512), range(1, 10)
NEAR_M, FAR_M, HALF_M = 3.0, 3.4, (0.35, 0.8)
"""A square before a wall, by their distances in the odometry's axes, and half their sides."""
SPECK, SPECK_M = 5, 2.4
"""A frame in which a piece of something floats before both cameras, and how far away."""
NO_POSE = 9
NOISE_GREY, TEXTURE_M = 2.0, 0.008
PLACE = {"depth_m": 41.5, "heading_deg": 12.5, "lat_deg": 63.4401234, "lon_deg": 110.3951234}


def cameras():
    """Two lenses with all of OpenCV's five numbers but k3, turned against each other."""
    K = [np.array([[f, 0, x], [0, f, y], [0, 0, 1]]) for f, x, y in ((900.0, 345.2, 250.1), (905.0, 333.0, 259.0))]  # fmt: skip
    D = np.array([0.12, 0.08, 0.002, -0.001, 0]), np.array([0.10, 0.11, -0.001, 0.0015, 0])
    turn = cv2.Rodrigues(np.array([0.008, -0.012, 0.01]))[0]
    T = np.array([[-299.0], [4.0], [-6.0]])
    return StereoCalibration(K[0], D[0], K[1], D[1], turn, T, SIZE)


CALIBRATION = cameras()


def pose_of(frame):
    """Where the left camera is, and how it is turned: axes of the camera to fixed ones."""
    turn = np.array([0.004, -0.010, 0.006]) * (frame - 5) * (1 if frame % 2 else 0.8)
    centre = np.array([0.04 * (frame - 5), 0.02 * math.sin(frame), 0.09 * frame - 0.5])
    return centre, cv2.Rodrigues(turn)[0]


def draw(frame, side, textures):
    """A picture of the square, the wall and open water, and in one frame a speck."""
    K, D = (CALIBRATION.K1, CALIBRATION.D1) if side == 0 else (CALIBRATION.K2, CALIBRATION.D2)
    centre, turn = pose_of(frame)
    if side:
        shift = CALIBRATION.T_mm.ravel() / 1000
        centre, turn = centre - turn @ CALIBRATION.R.T @ shift, turn @ CALIBRATION.R.T
    columns, rows = np.meshgrid(np.arange(SIZE[0], dtype=float), np.arange(SIZE[1], dtype=float))
    pixels = np.dstack([columns, rows]).reshape(-1, 1, 2)
    steps = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-9)
    rays = cv2.undistortPoints(pixels, K, D, None, None, None, steps).reshape(-1, 2)
    rays = np.column_stack([rays, np.ones(len(rays))]) @ turn.T
    things = [(FAR_M, 0.0, HALF_M[1]), (NEAR_M, 0.0, HALF_M[0])]
    if frame == SPECK:
        things.append((SPECK_M, 0.45, 0.07))
    picture = np.full(len(rays), 10.0)
    for texture, (away, beside, half) in zip(textures, things, strict=False):
        at = centre + rays * ((away - centre[2]) / rays[:, 2])[:, None] - [beside, 0, 0]
        place = (at[:, :2] / TEXTURE_M + len(texture) / 2).astype(np.float32)
        x, y = place.T.reshape(2, *SIZE[::-1])
        seen = cv2.remap(texture, x, y, cv2.INTER_CUBIC).ravel()
        picture = np.where((np.abs(at[:, :2]) < half).all(axis=1), seen, picture)
    noise = np.random.default_rng([frame, side]).normal(0, NOISE_GREY, len(picture))
    return (picture + noise).round().clip(0, 255).reshape(SIZE[::-1]).astype(np.uint8)


def odometry_line(frame):
    centre, turn = pose_of(frame)
    axis = cv2.Rodrigues(turn)[0].ravel()
    angle = np.linalg.norm(axis)
    x, y, z = axis * (math.sin(angle / 2) / max(angle, 1e-12))
    values = [frame / 10, *centre, math.cos(angle / 2), x, y, z]
    return ",".join([str(frame), *(f"{value:.9f}" for value in values)])


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    """The mission, its calibration, its odometry, and the log of a run over it."""
    folder = tmp_path_factory.mktemp("several") / "wall"
    draws = np.random.default_rng(7)
    textures = [draws.uniform(15, 45, (256, 256)).astype(np.float32) for _ in range(3)]
    for side, name in enumerate(("Left", "Right")):
        (folder / name).mkdir(parents=True)
        for frame in FRAMES:
            file = folder / name / f"wall_{name[0]}_{frame}.png"
            cv2.imwrite(str(file), draw(frame, side, textures))
    write_calibration(folder / "rig.yml", CALIBRATION)
    lines = [odometry_line(frame) for frame in FRAMES if frame != NO_POSE]
    (folder / "odometry.csv").write_text("\n".join([",".join(COLUMNS), *lines]) + "\n")
    return folder


@pytest.fixture(scope="module")
def depth(wall, tmp_path_factory, done):
    """Run the command on the wall; its answer, and where it wrote."""

    def run(*options, folder=wall):
        out = tmp_path_factory.mktemp("out")
        command = ("depth", folder, "--calibration", folder / "rig.yml", "--scale", 1)
        said = done(*command, "--pictures", "none", "--out", out, *options, "--json")
        return json.loads(said.out), out

    return run


@pytest.fixture(scope="module")
def by_odometry(wall, depth):
    return depth("--fused", "--odometry", wall / "odometry.csv", "--export", "colmap")


def from_truth(points):
    """How far points in the odometry's axes are behind the square or the wall, in metres."""
    near = (np.abs(points[:, :2]) < HALF_M[0] + 0.005).all(axis=1)
    inner = (np.abs(points[:, :2]) < HALF_M[0] - 0.02).all(axis=1)
    clear = inner | ~near
    return (points[:, 2] - np.where(near, NEAR_M, FAR_M))[clear]


def coordinates(cloud):
    return np.column_stack([cloud["x"], cloud["y"], cloud["z"]]).astype(float)


def robust(values):
    return 1.4826 * np.median(np.abs(values - np.median(values)))


def test_the_joined_cloud_is_truer_than_one_pairs(wall, depth, by_odometry):
    """Half the spread of the pair that measures best, about the truth itself; nothing moved."""
    found, out = by_odometry
    cloud = coordinates(read_ply(out / "fused.ply"))
    assert found["ply"]["file"] == str(out / "fused.ply")
    assert found["ply"]["points"] == len(cloud) > 50_000
    assert found["ply"]["axes"] == "the odometry's axes"
    off = from_truth(cloud)
    _, single = depth("--ply", wall / "one.ply", "--ply-frame", 8, "--frames", "1-8")
    pose = load_odometry(wall / "odometry.csv")[8]
    one = coordinates(read_ply(wall / "one.ply")) @ pose.rotation.T + pose.position_m
    alone = from_truth(one)
    assert robust(off) < 0.5 * robust(alone), (robust(off), robust(alone))
    assert abs(np.median(off)) < 0.001 and abs(np.median(alone)) < 0.005
    assert np.mean(np.abs(off) > 0.05) < 0.01
