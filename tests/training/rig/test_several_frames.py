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
SPECK, SPECK_M = 4, 2.4
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


@pytest.fixture(scope="module")
def one_pair(wall, depth):
    """The cloud of one pair, in the odometry's axes."""
    depth("--ply", wall / "one.ply", "--frames", f"{SPECK}")
    pose = load_odometry(wall / "odometry.csv")[SPECK]
    return coordinates(read_ply(wall / "one.ply")) @ pose.rotation.T + pose.position_m


def test_the_joined_cloud_is_truer_than_one_pairs(by_odometry, one_pair):
    """Half the spread about the truth itself, not about its own mean; and not moved from there."""
    found, out = by_odometry
    cloud = coordinates(read_ply(out / "fused.ply"))
    assert found["ply"]["file"] == str(out / "fused.ply")
    assert found["ply"]["points"] == len(cloud) > len(one_pair)
    assert found["ply"]["axes"] == "the odometry's axes"
    joined, alone = from_truth(cloud), from_truth(one_pair)
    assert robust(joined) < 0.5 * robust(alone)
    assert abs(np.median(joined)) < 0.001 and abs(np.median(alone)) < 0.005
    assert np.mean(np.abs(joined) > 0.05) < 0.01


def test_what_one_frame_alone_shows_is_no_part_of_it(by_odometry, one_pair):
    cloud = coordinates(read_ply(by_odometry[1] / "fused.ply"))
    assert (np.abs(one_pair[:, 2] - SPECK_M) < 0.05).sum() > 300
    assert (cloud[:, 2] < (SPECK_M + NEAR_M) / 2).sum() == 0


def test_a_frame_without_a_pose_is_left_out_and_named(wall, by_odometry, done):
    assert by_odometry[0]["ply"]["frames"] == "1-8"
    assert by_odometry[0]["ply"]["left_out"] == str(NO_POSE)
    assert by_odometry[0]["export"]["pairs"] == 9 and by_odometry[0]["export"]["poses"] == 8


def test_poses_estimated_from_the_frames(wall, depth, by_odometry):
    """Frame by frame against the truth, and a cloud as good as with it."""
    found, out = depth("--fused", "--export", "opensfm", "--frames", "1-8")
    assert found["ply"]["left_out"] == "" and found["ply"]["residual_px"] < 1
    anchor = int(found["ply"]["axes"].rsplit(" ", 1)[1])
    assert found["ply"]["axes"] == f"the left camera's axes at frame {anchor}"
    (model,) = json.loads((out / "opensfm" / "reconstruction.json").read_text())
    truth = load_odometry(wall / "odometry.csv")
    for frame, instance in model["rig_instances"].items():
        wanted = motion_between(truth[anchor], truth[int(frame)])
        turn = cv2.Rodrigues(np.array(instance["rotation"]))[0]
        off = math.degrees(np.linalg.norm(cv2.Rodrigues(turn @ wanted.rotation.T)[0]))
        moved = turn.T @ instance["translation"] - wanted.rotation.T @ wanted.translation_m
        assert off < 0.3 and np.linalg.norm(moved) < 0.02
    cloud = coordinates(read_ply(out / "fused.ply"))
    joined = from_truth(cloud @ truth[anchor].rotation.T + truth[anchor].position_m)
    exact = from_truth(coordinates(read_ply(by_odometry[1] / "fused.ply")))
    assert robust(joined) < 1.5 * robust(exact) and abs(np.median(joined)) < 0.003


def test_colmaps_own_reader_sees_each_point_where_the_pictures_have_it(wall, by_odometry):
    """Both cameras, all poses; against OpenCV's projection in our axes, and the pictures' texture.

    COLMAP's first pixel has its centre at (0.5, 0.5).
    """
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap (extra dev) is not installed")
    out = by_odometry[1]
    model = pycolmap.Reconstruction(out / "colmap" / "sparse")
    assert (model.num_reg_frames(), model.num_reg_images()) == (8, 16)
    cloud = coordinates(read_ply(out / "fused.ply"))[::97]
    odometry, shown = load_odometry(wall / "odometry.csv"), []
    for image in model.images.values():
        side, name = image.name.split("/")
        frame = int(name.split(".")[0])
        left = (cloud - odometry[frame].position_m) @ odometry[frame].rotation
        turn, shift = (np.eye(3), np.zeros((3, 1))) if side == "left" else (CALIBRATION.R, CALIBRATION.T_mm / 1000)  # fmt: skip
        K, D = (CALIBRATION.K1, CALIBRATION.D1) if side == "left" else (CALIBRATION.K2, CALIBRATION.D2)  # fmt: skip
        expected = cv2.projectPoints(left, turn, shift, K, D)[0].reshape(-1, 2)
        pixels = np.array([image.project_point(point) for point in cloud]) - 0.5
        assert np.abs(pixels - expected).max() < 1e-6
        file = out / "colmap" / "images" / image.name
        original = next((wall / side.capitalize()).glob(f"*_{frame}.png"))
        assert file.read_bytes() == original.read_bytes()
        x, y = pixels.astype(np.float32).T
        shown.append(
            cv2.remap(cv2.imread(str(file), 0).astype(np.float32), x, y, cv2.INTER_LINEAR).ravel()
        )
    shown = np.array(shown)
    inside = shown.min(axis=0) > 0
    each = [np.corrcoef(one[inside], shown.mean(axis=0)[inside])[0, 1] for one in shown]
    assert inside.sum() > 500 and min(each) > 0.6


def test_colmap_knows_the_rig_of_frames_that_have_no_pose(by_odometry):
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap (extra dev) is not installed")
    folder = by_odometry[1] / "colmap"
    (config,) = pycolmap.read_rig_config(folder / "rig_config.json")
    first, second = config.cameras
    assert first.ref_sensor and (first.image_prefix, second.image_prefix) == ("left/", "right/")
    stands = second.cam_from_rig
    assert np.abs(stands.rotation.matrix() - CALIBRATION.R).max() < 1e-9
    assert np.abs(stands.translation - CALIBRATION.T_mm.ravel() / 1000).max() < 1e-9
    (rig,) = pycolmap.Reconstruction(folder / "sparse").rigs.values()
    assert rig.num_sensors() == 2
    assert (folder / "images" / "right" / f"{NO_POSE:06d}.png").is_file()
    assert not (folder / "ref_images.txt").exists()  # no log, no places
