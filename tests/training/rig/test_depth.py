"""`tokt depth`: rows for all pairs, figures over them, pictures, and a point cloud that is true."""

import csv
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.calls import refuses
from tests.inference.stereo.plain_rig import specks
from tokt.training.rig.depth.cloud import FAR_VERTEX, VERTEX, outliers, ply_bytes
from tokt.training.rig.depth.pair_depths import DepthRow, detected_span, steadiness, summary

WIDTH, HEIGHT, FOCAL_PX, BASELINE_M = 680, 512, 1100.0, 0.3
X, Y, SQUARE_PX = 330, 150, 200
DISPARITIES = {3: 100, 4: 112, 5: 126, 6: 126, 7: 112, 8: 100, 9: 90, 12: 90}
NO_RIGHT, BROKEN, SMALLER, EXCHANGED = 6, 10, 11, 12
LAST = 12
STRIP_PX = 12
"""Of the square, what the exchanged right frame shows."""
PLAIN = """%YAML:1.0
---
image_width: 680
image_height: 512
K1: !!opencv-matrix {rows: 3, cols: 3, dt: d, data: [1100., 0., 339.5, 0., 1100., 255.5, 0., 0., 1.]}
D1: !!opencv-matrix {rows: 1, cols: 5, dt: d, data: [0., 0., 0., 0., 0.]}
K2: !!opencv-matrix {rows: 3, cols: 3, dt: d, data: [1100., 0., 339.5, 0., 1100., 255.5, 0., 0., 1.]}
D2: !!opencv-matrix {rows: 1, cols: 5, dt: d, data: [0., 0., 0., 0., 0.]}
R: !!opencv-matrix {rows: 3, cols: 3, dt: d, data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]}
T_mm: !!opencv-matrix {rows: 3, cols: 1, dt: d, data: [-300., 0., 0.]}
"""  # noqa: E501


@pytest.fixture(scope="module", autouse=True)
def coarse_figures():
    """None: pixels are looked at."""


def depth_m(frame):
    """How far the square of a frame is away."""
    return FOCAL_PX * BASELINE_M / DISPARITIES[frame]


def draw_pair(frame):
    """A sea in a lamp's light, and in some frames one textured square nearer than it."""
    rows, columns = np.indices((HEIGHT, WIDTH), np.float64)
    fall = 8 + 25 * np.exp(-((columns - 280) ** 2 + (rows - 300) ** 2) / (2 * 200**2))
    views = []
    coarse = np.random.default_rng(3).uniform(20, 120, (50, 50))
    texture = cv2.resize(coarse, (SQUARE_PX, SQUARE_PX))
    for side, moved in enumerate((0, DISPARITIES.get(frame, 0))):
        rng = np.random.default_rng([frame, side])
        # Noise as demosaicing leaves it, over the unevenness that water has.
        fine, uneven = (rng.normal(0, sd, fall.shape) for sd in (1.0, 1.0))
        view = fall + cv2.GaussianBlur(fine, (0, 0), 0.9) + cv2.GaussianBlur(uneven, (0, 0), 4)
        view += specks(rng, HEIGHT, WIDTH)
        if frame in DISPARITIES:
            rows = STRIP_PX if frame == EXCHANGED and moved else SQUARE_PX
            view[Y : Y + rows, X - moved : X - moved + SQUARE_PX] = texture[:rows]
        views.append(view.round().clip(0, 255).astype(np.uint8))
    return views


@pytest.fixture(scope="module")
def sea(tmp_path_factory):
    """To a square and away from it; one right frame missing, one broken, one small."""
    folder = tmp_path_factory.mktemp("depth") / "sea"
    for name in ("Left", "Right"):
        (folder / name).mkdir(parents=True)
    for frame in range(1, LAST + 1):
        left, right = draw_pair(frame)
        cv2.imwrite(str(folder / "Left" / f"sea_L_{frame}.png"), left)
        if frame != NO_RIGHT:
            right = right[::2, ::2] if frame == SMALLER else right
            cv2.imwrite(str(folder / "Right" / f"sea_R_{frame}.png"), right)
    (folder / "Right" / f"sea_R_{BROKEN}.png").write_bytes(b"no picture")
    (folder / "calibration.yml").write_text(PLAIN)
    return folder


@pytest.fixture(scope="module")
def ran(sea, tmp_path_factory, done):
    """The whole command, and where it wrote."""
    out = tmp_path_factory.mktemp("depth-out")
    options = ("--out", out / "all", "--ply", out / "cloud.ply", "--pictures", "5,6", "--rate", 4)
    ended = done("depth", sea, "--calibration", sea / "calibration.yml", *options, "--json")
    return json.loads(ended.out), out, ended.err


def read_ply(path):
    """What this package's own files hold; written after the format's description."""
    data = path.read_bytes()
    header, _, body = data.partition(b"end_header\n")
    lines = [line for line in header.decode("ascii").splitlines() if not line.startswith("comment")]
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    kind, name, count = lines[2].split()
    assert (kind, name) == ("element", "vertex")
    kinds = {"float": "<f4", "uchar": "u1"}
    fields = [(line.split()[2], kinds[line.split()[1]]) for line in lines[3:]]
    vertices = np.frombuffer(body, np.dtype(fields))
    assert len(vertices) == int(count)
    return vertices


def test_every_pair_has_a_row_and_those_without_depth_say_why(ran):
    found, out, progress = ran
    rows = {row["frame"]: row for row in found["rows"]}
    assert list(rows) == list(range(1, LAST + 1))
    for frame in set(DISPARITIES) - {NO_RIGHT, EXCHANGED}:
        assert rows[frame]["status"] == 1
        assert rows[frame]["median_m"] == pytest.approx(depth_m(frame), rel=0.01)
        assert rows[frame]["distance_m"] == pytest.approx(depth_m(frame), rel=0.02)
        share = SQUARE_PX**2 / (WIDTH * HEIGHT)
        assert 0.7 * share < rows[frame]["valid_fraction"] < 1.2 * share
    for frame in (1, 2):
        assert (rows[frame]["status"], rows[frame]["valid_fraction"]) == (0, 0)
    for frame in (NO_RIGHT, BROKEN, SMALLER, EXCHANGED):
        assert rows[frame]["status"] == -1 and rows[frame]["median_m"] is None
    assert "no right frame 6" in rows[NO_RIGHT]["health"]
    assert "sea_R_10.png" in rows[BROKEN]["health"] and "340x256" in rows[SMALLER]["health"]
    # What an exchanged frame happens to match is counted, but is no depth.
    assert 0 < rows[EXCHANGED]["valid_fraction"] < 0.1 * rows[9]["valid_fraction"]
    with (out / "all" / "depth.csv").open(newline="") as handle:
        table = list(csv.DictReader(handle))
    assert [int(line["frame"]) for line in table] == list(rows)
    assert float(table[4]["median_m"]) == rows[5]["median_m"] and table[5]["median_m"] == ""
    assert json.loads((out / "all" / "depth.json").read_text("utf-8")) == found
    assert "depth: 12/12" in progress and "pictures: 2/2" in progress


def test_what_the_rows_come_to(ran):
    found = ran[0]
    assert (found["frames"], found["obstacle"], found["clear"], found["unknown"]) == (12, 6, 2, 4)
    assert found["first_detection"] == 3 and found["detected"] == [3, 9]
    assert found["gaps"] == {"count": 1, "frames": "6"}
    assert found["nearest"]["frame"] == 5 and found["median_m"]["nearest_frame"] == 5
    assert found["median_m"]["monotone"]
    assert found["clear_valid_fraction"] == {"mean": 0, "max": 0, "frames_above_0": ""}


def test_pictures_and_plot_are_pictures(ran):
    found, out, _ = ran
    assert found["pictures"] == ["depth_5.png", "depth_6.png"]
    written = sorted(path.relative_to(out / "all") for path in (out / "all").rglob("*.*"))
    pictures = [str(Path("frames") / name) for name in found["pictures"]]
    assert [str(path) for path in written] == ["depth.csv", "depth.json", "depth.png", *pictures]
    for path in (out / "all").rglob("*.png"):
        picture = cv2.imread(str(path))
        assert picture is not None and min(picture.shape[:2]) > 400 and picture.std() > 20


def test_the_cloud_is_the_square_of_the_nearest_frame(ran):
    """Its places, by the cameras' own geometry, and the grey levels it has in the frame."""
    found, out, _ = ran
    cloud = read_ply(out / "cloud.ply")
    assert found["ply"]["frame"] == 5 and found["ply"]["points"] == len(cloud) > 4000
    assert found["ply"]["matched"] == len(cloud) + found["ply"]["outliers"]
    assert np.abs(cloud["z"] - depth_m(5)).max() < 0.05
    px = np.stack([cloud["x"], cloud["y"]]) / cloud["z"] * FOCAL_PX + [[339.5], [255.5]]
    edges = np.array([px.min(axis=1), px.max(axis=1)])
    expected = np.array([[X, Y], [X + SQUARE_PX, Y + SQUARE_PX]])
    assert np.abs(edges - expected).max() < 24  # half a block, at full size
    shown = draw_pair(5)[0][np.rint(px[1]).astype(int), np.rint(px[0]).astype(int)]
    assert np.corrcoef(shown, cloud["green"])[0, 1] > 0.7
    assert (cloud["red"] == cloud["blue"]).all()  # a gray frame


def test_a_cloud_of_another_frame_cut_off_at_a_distance(sea, tmp_path, done, refused):
    """Nothing is left of it: the table is written, and the command says why there is no cloud."""
    command = ("depth", sea, "--calibration", sea / "calibration.yml", "--frames", "8")
    command = (*command, "--out", tmp_path, "--pictures", "none", "--ply")
    said = done(*command, tmp_path / "c.ply").out
    assert "1 with an obstacle" in said and "of frame 8" in said
    assert np.median(read_ply(tmp_path / "c.ply")["z"]) == pytest.approx(depth_m(8), rel=0.01)
    why = "nothing in frame 8 was matched within 2 m"
    assert refused(why, *command, tmp_path / "d.ply", "--ply-farthest", 2).count("error") == 1
    assert (tmp_path / "depth.csv").is_file() and not (tmp_path / "d.ply").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--out", "file"), "not a folder"),
        (("--out", "/proc/out"), "--out: cannot write in /"),
        (("--ply", "file/c.ply"), "file is not a folder; choose another with --ply"),
        (("--pictures", ""), "not a list of frames"),
        (("--ply", "."), "--ply names a file"),
        (("--ply", "c.ply", "--ply-frame", "5", "--frames", "7-9"), "frames 5 are not among"),
        (("--ply-frame", "5"), "together with --ply"),
    ],
)
def test_what_cannot_be_done_is_refused_before_the_work(
    options, words, sea, tmp_path, refused, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("mine")
    said = refused(words, "depth", sea, "--calibration", sea / "calibration.yml", *options)
    assert said.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


def test_one_camera_has_no_depth(sea, tmp_path, refused):
    shutil.copytree(sea / "Left", tmp_path / "mono" / "Left")
    asked = (tmp_path / "mono", "--calibration", sea / "calibration.yml")
    refused("no right camera", "depth", *asked)


def rows_of(depths):
    """Frames with an obstacle at these depths, and unknown ones for None."""
    return [DepthRow(n, -1 if depth is None else 1, depth, depth) for n, depth in depths.items()]


def test_three_in_a_row_make_a_detection():
    alone = rows_of({1: 5.0, 2: 5.0, 3: None, 4: 5.0, 5: 5.0, 7: 5.0})
    assert detected_span(alone) is None
    assert detected_span(rows_of({1: 5.0, 3: 5.0, 5: 5.0, 7: None}), lambda n: n // 2) == (1, 5)
    found = summary(rows_of({4: 5.0, 5: 5.0, 6: 5.0, 7: None, 9: 5.0, 10: 5.0, 11: 5.0}))
    assert found["detected"] == [4, 11] and found["gaps"] == {"count": 1, "frames": "7"}
    assert found["clear_valid_fraction"] is None
    speck = DepthRow(2, 0, 1.0, 1.0, valid_fraction=1e-4)
    specked = summary([*rows_of({1: 5.0}), speck, DepthRow(3, 0, valid_fraction=0.0)])
    assert specked["nearest"] == {"frame": 1, "distance_m": 5.0, "median_m": 5.0}
    assert specked["clear_valid_fraction"] == {"mean": 5e-5, "max": 1e-4, "frames_above_0": "2"}
    none = summary(rows_of({1: None}))
    assert none["first_detection"] is none["nearest"] is none["median_m"] is None


def test_monotone_and_jitter():
    steady = rows_of({1: 5.0, 2: 4.0, 3: 3.5, 4: 4.0, 5: 5.0})
    found = steadiness(steady, "median_m")
    assert found is not None and found["monotone"] and found["nearest_frame"] == 3
    assert found["jitter_m"] == {"median": 0.25, "max": 0.5, "at_frame": 3, "count": 3}
    assert found["second_difference_m"] == {"median": 0.5, "max": 1.0, "at_frame": 3, "count": 3}
    shaky = steadiness(rows_of({1: 5.0, 2: 5.2, 3: 3.0, 4: 6.0, 6: 6.0}), "distance_m")
    assert shaky is not None and not shaky["monotone"]
    assert (shaky["not_falling"], shaky["not_rising"]) == ("2", "6")
    assert shaky["jitter_m"]["count"] == 2  # no second difference across a gap


def test_points_that_stand_alone_are_left_out():
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.linspace(-1, 1, 40), np.linspace(-1, 1, 40))
    wall = np.column_stack([x.ravel(), y.ravel(), rng.normal(4, 0.01, 1600)])
    strays = rng.uniform([-1, -1, 1], [1, 1, 3], (12, 3))
    said = outliers(np.vstack([wall, strays]))
    assert said[1600:].all() and said[:1600].mean() < 0.02
    assert not outliers(wall[:5]).any()


POINT = st.tuples(*[st.floats(-1e6, 1e6)] * 3, *[st.integers(0, 255)] * 3)


@given(st.lists(POINT, max_size=5), st.text(max_size=20))
def test_any_cloud_survives_a_ply_file(points, comment):
    """To the millimetre: at an easting of 500 km float32 knows steps of 3 cm."""
    table = np.array(points, float).reshape(-1, 6)
    data = ply_bytes(table[:, :3], table[:, 3:].astype(np.uint8), [comment])
    header, _, body = data.partition(b"\nend_header\n")
    assert header.isascii() and f"element vertex {len(points)}\n".encode() in header
    assert b"\r" not in header and header.count(b"\n") == 9  # a comment may say "end_header"
    read = np.frombuffer(body, FAR_VERTEX if b"property double x" in header else VERTEX)
    for name, column in zip(VERTEX.names, table.T, strict=True):
        assert np.abs(read[name] - column).max(initial=0) < 0.001


def test_no_cloud_of_what_is_no_number():
    refuses("not finite", ply_bytes, np.array([[0, 0, np.nan]]), np.zeros((1, 3), np.uint8))


@pytest.mark.mission
def test_the_towers_depth(mission_dir, tmp_path, told):
    """Against the mission's own figures; a calibration fitted on frames of this dive."""
    options = ("--frames", "30,170,186,205", "--pictures", "none", "--out", tmp_path)
    calibration = mission_dir.parent / "calibration.yml"
    found = told("depth", mission_dir, "--calibration", calibration, *options)
    rows = {row["frame"]: row for row in found["rows"]}
    medians = [rows[frame]["median_m"] for frame in (170, 186, 205)]
    assert medians == pytest.approx([5.1, 1.84, 4.8], rel=0.05)
    assert rows[30]["status"] == 0 and rows[30]["valid_fraction"] <= 1e-5
