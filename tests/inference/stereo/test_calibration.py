import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.calls import refuses
from tokt.inference.stereo.calibration import load_calibration, oddities, read_calibration
from tokt.inference.stereo.calibration_files import folds_back_at_px

from .plain_rig import store_parts

CAMERA = np.array([[600.0, 0, 319.5], [0, 600.0, 239.5], [0, 0, 1]])
PARTS = {"K1": CAMERA, "D1": np.zeros(5), "K2": CAMERA, "D2": np.zeros((1, 5)), "R": np.eye(3)}
PARTS |= {"T_mm": np.array([[-300.0], [1.0], [2.0]]), "image_width": 640, "image_height": 480}


@pytest.fixture
def write(tmp_path):
    def write_calibration(name: str = "c.yml", **changes: Any) -> Path:
        parts = {key: value for key, value in {**PARTS, **changes}.items() if value is not None}
        return store_parts(tmp_path / name, parts)

    return write_calibration


@pytest.mark.parametrize("name", ["c.yml", "c.json"])
def test_a_calibration_is_read(write, name):
    calibration = load_calibration(write(name))
    assert calibration.frame_size == (640, 480)
    assert calibration.D2.shape == (5,) and calibration.T_mm.shape == (3, 1)
    assert np.linalg.norm(calibration.T_mm) == pytest.approx(300.008, abs=1e-3)


turned = cv2.Rodrigues(np.array([0.0, 0.3, 0.0]))[0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"K1": None}, "has no K1"),
        ({"K1": np.eye(2)}, "K1 must be 3x3"),
        ({"K1": -CAMERA}, r"K1 \(left\) is not a camera matrix"),
        ({"D1": np.zeros(3)}, "D1 must hold"),
        ({"D1": np.array([0.1, np.nan, 0, 0, 0])}, "D1 holds a number that is not finite"),
        ({"T_mm": np.zeros(2)}, "T_mm must hold 3"),
        ({"T_mm": np.zeros(3)}, "side by side"),
        ({"T_mm": np.array([10.0, 300.0, 0.0])}, "side by side"),
        ({"T_mm": np.array([300.0, 0.0, 0.0])}, "left of the left"),
        ({"R": 2 * np.eye(3)}, "R is not a rotation"),
        ({"image_width": 100}, r"principal point of K1 \(left\) lies outside"),
        ({"R1": np.eye(3)}, "R1 and R2 must both"),
        ({"R1": np.eye(3), "R2": turned}, "do not belong"),
        ({"K2": 7}, "has no K2"),
        ({"image_width": 640.5}, "not a width and a height"),
        ({"format_version": 2}, "a newer tokt"),
    ],
)
def test_what_is_wrong_is_said(write, changes, message):
    refuses(message, load_calibration, write(**changes))


BARREL = np.array([-0.9, 0.0, 0.0, 0.0, 0.0])  # r (1 - 0.9 r^2) turns back at r = 0.609


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, None),
        ({"K2": CAMERA * [[1.1], [1.1], [1]]}, "focal lengths of the cameras differ"),
        ({"K1": CAMERA * [[1], [1.03], [1]]}, "fx and fy differ by more than 2 %"),
        ({"K1": np.add(CAMERA, [[0, 0, 150], [0, 0, 0], [0, 0, 0]])}, "150 px from the"),
        ({"K1": np.add(CAMERA, [[0, 6, 0], [0, 0, 0], [0, 0, 0]])}, "skew 6 px is left.* 2.4 px"),
        ({"D1": BARREL}, "folds back 243 px"),  # 600 * 0.6086 * 2 / 3
        ({"D1": -BARREL}, None),
        ({"D2": np.array([0, 0, 0.1, 0, 0])}, "order k1 k2 p1 p2 k3"),
        ({"T_mm": np.array([-0.3, 0, 0])}, "0.3 mm apart: is T in metres"),
        ({"T_mm": np.array([-3000.0, 0, 0])}, "3000 mm apart$"),
        ({"R": turned}, "turned by 17.2 degrees"),
        ({"K1": CAMERA * [[0.01, 1, 1], [1, 0.01, 1], [1, 1, 1]]}, "focal length of 6 px"),
        ({"image_width": None}, "taken for 1360x1024"),
        ({"T_mm": None, "T": np.array([-300.0, 0, 0])}, "no unit: it is taken for millimetres"),
    ],
)
def test_what_is_odd_is_said(write, changes, words):
    described = read_calibration(write(**changes))
    assert described.usable() is described.calibration
    found = [oddity for oddity in described.oddities if words and re.search(words, oddity)]
    assert len(found) == 1 if words else not described.oddities, described.oddities
    assert described.calibration.K1[0, 1] == 0  # cv2 would ignore it
    if not any("skew" in oddity or "taken for" in oddity for oddity in found):
        assert oddities(described.calibration) == described.oddities


def test_a_distortion_folds_where_cv2_says_so():
    radius = np.linspace(0, 1, 2000)
    points = np.stack([radius, 0 * radius, 0 * radius + 1], axis=1)
    seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), CAMERA, BARREL)
    folds_at_px = seen[:, 0, 0].max() - CAMERA[0, 2]
    assert folds_back_at_px(CAMERA, BARREL, (640, 480)) == pytest.approx(folds_at_px, abs=0.01)


@pytest.mark.mission
def test_the_mission_s_calibration(calibration_path):
    calibration = load_calibration(calibration_path)
    assert calibration.frame_size == (1360, 1024)
    assert np.linalg.norm(calibration.T_mm) == pytest.approx(305.47, abs=0.01)
