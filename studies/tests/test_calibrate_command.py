"""`tokt calibrate` and `tokt calibrate --check` on a rendered and on the real mission."""

import json
import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.calls import refused, succeeds
from tokt.inference.stereo.calibration import StereoCalibration, load_calibration
from tokt.inference.stereo.calibration_writer import write_calibration
from tokt_studies.simulation.rendering.synthetic_mission import MissionScene

WIDTH, FRAMES = 480, range(80, 100, 2)


def told(*arguments):
    """Run a command that must end well; the JSON that it prints."""
    return json.loads(succeeds(*arguments, "--json").out)


@dataclass(frozen=True)
class Rendered:
    """The near part of a rendered approach, and its true cameras."""

    path: Path
    truth: StereoCalibration
    true_file: Path


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrate") / "near"
    for part in ("Left", "Right", "masks", "depth"):
        (folder / part).mkdir(parents=True)
    scene = MissionScene.draw(1, 120, WIDTH)
    for frame in FRAMES:
        scene.render(folder, frame)
    rig = scene.rig
    cameras = (rig.left, np.zeros(5), rig.right, np.zeros(5))
    pose = (rig.rotation, rig.translation_m.reshape(3, 1) * 1000)
    truth = StereoCalibration(*cameras, *pose, (rig.width, rig.height))
    write_calibration(folder.parent / "truth.yml", truth)
    return Rendered(folder, truth, folder.parent / "truth.yml")


@dataclass(frozen=True)
class Calibrated:
    """What a run said, and what it wrote."""

    said: dict[str, Any]
    file: Path
    report: Path


@pytest.fixture(scope="module")
def calibrated(rendered):
    """Nothing given but the baseline."""
    file, report = rendered.path.parent / "own.yml", rendered.path.parent / "own.html"
    options = ("-o", file, "--baseline", 305.5, "--report", report)
    return Calibrated(told("calibrate", rendered.path, *options), file, report)


def test_recovers_the_rendered_rig(rendered, calibrated):
    found, truth = load_calibration(calibrated.file), rendered.truth
    turned = np.abs(cv2.Rodrigues(found.R @ truth.R.T)[0]).ravel()
    assert turned.max() < 5e-4
    assert turned[1] < 2.5e-4  # the yaw: 0.2 px of disparity
    np.testing.assert_allclose(found.T_mm, truth.T_mm, atol=3)
    assert np.linalg.norm(found.T_mm) == pytest.approx(305.5, abs=1e-6)
    ratio = truth.K2[0, 0] / truth.K1[0, 0]
    assert found.K2[0, 0] / found.K1[0, 0] == pytest.approx(ratio, abs=1e-3)
    # Rendered lenses are straight: at the picture's edge what was found moves less than a pixel.
    k1, k2, r = *found.D1[:2], WIDTH / 2 / found.K1[0, 0]
    assert abs(k1 * r**3 + k2 * r**5) * found.K1[0, 0] < 1
    assert found.frame_size == truth.frame_size


def test_its_held_out_figures(calibrated):
    said = calibrated.said
    assert said["held_out"] is True
    assert said["fit_frames"] == "80,84,88,92,96"
    assert said["test_frames"] == "82,86,90,94,98"
    error = said["vertical_error"]
    assert error["before"]["median"] > 1
    assert error["after"]["median"] < 0.3 and error["after"]["p90"] < 0.8
    cells = [cell for row in error["after_by_region"] for cell in row if cell]
    assert sum(cell["matches"] for cell in cells) == error["after"]["matches"]
    verdicts = {one["name"]: one["verdict"] for one in said["parameters"]}
    assert verdicts["baseline"] == "not fixed by the data"


def test_the_report_needs_no_other_file(calibrated):
    page = calibrated.report.read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 4
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert f"{calibrated.said['vertical_error']['after']['median']:.2f} px" in page


def test_check_tells_good_shifted_and_unusable(rendered, tmp_path, run_tokt):
    truth = rendered.truth
    low = truth.K2.copy()
    low[1, 2] += 2.5  # the right rows are off by so much
    turned = cv2.Rodrigues(np.array([0.0, 0.0, 0.06]))[0] @ truth.R
    cases = {"good": truth, "shifted": replace(truth, K2=low), "unusable": replace(truth, R=turned)}
    for state, calibration in cases.items():
        file = tmp_path / f"{state}.yml"
        write_calibration(file, calibration)
        options = ("--calibration", file, "--json", "--frames", "84,90")
        ran = run_tokt("calibrate", "--check", rendered.path, *options)
        said = json.loads(ran.out)
        assert (said["state"], ran.code) == (state, 0 if state == "good" else 1), said
    assert said["vertical_error"]["median"] > 1


def test_a_shift_is_measured(rendered, tmp_path, run_tokt):
    """The right pictures stand 2 px too high: a trim of +2 px moves them down again."""
    moved = tmp_path / "moved"
    shutil.copytree(rendered.path / "Left", moved / "Left")
    (moved / "Right").mkdir()
    for frame in (84, 90):
        name = f"sim_R_{frame}.jpg"
        picture = cv2.imread(str(rendered.path / "Right" / name))
        cv2.imwrite(str(moved / "Right" / name.replace("jpg", "png")), np.roll(picture, -2, axis=0))
    # Neither a file that is no picture, the first of all, nor frames of another size matter.
    (moved / "Left" / "sim_L_1.jpg").write_bytes(b"no picture")
    (moved / "Right" / "sim_R_1.jpg").write_bytes(b"no picture")
    noise = np.random.default_rng(0).integers(0, 255, (90, 120), np.uint8)
    for side in ("Left", "Right"):
        cv2.imwrite(str(moved / side / f"sim_{side[0]}_200.png"), noise)
    ran = run_tokt("calibrate", "--check", moved, "--calibration", rendered.true_file)
    assert ran.code == 1
    assert re.search(r"shifted: .* a trim of \+[12]\.\d px .*moved down", ran.out), ran.out


def test_what_cannot_be_done_is_one_line(rendered, tmp_path):
    water = tmp_path / "water"
    for side in ("Left", "Right"):
        (water / side).mkdir(parents=True)
        cv2.imwrite(str(water / side / "w_1.png"), np.full((64, 96), 20, np.uint8))
    out = tmp_path / "own.yml"
    near, left = rendered.path, rendered.path / "Left"
    cases = {
        (near,): "give -o FILE",
        (near, "-o", tmp_path / "own.txt"): "a calibration file ends in",
        (near, "-o", tmp_path / "none" / "own.yml"): "there is no folder",
        (left, "-o", out): "has no pairs",
        (water, "-o", out): "no frame has enough points",
        (near, "-o", out, "--baseline", "-3"): "--baseline is a positive number",
        (near, "-o", out, "--frames", "90", "--fit", "even"): "no frame is left to test on",
        (near, "--check"): "--check needs --calibration",
        (near, "-o", out, "--focal", "800", "--start", rendered.true_file): "not both",
    }
    for arguments, words in cases.items():
        assert words in refused("", "calibrate", *arguments).splitlines()[-1]
        assert not out.exists()


def test_starts_from_a_file(rendered, tmp_path):
    """K and D as given, principal point and distortion included; only the standing is found."""
    start, out = tmp_path / "start.yml", tmp_path / "own.json"
    lens = np.array([0.01, 0.02, 0.0, 0.0, 0.0])
    odd = rendered.truth.K1.copy()
    odd[:2, 2] += 3, -2
    write_calibration(start, replace(rendered.truth, K1=odd, D1=lens, D2=lens))
    options = ("--start", start, "--frames", "86-92", "--fit", "all")
    ran = succeeds("calibrate", rendered.path, "-o", out, *options)
    found = load_calibration(out)
    np.testing.assert_allclose(found.K1, odd)
    np.testing.assert_allclose(found.D1, lens)
    assert "NOT held out" in ran.out


@pytest.mark.mission
def test_the_real_mission_fit_even_tested_odd(mission_dir, tmp_path):
    """Fourteen frames, for time; the reference's depths are in the mission's README."""
    out = tmp_path / "own.yml"
    options = ("--fit", "even", "--frames", "170-175,180-183,194-197")
    error = told("calibrate", mission_dir, "-o", out, *options)["vertical_error"]
    assert error["before"]["median"] > 60
    assert error["after"]["median"] <= 0.6 and error["after"]["p90"] <= 1.6
    found = load_calibration(out)
    reference = load_calibration(mission_dir.parent / "calibration.yml")
    turned = np.abs(cv2.Rodrigues(found.R @ reference.R.T)[0]).ravel()
    assert turned[1] < 0.002  # 5 px of the 97 to 370 px of disparity
