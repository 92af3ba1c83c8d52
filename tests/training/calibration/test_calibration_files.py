"""Every text form of a calibration file, written here as its tool writes it."""

import json
import re
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import refused, refuses, succeeds
from tests.inference.conftest import write_mission
from tests.inference.stereo.plain_rig import store_parts
from tests.tiers import scaled
from tokt.inference.stereo.calibration import StereoCalibration, load_calibration
from tokt.inference.stereo.calibration_writer import write_calibration
from tokt.training.calibration.any_form import describe_calibration_file, read_calibration_file

MATRIX = "{}: !!opencv-matrix\n   rows: 3\n   cols: {}\n   dt: d\n   data: [ {} ]\n"
LENS = "{}: !!opencv-nd-matrix\n   sizes: [ 5 ]\n   dt: d\n   data: [ {} ]\n"
OF_YESTERDAY = (
    "%YAML 1.2\n---\n"
    + MATRIX.format("K1", 3, "2222.7, 0., 679.5, 0., 2222.7, 511.5, 0., 0., 1.")
    + LENS.format("D1", "0.25, 0.5, 0., 0., 0.125")
    + MATRIX.format("K2", 3, "2231.25, 0., 679.5, 0., 2231.25, 511.5, 0., 0., 1.")
    + LENS.format("D2", "0.25, 0.5, 0., 0., 0.")
    + MATRIX.format("R", 3, "1., 0., 0., 0., 1., 0., 0., 0., 1.")
    + MATRIX.format("T_mm", 1, "-305.5, 1.5, 2.")
)
VERSION_1 = OF_YESTERDAY.replace(
    "---\n", "---\nformat_version: 1\nimage_width: 1400\nimage_height: 1040\n"
)

BOUGUET_SCREEN = """Stereo calibration parameters after loading the individual calibration files:

Focal Length:          fc_left = [ 1.0   1.0 ]

Stereo calibration parameters after optimization:

Intrinsic parameters of left camera:

Focal Length:          fc_left = [ 533.00371   533.15260 ] \xb1 [ 1.07629   1.10913 ]
Principal point:       cc_left = [ 341.58612   234.25940 ] \xb1 [ 1.24041   1.33065 ]
Skew:             alpha_c_left = [ 0.00000 ] \xb1 [ 0.00000  ]   => angle = 90.00000
Distortion:            kc_left = [ -0.28838   0.09714   0.00109  -0.00030  0.01000 ] \xb1 [ 0.1 ]

Intrinsic parameters of right camera:

Focal Length:          fc_right = [ 536.98262   536.56938 ] \xb1 [ 1.19786   1.15677 ]
Principal point:       cc_right = [ 326.47209   249.33257 ] \xb1 [ 1.36588   1.34252 ]
Skew:             alpha_c_right = [ 0.00000 ] \xb1 [ 0.00000  ]
Distortion:            kc_right = [ -0.28936   0.10677   -0.00078  0.00020  0.00000 ] \xb1 [ 0.1 ]

Extrinsic parameters (position of right camera wrt left camera):

Rotation vector:             om = [ 0.00669   0.00452  -0.00350 ] \xb1 [ 0.00270   0.00308 ]
Translation vector:           T = [ -99.80198   1.12443   0.05041 ] \xb1 [ 0.14200   0.11352 ]
"""

THESIS = {
    "left": {"fx": 900, "fy": 901, "cx": 650, "cy": 500, "skew": 0,
             "k": [0.25, 0.5, -0.125, 0.0625, 0.0], "p": [0.001, 0.002, 0, 0.003]},
    "right": {"fx": 905, "fy": 906, "cx": 640, "cy": 510, "skew": 0, "k": [0.25], "p": []},
    "rotation_vector_rad": [0.0, 0.02, 0.0], "translation_mm": [-303.5, 1, 2],
}  # fmt: skip


@pytest.mark.parametrize(
    ("text", "size"), [(OF_YESTERDAY, (1360, 1024)), (VERSION_1, (1400, 1040))]
)
def test_files_of_earlier_versions_are_read(tmp_path, text, size):
    (tmp_path / "c.yml").write_text(text)
    calibration = load_calibration(tmp_path / "c.yml")
    assert calibration.frame_size == size
    assert calibration.D1.tolist() == [0.25, 0.5, 0, 0, 0.125]
    assert calibration.K2[0, 0] == 2231.25 and calibration.T_mm.ravel().tolist() == [-305.5, 1.5, 2]


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_bouguet_s_screen_output(tmp_path, encoding):
    (tmp_path / "c.txt").write_bytes(BOUGUET_SCREEN.encode(encoding))
    described = describe_calibration_file(tmp_path / "c.txt")
    found = replace(described.calibration, frame_size=(640, 480))
    assert described.form == "Bouguet toolbox text" and not described.refusals
    assert found.K1[0, 0] == 533.00371  # after the optimisation
    assert found.D1.tolist() == [-0.28838, 0.09714, 0.00109, -0.0003, 0.01]
    # The same point through the toolbox's published formulas, with pixels counted from 0.
    left = np.array([40.0, -30.0, 500.0])
    om, T = np.array([0.00669, 0.00452, -0.0035]), np.array([-99.80198, 1.12443, 0.05041])
    x, y, z = cv2.Rodrigues(om)[0] @ left + T
    a, b = x / z, y / z
    r2 = a * a + b * b
    k1, k2, p1, p2, k3 = -0.28936, 0.10677, -0.00078, 0.0002, 0.0
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = 536.98262 * (a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)) + 326.47209
    v = 536.56938 * (b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b) + 249.33257
    turn = cv2.Rodrigues(found.R)[0]
    seen, _ = cv2.projectPoints(left[None], turn, found.T_mm, found.K2, found.D2)
    assert seen.ravel() == pytest.approx([u, v], abs=1e-9)


def test_bouguet_s_script_with_a_size_and_skew(tmp_path):
    (tmp_path / "c.m").write_text(
        "% a comment: fc_left = [ 1 1 ];\nfc_left = [ 600 ; 600 ];\ncc_left=[320 ...\n 240];\n"
        "alpha_c_left = 0.01;\nkc_left = [0.1;0.2;0.001;0.002];\nfc_right = [ 600 ; 600 ];\n"
        "cc_right = [ 321.0 ; 241.0 ];\nkc_right = [ 0 ; 0 ; 0 ; 0 ; 0 ];\n"
        "R = [ 1 0 0 ; 0 0.8 -0.6 ; 0 0.6 0.8 ];\nT = [ -300 ; 0 ; 0 ];\nnx = 640;\nny = 480;\n"
    )
    described = describe_calibration_file(tmp_path / "c.m")
    assert described.calibration.frame_size == (640, 480)
    assert described.calibration.R[1].tolist() == [0, 0.8, -0.6]
    assert described.calibration.K1[0, 1] == 0
    assert any("skew 6 px is left out" in oddity for oddity in described.oddities)


def test_the_thesis_s_printed_form(tmp_path):
    (tmp_path / "c.json").write_text(json.dumps(THESIS))
    described = describe_calibration_file(tmp_path / "c.json")
    found = described.calibration
    assert found.D1.tolist() == [0.25, 0.5, 0.001, 0.002, -0.125]  # k1 k2 p1 p2 k3
    assert found.D2.tolist() == [0.25, 0, 0, 0, 0]
    assert np.allclose(found.R, cv2.Rodrigues(np.array([0, 0.02, 0]))[0], atol=1e-15)
    assert described.usable().T_mm.ravel().tolist() == [-303.5, 1, 2]
    assert "left: k4 = 0.0625, p4 = 0.003 has no place" in described.oddities[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"left": {}}, "left has no fx, fy, cx, cy, k"),
        ({"right": 3}, "right is not a camera"),
        ({"left": {**THESIS["left"], "fx": float("nan")}}, "not a finite number"),
        ({"translation_mm": [303.5, 1, 2]}, "right camera's position C"),
        ({"rotation_vector_rad": [1e300, 0, 0]}, "beyond 1e"),
    ],
)
def test_printed_tables_that_are_wrong(tmp_path, change, message):
    (tmp_path / "c.json").write_text(json.dumps({**THESIS, **change}))
    refuses(message, read_calibration_file, tmp_path / "c.json", print)


@pytest.mark.parametrize(
    "names",
    [
        {"K1": "M1", "K2": "M2", "T_mm": "T", "unit": "mm"},
        {"K1": "cameraMatrix1", "D1": "distCoeffs1", "K2": "cameraMatrix2", "D2": "distCoeffs2"},
    ],
)
def test_other_names_and_plain_lists(tmp_path, names):
    parts = {"K1": [[600, 0, 319.5], [0, 600, 239.5], [0, 0, 1]], "D1": [0.1, 0.2, 0, 0, 0.3]}
    parts |= {"K2": parts["K1"], "D2": [0, 0, 0, 0], "R": np.eye(3).tolist(), "T_mm": [-300, 0, 0]}
    content = {names.get(name, name): value for name, value in parts.items()}
    content |= {"image_size": [640, 480]} | {key: names[key] for key in names if key == "unit"}
    (tmp_path / "c.json").write_text(json.dumps(content))
    described = describe_calibration_file(tmp_path / "c.json")
    assert not described.oddities and described.usable().D1[4] == 0.3
    assert described.calibration.K1.tolist() == parts["K1"]


@pytest.mark.parametrize(("unit", "factor"), [("m", 1000), ("Meters", 1000), ("cm", 10)])
def test_units_are_read(tmp_path, unit, factor):
    text = VERSION_1.replace("T_mm:", "T:").replace("[ -305.5, 1.5, 2. ]", "[ -0.5, 0., 0. ]")
    (tmp_path / "c.yml").write_text(text + f'units: "{unit}"\n')
    found = load_calibration(tmp_path / "c.yml").T_mm
    assert found.ravel().tolist() == [-0.5 * factor, 0, 0]


@pytest.mark.parametrize(
    ("name", "content", "form"),
    [
        ("c.mat", b"anything", "a MATLAB file"),
        ("c.txt", BOUGUET_SCREEN.encode("cp1252"), "a Bouguet toolbox export"),
        ("c.json", json.dumps(THESIS).encode(), "a printed table"),
    ],
    ids=["matlab", "bouguet", "printed"],
)
def test_a_run_reads_opencv_s_form_alone_and_names_the_command(tmp_path, name, content, form):
    (tmp_path / name).write_bytes(content)
    said = refuses(f"is {form}: convert it first", load_calibration, tmp_path / name)
    assert f"`tokt calibrate {tmp_path / name} -o FILE.yml`" in said
    write_mission(tmp_path / "dive", [[]])
    about = ("--calibration", tmp_path / name, "--policy", "disparity")
    assert f"is {form}: convert it first" in refused(
        "", "run", "--source", tmp_path / "dive", *about
    )


@pytest.mark.parametrize(
    ("name", "content"),
    [("c.txt", BOUGUET_SCREEN), ("c.json", json.dumps(THESIS))],
    ids=["bouguet", "printed"],
)
def test_another_tool_s_file_is_converted(tmp_path, name, content):
    (tmp_path / name).write_text(content, "utf-8")
    ran = succeeds("calibrate", tmp_path / name, "-o", tmp_path / "rig.yml", "--json")
    told = json.loads(ran.out)
    assert told["frame_size"] == [1360, 1024] and told["form"] in ran.out
    assert "taken for 1360x1024" in ran.err and "taken for 1360x1024" in str(told["oddities"])
    whole = read_calibration_file(tmp_path / name, print)
    for part, value in vars(load_calibration(tmp_path / "rig.yml")).items():
        assert np.array_equal(value, getattr(whole, part)), part
    for words, *options in (
        ("--baseline is for a mission", "--baseline", 300),
        ("--check is for a mission", "--check"),
    ):
        refused(words, "calibrate", tmp_path / name, "-o", tmp_path / "no.yml", *options)
    refused("give -o FILE", "calibrate", tmp_path / name)
    assert not (tmp_path / "no.yml").exists()


def test_two_files_share_the_parts_of_one_calibration(tmp_path):
    """As OpenCV's sample program writes them."""
    head, *parts = re.split(r"(?m)^(?=\w+: !!)", VERSION_1)
    (tmp_path / "intrinsics.yml").write_text(head + "".join(parts[:4]))
    (tmp_path / "extrinsics.yml").write_text(head + "".join(parts[4:]))
    files = (tmp_path / "intrinsics.yml", tmp_path / "extrinsics.yml")
    succeeds("calibrate", *files, "-o", tmp_path / "rig.yml")
    (tmp_path / "whole.yml").write_text(VERSION_1)
    whole = load_calibration(tmp_path / "whole.yml")
    for part, value in vars(load_calibration(tmp_path / "rig.yml")).items():
        assert np.array_equal(value, getattr(whole, part)), part
    said = refused("K1", "calibrate", files[0], files[0], "-o", tmp_path / "no.yml")
    assert "in two files" in said
    refused("has no R, T_mm", "calibrate", files[0], "-o", tmp_path / "no.yml")
    assert not (tmp_path / "no.yml").exists()


inside = st.floats(-1, 1)


@st.composite
def calibrations(draw: st.DrawFn) -> StereoCalibration:
    """Any plausible calibration; numbers need all their digits."""
    width, height = draw(st.integers(64, 3000)), draw(st.integers(48, 3000))

    def camera() -> np.ndarray:
        focal = width * (1.5 + draw(inside))
        x, y = width * (0.5 + 0.3 * draw(inside)), height * (0.5 + 0.3 * draw(inside))
        return np.array([[focal, 0, x], [0, focal * 1.01, y], [0, 0, 1]])

    def lens() -> np.ndarray:
        return np.array([0.01 * draw(inside) for _ in range(5)])

    turn = np.array([0.1 * draw(inside) for _ in range(3)])
    shift = np.array([[-300 - draw(inside)], [90 * draw(inside)], [90 * draw(inside)]])
    R = np.asarray(cv2.Rodrigues(turn)[0])
    return StereoCalibration(camera(), lens(), camera(), lens(), R, shift, (width, height))


def bouguet(calibration: StereoCalibration) -> str:
    """What the toolbox would print of it, with all digits."""

    def line(name: str, values: Any) -> str:
        return f"{name} = [ {' ; '.join(repr(float(value)) for value in values)} ];\n"

    text = f"nx = {calibration.frame_size[0]};\nny = {calibration.frame_size[1]};\n"
    cameras = (calibration.K1, calibration.D1), (calibration.K2, calibration.D2)
    for side, (K, D) in zip(("left", "right"), cameras, strict=True):
        text += line(f"fc_{side}", (K[0, 0], K[1, 1])) + line(f"cc_{side}", K[:2, 2])
        text += line(f"kc_{side}", D)
    return text + line("R", calibration.R.ravel()) + line("T", calibration.T_mm.ravel())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("calibrations")


PARTS = ("K1", "D1", "K2", "D2", "R", "T_mm")
words = st.text(st.characters(exclude_categories=["C"]), max_size=60)
written = settings(max_examples=scaled(12))


@pytest.mark.parametrize("name", ["c.yml", "c.json", "c.xml", "c.m"])
@given(calibrations(), words | st.sampled_from(['"', "'", '"both"', "a 'b'", '"first']))
@written
def test_what_is_written_is_read_to_the_last_digit(folder, name, calibration, note):
    path = folder / name
    if name == "c.m":
        path.write_text(bouguet(calibration))
    else:
        write_calibration(path, calibration, {"how": note})
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)  # cv2 alone
        noted = storage.getNode("provenance").getNode("how").string()
        assert noted == " ".join(note.split()).strip("\"'")
        assert np.array_equal(storage.getNode("K2").mat(), calibration.K2)
        storage.release()
    for name, value in vars(read_calibration_file(path, print)).items():
        assert np.array_equal(value, getattr(calibration, name)), name


@given(calibrations(), st.sampled_from(PARTS), st.data())
@written
def test_no_form_takes_a_number_that_is_not_finite(folder, calibration, part, data):
    name = data.draw(st.sampled_from(["n.yml", "n.json", "n.xml", "n.m"]))
    array = getattr(calibration, part).copy()
    place = 2 if part.startswith("K") else data.draw(st.integers(0, array.size - 1))
    array.flat[place] = data.draw(st.sampled_from([np.nan, np.inf, -np.inf]))
    path = folder / name
    broken = replace(calibration, **{part: array})
    if name == "n.m":
        path.write_text(bouguet(broken))
    else:
        store_parts(path, {key: getattr(broken, key) for key in PARTS})
    refuses("not finite", describe_calibration_file, path)


def test_a_calibration_file_appears_whole_or_not_at_all(tmp_path):
    (tmp_path / "c.yml").write_text(VERSION_1)
    known = load_calibration(tmp_path / "c.yml")
    refuses("ends in", write_calibration, tmp_path / "c.txt", known)
    for notes in ({"no word": ""}, {"long": "x" * 3000}):
        with pytest.raises(ValueError, match="no note"):
            write_calibration(tmp_path / "c.yml", known, notes)
    assert (tmp_path / "c.yml").read_text() == VERSION_1
    assert [path.name for path in tmp_path.iterdir()] == ["c.yml"]


@pytest.mark.parametrize("wrong", ["   colz: 3", "   cols: 0", "   cols: 2", "   cols: 2.5", ""])
def test_a_matrix_that_would_end_opencv_s_own_reader(tmp_path, wrong):
    (tmp_path / "c.yml").write_text(OF_YESTERDAY.replace("   cols: 3", wrong, 1))
    refuses("K1", load_calibration, tmp_path / "c.yml")


@pytest.mark.mission
def test_the_thesis_s_printed_table_is_described_and_refused(mission_dir):
    path = mission_dir.parent / "calibration_thesis.json"
    described = describe_calibration_file(path)
    assert described.form == "printed table (JSON)" and len(described.refusals) == 3
    words = r"principal point of K1 .* outside .* left of the left"
    refuses(words, read_calibration_file, path, print)
