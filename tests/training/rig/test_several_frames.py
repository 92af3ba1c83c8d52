"""`tokt depth --fused` and `--export` on a rendered wall whose place is known exactly."""

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.calls import refuses
from tests.tiers import scaled
from tests.training.rig.test_depth import read_ply
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.calibration_writer import write_calibration
from tokt.inference.stereo.odometry import COLUMNS, load_odometry, motion_between
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


def draw(frame, side, textures):
    """A picture of the square, the wall and open water, and in one frame a speck."""
    K, D = (CALIBRATION.K1, CALIBRATION.D1) if side == 0 else (CALIBRATION.K2, CALIBRATION.D2)
    turn, centre = pose_of(frame)
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
        K, D, turn = CALIBRATION.K2, CALIBRATION.D2, CALIBRATION.R
        shift = CALIBRATION.T_mm / 1000
    return cv2.projectPoints(points, turn, shift, K, D)[0].reshape(-1, 2)


def levels(file, pixels):
    """The grey levels of a picture file at some places."""
    x, y = np.asarray(pixels, np.float32).T
    picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE).astype(np.float32)
    return cv2.remap(picture, x, y, cv2.INTER_LINEAR).ravel()


def moved(points, pose):
    """Points taken by a pose as OpenSfM writes it."""
    return points @ cv2.Rodrigues(np.array(pose["rotation"]))[0].T + pose["translation"]


def passing(items, total, what):
    return items


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
    """Both cameras, all poses: against OpenCV's projection in our axes, and the pictures.

    What all of them show at a point is most alike there, and less 0.8 px beside it. COLMAP's
    first pixel has its centre at (0.5, 0.5).
    """
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap (extra dev) is not installed")
    out = by_odometry[1]
    model = pycolmap.Reconstruction(out / "colmap" / "sparse")
    assert (model.num_reg_frames(), model.num_reg_images()) == (8, 16)
    cloud = coordinates(read_ply(out / "fused.ply"))[::97]
    odometry, shown, beside = load_odometry(wall / "odometry.csv"), [], []
    for image in model.images.values():
        side, name = image.name.split("/")
        frame = int(name.split(".")[0])
        left = (cloud - odometry[frame].position_m) @ odometry[frame].rotation
        expected = in_picture(side, left)
        pixels = np.array([image.project_point(point) for point in cloud]) - 0.5
        assert np.abs(pixels - expected).max() < 1e-6
        file = out / "colmap" / "images" / image.name
        original = next((wall / side.capitalize()).glob(f"*_{frame}.png"))
        assert file.read_bytes() == original.read_bytes()
        shown.append(levels(file, pixels))
        beside += [
            levels(file, pixels + step) for step in ([0.8, 0], [-0.8, 0], [0, 0.8], [0, -0.8])
        ]
    inside = np.min(shown, axis=0) > 0
    truth = np.mean(shown, axis=0)[inside]
    here = [np.corrcoef(one[inside], truth)[0, 1] for one in shown]
    there = [np.corrcoef(one[inside], truth)[0, 1] for one in beside]
    assert inside.sum() > 500
    assert all(at > max(there[4 * k : 4 * k + 4]) for k, at in enumerate(here))


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
    lines = (out / "colmap" / "ref_images.txt").read_text().splitlines()
    assert len(lines) == 7 and lines[2] == "left/000003.png 63.4401234 110.3951234 -41.5"
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
    assert (
        {name for pair in pairs.values() for name, _ in pair}
        == names
        == set(read["exif_overrides"])
    )
    exif = read["exif_overrides"]["right_000003.png"]
    gps = {"latitude": 63.4401234, "longitude": 110.3951234, "altitude": -41.5}
    assert exif == {"camera": "right", "gps": gps, "compass": {"angle": 12.5}}
    assert read["exif_overrides"]["left_000009.png"] == {"camera": "left"}
    (model,) = read["reconstruction"]
    assert (model["cameras"], model["rig_cameras"]) == (
        read["camera_models_overrides"],
        read["rig_cameras"],
    )
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
        (("--log", "run.jsonl"), "go together with --fused or --export"),
        (("--fused", "--ply", "c.ply", "--ply-frame", "5"), "without --fused"),
        (("--fused", "--odometry", "none.csv"), "cannot read odometry none.csv"),
        (("--fused", "--log", "none.jsonl"), "log none.jsonl does not exist"),
        (("--export", "meshroom"), "one of colmap, opensfm, not 'meshroom'"),
        (("--export", "colmap", "--out", "full"), "exists already"),
        (("--fused", "--frames", "4-5"), "give --odometry FILE"),
        (("--fused", "--frames", "1-8", "--ply-farthest", "2.0"), "no 3 frames with a pose agree on anything"),
    ],
)
def test_what_cannot_be_joined_or_handed_over_is_refused(
    options, words, wall, tmp_path, refused, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full" / "colmap").mkdir(parents=True)
    said = refused(words, "depth", wall, "--calibration", wall / "rig.yml", *options)
    assert said.splitlines()[-1].count("tokt: error") == 1


def test_odometry_that_changed_since_its_run_is_not_taken(logged, wall, tmp_path, refused):
    text = (wall / "odometry.csv").read_text()
    (wall / "odometry.csv").write_text(text + "\n")
    try:
        command = ("depth", wall, "--calibration", wall / "rig.yml", "--out", tmp_path)
        refused("not what it was in the run", *command, "--export", "colmap", "--log", logged)
    finally:
        (wall / "odometry.csv").write_text(text)


def export_of(calibration, mission=None):
    return Export(mission, calibration, [], {}, {})


def test_lenses_that_a_program_has_no_model_for_are_refused(tmp_path):
    """Eight numbers for COLMAP, five for OpenSfM; k3 makes COLMAP's another model."""
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap (extra dev) is not installed")
    D = np.array([0.12, 0.08, 0.002, -0.001, 0.03, 0.01, -0.02, 0.004])
    eight = replace(CALIBRATION, D1=D)
    refuses("OpenSfM knows 5 numbers", export_of(eight).write, OPENSFM, tmp_path / "a", passing)
    twelve = export_of(replace(eight, D1=np.append(D, [0.1, 0, 0, 0])))
    refuses("COLMAP knows 8 .* left camera has more", twelve.write, COLMAP, tmp_path / "b", passing)
    export_of(eight).write(COLMAP, tmp_path / "c", passing)
    camera = pycolmap.Reconstruction(tmp_path / "c" / "sparse").cameras[1]
    points = np.random.default_rng(3).uniform([-0.5, -0.4, 2], [0.5, 0.4, 3], (30, 3))
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), eight.K1, D)[0].reshape(-1, 2)
    assert camera.model.name == "FULL_OPENCV"
    assert np.abs(camera.img_from_cam(points) - 0.5 - expected).max() < 1e-9


TURN = st.tuples(*[st.floats(-3.1, 3.1)] * 3)


@given(TURN, TURN)
@settings(max_examples=scaled(60))
def test_any_rotation_survives_colmaps_reader(tmp_path_factory, turn, shift):
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap (extra dev) is not installed")
    assume(np.linalg.norm(turn) < math.pi)
    rotation = cv2.Rodrigues(np.array(turn))[0]
    standing = replace(CALIBRATION, R=rotation, T_mm=np.array(shift).reshape(3, 1))
    folder = tmp_path_factory.mktemp("rotation") / "colmap"
    export_of(standing).write(COLMAP, folder, passing)
    (config,) = pycolmap.read_rig_config(folder / "rig_config.json")
    read = config.cameras[1].cam_from_rig
    assert np.abs(read.rotation.matrix() - rotation).max() < 1e-6
    assert np.abs(read.translation - np.array(shift) / 1000).max() < 1e-12


def on_faces(points, shape):
    """Distances of points from a shape, along the axis, where it is a face: no edge, no jump.

    Both by cells of 1 cm; a face is 12 cm wide, and nine tenths of it within 5 cm of its middle.
    """
    sides = np.floor(shape[:, :2] / 0.12).astype(int)
    faces = {}
    for side in np.unique(sides, axis=0):
        here = shape[(sides == side).all(axis=1), 2]
        if len(here) > 600 and np.percentile(np.abs(here - np.median(here)), 90) < 0.05:
            faces[tuple(side)] = np.median(here)
    cells, place = np.unique(np.floor(shape[:, :2] / 0.01).astype(int), axis=0, return_inverse=True)
    means = np.bincount(place, shape[:, 2]) / np.bincount(place)
    heights = dict(zip(map(tuple, cells), means, strict=True))
    off = []
    for x, y, z in points:
        middle = faces.get((math.floor(x / 0.12), math.floor(y / 0.12)))
        height = heights.get((math.floor(x / 0.01), math.floor(y / 0.01)))
        if middle is not None and height is not None and abs(z - middle) < 0.1:
            off.append(z - height)
    return np.array(off)


@pytest.mark.mission
def test_across_the_towers_faces_the_joined_cloud_spreads_half_as_much(mission_dir, tmp_path, done):
    """About the shape that held-out frames give, so that growth on the tower is no spread.

    Odd frames give the shape, even ones what is measured: a cloud of all, and those of five pairs.
    """
    command = ("depth", mission_dir, "--calibration", mission_dir.parent / "calibration.yml")
    command = (*command, "--pictures", "none", "--json")
    said = done(*command, "--frames", "160-205", "--export", "opensfm", "--out", tmp_path / "all")
    (model,) = json.loads((tmp_path / "all" / "opensfm" / "reconstruction.json").read_text())
    assert json.loads(said.out)["export"]["poses"] > 40
    rows, poses = [",".join(COLUMNS)], {}
    for frame, pose in model["rig_instances"].items():
        turn = cv2.Rodrigues(np.array(pose["rotation"]))[0].T
        poses[int(frame)] = turn, -turn @ pose["translation"]
        rows.append(odometry_line(int(frame), poses[int(frame)]))
    (tmp_path / "poses.csv").write_text("\n".join(rows))

    def joined(first):
        frames = ",".join(str(frame) for frame in range(first, 206, 2))
        out = tmp_path / f"from_{first}"
        done(
            *command,
            "--frames",
            frames,
            "--fused",
            "--odometry",
            tmp_path / "poses.csv",
            "--out",
            out,
        )
        return coordinates(read_ply(out / "fused.ply"))

    shape, spread = joined(161), []
    for frame in (164, 172, 180, 188, 196):
        out = tmp_path / str(frame)
        done(*command, "--frames", frame, "--ply", out / "one.ply", "--out", out)
        turn, centre = poses[frame]
        spread.append(
            robust(on_faces(coordinates(read_ply(out / "one.ply")) @ turn.T + centre, shape))
        )
    even = on_faces(joined(162), shape)
    assert len(even) > 20_000
    assert robust(even) < 0.5 * np.median(spread)
    assert abs(np.median(even)) < 0.003
