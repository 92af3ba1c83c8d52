"""`tokt depth --fused` and `--export` on a rendered wall whose place is known exactly."""

import json
import math
import shutil
import sys
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from tests.calls import refuses
from tests.fixtures import quiet
from tests.training.rig.test_depth import read_ply
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.calibration_writer import write_calibration
from tokt.inference.stereo.odometry import COLUMNS, load_odometry, motion_between
from tokt.training.rig.depth.export import COLMAP, OPENSFM, Export

pycolmap = pytest.importorskip("pycolmap", reason="the extra colmap is not installed")

SIZE, FRAMES = (680, 512), range(1, 10)
NEAR_M, FAR_M, HALF_M = 3.0, 3.4, (0.35, 0.8)
"""A square before a wall, by their distances in the odometry's axes, and half their sides."""
SPECK, SPECK_M = 4, 2.4
"""A frame in which a piece of something floats before both cameras, and how far away."""
NO_POSE = 9
NOISE_GREY, TEXTURE_M = 2.0, 0.008
PLACE = {"depth_m": 41.5, "lat_deg": 63.4401234, "lon_deg": 110.3951234}


def cameras():
    """Two lenses with all of OpenCV's five numbers but k3, turned against each other."""
    numbers = (900.0, 345.2, 250.1), (905.0, 333.0, 259.0)
    K = [np.array([[f, 0, x], [0, f, y], [0, 0, 1]]) for f, x, y in numbers]
    D = np.array([0.12, 0.08, 0.002, -0.001, 0]), np.array([0.10, 0.11, -0.001, 0.0015, 0])
    turn = cv2.Rodrigues(np.array([0.008, -0.012, 0.01]))[0]
    T = np.array([[-299.0], [4.0], [-6.0]])
    return StereoCalibration(K[0], D[0], K[1], D[1], turn, T, SIZE)


CALIBRATION = cameras()


def pose_of(frame):
    """Where the left camera is, and how it is turned: axes of the camera to fixed ones."""
    turn = np.array([0.004, -0.010, 0.006]) * (frame - 5) * (1 if frame % 2 else 0.8)
    centre = np.array([0.04 * (frame - 5), 0.02 * math.sin(frame), 0.09 * frame - 0.5])
    return cv2.Rodrigues(turn)[0], centre


@cache
def rays_of(side):
    """Where each pixel of a picture looks, in the axes of its camera."""
    K, D = (CALIBRATION.K1, CALIBRATION.D1) if side == 0 else (CALIBRATION.K2, CALIBRATION.D2)
    pixels = np.dstack(np.meshgrid(*map(np.arange, SIZE))).reshape(-1, 1, 2).astype(float)
    steps = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-9)
    rays = cv2.undistortPoints(pixels, K, D, None, None, None, steps).reshape(-1, 2)
    return np.column_stack([rays, np.ones(len(rays))])


def draw(frame, side, textures):
    """A picture of the square, the wall and open water, and in one frame a speck."""
    turn, centre = pose_of(frame)
    if side:
        shift = CALIBRATION.T_mm.ravel() / 1000
        centre, turn = centre - turn @ CALIBRATION.R.T @ shift, turn @ CALIBRATION.R.T
    rays = rays_of(side) @ turn.T
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


def odometry_line(frame, pose):
    turn, centre = pose
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
    lines = [odometry_line(frame, pose_of(frame)) for frame in FRAMES if frame != NO_POSE]
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


def in_picture(side, points):
    """Where points in the left camera's axes are in either picture, by OpenCV."""
    if side == "left":
        K, D, turn, shift = CALIBRATION.K1, CALIBRATION.D1, np.eye(3), np.zeros(3)
    else:
        K, D, turn, shift = CALIBRATION.K2, CALIBRATION.D2, CALIBRATION.R, CALIBRATION.T_mm / 1000
    return cv2.projectPoints(points, turn, shift, K, D)[0].reshape(-1, 2)


def moved(points, pose):
    """Points taken by a pose as OpenSfM writes it."""
    return points @ cv2.Rodrigues(np.array(pose["rotation"]))[0].T + pose["translation"]


def robust(values):
    return 1.4826 * np.median(np.abs(values - np.median(values)))


@pytest.fixture(scope="module")
def one_pair(wall, depth):
    """The cloud of one pair, in the odometry's axes."""
    depth("--ply", wall / "one.ply", "--frames", f"{SPECK}")
    pose = load_odometry(wall / "odometry.csv")[SPECK]
    return coordinates(read_ply(wall / "one.ply")) @ pose.rotation.T + pose.position_m


def test_the_joined_cloud_is_truer_than_one_pairs(by_odometry, one_pair):
    """The spread about the truth itself, not about its own mean; and not moved from there."""
    found, out = by_odometry
    cloud = coordinates(read_ply(out / "fused.ply"))
    assert found["ply"]["file"] == str(out / "fused.ply")
    assert len(one_pair) < found["ply"]["points"] == len(cloud) < 2 * len(one_pair)  # none twice
    assert found["ply"]["axes"] == "the odometry's axes"
    joined, alone = from_truth(cloud), from_truth(one_pair)
    assert robust(joined) < 0.6 * robust(alone)
    assert abs(np.median(joined)) < 0.002 and abs(np.median(alone)) < 0.005
    assert np.mean(np.abs(joined) > 0.05) < 0.01


def test_what_one_frame_alone_shows_is_no_part_of_it(by_odometry, one_pair):
    cloud = coordinates(read_ply(by_odometry[1] / "fused.ply"))
    assert (np.abs(one_pair[:, 2] - SPECK_M) < 0.05).sum() > 300
    assert (cloud[:, 2] < (SPECK_M + NEAR_M) / 2).sum() == 0


def test_a_frame_without_a_pose_is_left_out(by_odometry):
    assert by_odometry[0]["ply"]["frames"] == "1-8"
    assert by_odometry[0]["export"]["pairs"] == 9 and by_odometry[0]["export"]["poses"] == 8


def test_poses_estimated_from_the_frames(wall, depth, by_odometry):
    """Frame by frame against the truth, and a cloud as good as with it."""
    found, out = depth("--fused", "--export", "opensfm", "--frames", "4-8")
    axes, within = found["ply"]["axes"].split("; poses estimated, within ")
    assert float(within.split()[0]) < 1
    anchor = int(axes.removeprefix("the left camera's axes at frame "))
    (model,) = json.loads((out / "opensfm" / "reconstruction.json").read_text())
    truth = load_odometry(wall / "odometry.csv")
    for frame, instance in model["rig_instances"].items():
        wanted = motion_between(truth[anchor], truth[int(frame)])
        turn = cv2.Rodrigues(np.array(instance["rotation"]))[0]
        off = math.degrees(np.linalg.norm(cv2.Rodrigues(turn @ wanted.rotation.T)[0]))
        moved = turn.T @ instance["translation"] - wanted.rotation.T @ wanted.translation_m
        assert off < 0.02 and np.linalg.norm(moved) < 0.0015
    cloud = coordinates(read_ply(out / "fused.ply"))
    joined = from_truth(cloud @ truth[anchor].rotation.T + truth[anchor].position_m)
    exact = from_truth(coordinates(read_ply(by_odometry[1] / "fused.ply")))
    assert robust(joined) < 1.5 * robust(exact) and abs(np.median(joined)) < 0.003


def test_colmaps_own_reader_sees_each_point_where_the_pictures_have_it(wall, by_odometry):
    """Both cameras, all poses: against OpenCV's projection, whose first pixel is at (0, 0)."""
    out = by_odometry[1] / "colmap"
    model = pycolmap.Reconstruction(out / "sparse")
    assert (model.num_reg_frames(), model.num_reg_images()) == (8, 16)
    cloud = coordinates(read_ply(by_odometry[1] / "fused.ply"))[::97]
    odometry = load_odometry(wall / "odometry.csv")
    for image in model.images.values():
        side, name = image.name.split("_")
        frame = int(name.split(".")[0])
        left = (cloud - odometry[frame].position_m) @ odometry[frame].rotation
        pixels = np.array([image.project_point(point) for point in cloud]) - 0.5
        assert np.abs(pixels - in_picture(side, left)).max() < 1e-6
        original = next((wall / side.capitalize()).glob(f"*_{frame}.png"))
        assert (out / "images" / image.name).read_bytes() == original.read_bytes()


def test_colmap_goes_on_from_the_database(by_odometry, tmp_path):
    """It finds, matches and triangulates points that fit our poses, in the model's own images."""
    shutil.copytree(by_odometry[1] / "colmap", tmp_path / "colmap")
    data, images = tmp_path / "colmap" / "database.db", tmp_path / "colmap" / "images"
    with pycolmap.Database.open(data) as database:
        (rig,), frames = database.read_all_rigs(), database.read_all_frames()
        assert database.read_all_pose_priors() == []  # no log, no places
        stands = rig.sensor_from_rig(database.read_camera(2).sensor_id)
    assert len(frames) == 9 and {frame.rig_id for frame in frames} == {rig.rig_id}
    assert np.abs(stands.rotation.matrix() - CALIBRATION.R).max() < 1e-9
    assert np.abs(stands.translation - CALIBRATION.T_mm.ravel() / 1000).max() < 1e-9
    few = pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=1)
    few.sift.max_num_features, few.sift.first_octave = 500, 0
    pycolmap.extract_features(data, images, extraction_options=few)
    pycolmap.match_sequential(
        data, matching_options=pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=1)
    )
    model = pycolmap.Reconstruction(tmp_path / "colmap" / "sparse")
    (tmp_path / "points").mkdir()
    found = pycolmap.triangulate_points(model, data, images, tmp_path / "points")
    points = from_truth(np.array([point.xyz for point in found.points3D.values()]))
    assert len(points) > 300 and np.median(np.abs(points)) < 0.01
    assert found.compute_mean_reprojection_error() < 1


@pytest.fixture(scope="module")
def logged(wall, done):
    """The log of a real run by odometry, whose vehicle knew its place up to frame 7."""
    log = wall / "run.jsonl"
    options = ("--policy", "disparity", "--stereo", "pushbroom", "--calibration", wall / "rig.yml")
    done("run", "--source", wall, *options, "--odometry", wall / "odometry.csv", "--log", log)
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    for line in lines:
        if line["frame"] is not None and line["frame"] <= 7:
            line |= PLACE
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return log


def test_a_log_brings_places_and_its_runs_odometry(logged, depth):
    found, out = depth("--export", "colmap", "--log", logged)
    assert (found["export"]["poses"], found["export"]["places"]) == (8, 7)
    with pycolmap.Database.open(out / "colmap" / "database.db") as database:
        priors = database.read_all_pose_priors()
        names = {database.read_image(each.corr_data_id.id).name for each in priors}
    assert names == {f"left_{frame:06d}.png" for frame in range(1, 8)}
    assert {each.coordinate_system.name for each in priors} == {"WGS84"}
    assert all(each.position.tolist() == [63.4401234, 110.3951234, -41.5] for each in priors)
    assert found["ply"] is None and not (out / "fused.ply").exists()


def test_opensfms_files_project_as_its_documentation_says(wall, logged, depth):
    """Its package is on no index, so its rules are written down here anew.

    A point in a shot's axes is seen, by the camera "brown", in parts of the picture's longer side
    from its middle; pixels have their first centre at (0, 0) (OpenSfM, Geometric Models).
    """
    out = depth("--export", "opensfm", "--log", logged)[1]
    read = {file.stem: json.loads(file.read_text()) for file in (out / "opensfm").glob("*.json")}
    assert set(read) == {"camera_models_overrides", "rig_cameras", "rig_assignments",
                         "exif_overrides", "reconstruction"}  # fmt: skip
    names = {file.name for file in (out / "opensfm" / "images").iterdir()}
    pairs = read["rig_assignments"]
    assert list(pairs) == [str(frame) for frame in FRAMES]
    assert {name for pair in pairs.values() for name, _ in pair} == names
    assert set(read["exif_overrides"]) == names
    exif = read["exif_overrides"]["right_000003.png"]
    gps = {"latitude": 63.4401234, "longitude": 110.3951234, "altitude": -41.5}
    assert exif == {"camera": "right", "gps": gps}
    assert read["exif_overrides"]["left_000009.png"] == {"camera": "left"}
    (model,) = read["reconstruction"]
    assert model["cameras"] == read["camera_models_overrides"]
    assert model["rig_cameras"] == read["rig_cameras"]
    points = np.random.default_rng(2).uniform([-0.5, -0.4, 3], [0.5, 0.4, 4], (50, 3))
    odometry = load_odometry(wall / "odometry.csv")
    for name, shot in model["shots"].items():
        side, frame = shot["camera"], int(name.split("_")[1].split(".")[0])
        instance = model["rig_instances"][str(frame)]
        assert instance["rig_camera_ids"][name] == side
        stands = model["rig_cameras"][side]
        camera = model["cameras"][side]
        seen = moved(moved(points, instance), stands)
        assert np.abs(seen - moved(points, shot)).max() < 1e-9
        x, y = (seen[:, :2] / seen[:, 2:]).T
        r2, long = x * x + y * y, max(SIZE)
        d = 1 + r2 * (camera["k1"] + r2 * (camera["k2"] + r2 * camera["k3"]))
        dx = 2 * camera["p1"] * x * y + camera["p2"] * (r2 + 2 * x * x)
        dy = 2 * camera["p2"] * x * y + camera["p1"] * (r2 + 2 * y * y)
        u = (camera["focal_x"] * (d * x + dx) + camera["c_x"]) * long + (SIZE[0] - 1) / 2
        v = (camera["focal_y"] * (d * y + dy) + camera["c_y"]) * long + (SIZE[1] - 1) / 2
        left = (points - odometry[frame].position_m) @ odometry[frame].rotation
        assert np.abs(np.column_stack([u, v]) - in_picture(side, left)).max() < 1e-6


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--odometry", "o.csv"), "go together with --fused or --export"),
        (("--fused", "--odometry", "none.csv"), "cannot read odometry none.csv"),
        (("--fused", "--log", "none.jsonl"), "log none.jsonl does not exist"),
        (("--export", "meshroom"), "one of colmap, opensfm, not 'meshroom'"),
        (("--export", "colmap", "--out", "full"), "exists already"),
        (("--fused", "--frames", "4"), "give --odometry FILE"),
        (("--fused", "--odometry", "elsewhere.csv"), "no 3 frames with a pose agree"),
    ],
)
def test_what_cannot_be_joined_or_handed_over_is_refused(
    options, words, wall, tmp_path, refused, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full" / "colmap").mkdir(parents=True)
    (tmp_path / "elsewhere.csv").write_text(
        "\n".join([",".join(COLUMNS), odometry_line(99, pose_of(5))])
    )
    command = ("depth", wall, "--calibration", wall / "rig.yml", "--pictures", "none", *options)
    assert refused(words, *command).splitlines()[-1].count("tokt: error") == 1


def test_a_missing_pycolmap_is_named_before_the_work(wall, tmp_path, refused, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    command = ("depth", wall, "--calibration", wall / "rig.yml", "--export", "colmap")
    refused("install the extra 'colmap'", *command, "--out", tmp_path)
    assert not any(tmp_path.iterdir())


def test_without_an_obstacle_nothing_is_joined(wall, tmp_path, refused):
    for name in ("Left", "Right"):
        (tmp_path / "water" / name).mkdir(parents=True)
        for frame in range(1, 5):
            noise = np.random.default_rng([frame, len(name)]).normal(10, 1, SIZE[::-1])
            file = tmp_path / "water" / name / f"water_{name[0]}_{frame}.png"
            cv2.imwrite(str(file), noise.round().astype(np.uint8))
    command = ("depth", tmp_path / "water", "--calibration", wall / "rig.yml", "--fused")
    refused("no point cloud: no poses", *command, "--out", tmp_path / "out")


def test_a_log_of_other_pictures_or_with_odometry_that_changed_is_not_taken(
    logged, wall, tmp_path, refused
):
    command = ("--calibration", wall / "rig.yml", "--export", "colmap", "--log", logged)
    (tmp_path / "other").mkdir()
    for side, other in (("Left", "Right"), ("Right", "Left")):
        shutil.copytree(wall / other, tmp_path / "other" / side)
    refused("run.jsonl is not of mission other", "depth", tmp_path / "other", *command)
    text = (wall / "odometry.csv").read_text()
    (wall / "odometry.csv").write_text(text + "\n")
    try:
        refused("is not the one that the run had", "depth", wall, *command, "--out", tmp_path)
    finally:
        (wall / "odometry.csv").write_text(text)


def test_lenses_that_a_program_has_no_model_for_are_refused(tmp_path):
    """Eight numbers for COLMAP, five for OpenSfM; k3 makes COLMAP's another model."""

    def write(D, program, name):
        of = Export(None, replace(CALIBRATION, D1=np.array(D)), [], {}, {})
        return of.write(program, tmp_path / name, quiet)

    eight = [0.12, 0.08, 0.002, -0.001, 0.03, 0.01, -0.02, 0.004]
    refuses("opensfm knows no more than 5 numbers", write, eight, OPENSFM, "a")
    refuses("colmap knows no more than 8 numbers", write, [*eight, 0.1, 0, 0, 0], COLMAP, "b")
    assert not any(tmp_path.iterdir())
    write(eight, COLMAP, "c")
    camera = pycolmap.Reconstruction(tmp_path / "c" / "sparse").cameras[1]
    points = np.random.default_rng(3).uniform([-0.5, -0.4, 2], [0.5, 0.4, 3], (30, 3))
    still = np.zeros(3)
    expected = cv2.projectPoints(points, still, still, CALIBRATION.K1, np.array(eight))[0]
    assert camera.model.name == "FULL_OPENCV"
    assert np.abs(camera.img_from_cam(points) - 0.5 - expected.reshape(-1, 2)).max() < 1e-9
