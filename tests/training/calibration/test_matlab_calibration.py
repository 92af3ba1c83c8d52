"""Calibrations in MATLAB's binary files, written here by scipy as MATLAB saves them."""

import cv2
import numpy as np
import pytest
from scipy.io import savemat

from tests.calls import refuses
from tokt.inference.stereo.calibration import check_calibration
from tokt.training.calibration.any_form import read_calibration_file
from tokt.training.calibration.matlab_file import matlab_numbers, read_matlab_numbers

K_LEFT = np.array([[600.0, 0, 319.5], [0, 601.0, 239.25], [0, 0, 1]])
K_RIGHT = np.array([[605.0, 0, 310.5], [0, 606.0, 243.25], [0, 0, 1]])
TURN = np.array([0.01, -0.02, 0.03])
SHIFT_MM = np.array([-300.0, 2.0, 3.0])


def stereo_params(unit="millimeters", K="IntrinsicMatrix"):
    """The struct of toStruct(stereoParams) for cameras K_LEFT and K_RIGHT."""

    def camera(matrix):
        counted_from_1 = np.add(matrix, [[0, 0, 1], [0, 0, 1], [0, 0, 0]])
        return {
            K: counted_from_1.T if K == "IntrinsicMatrix" else counted_from_1,
            "RadialDistortion": np.array([[0.1, 0.2, 0.3]]),
            "TangentialDistortion": np.array([[0.01, 0.02]]),
            "ImageSize": np.array([[480.0, 640.0]]),
            "WorldUnits": unit,
            "EstimateSkew": False,
        }

    R = np.asarray(cv2.Rodrigues(TURN)[0])
    return {
        "CameraParameters1": camera(K_LEFT),
        "CameraParameters2": camera(K_RIGHT),
        "RotationOfCamera2": R.T,
        "TranslationOfCamera2": SHIFT_MM[None] / (1000 if unit == "m" else 1),
    }


def bouguet():
    """The variables of Calib_Results_stereo.mat, as columns."""
    sides = {"left": K_LEFT, "right": K_RIGHT}
    values = {"om": TURN[:, None], "R": cv2.Rodrigues(TURN)[0], "nx": 640.0}
    values |= {"T": SHIFT_MM[:, None], "ny": 480.0, "active_images": np.ones(14)}
    for side, K in sides.items():
        values[f"fc_{side}"] = np.diag(K)[:2, None]
        values[f"cc_{side}"] = K[:2, 2:]
        values[f"alpha_c_{side}"] = 0.0
        values[f"kc_{side}"] = np.array([[0.1], [0.2], [0.01], [0.02], [0.3]])
    return values


def read(path):
    return check_calibration(matlab_numbers(path))


@pytest.mark.parametrize(
    ("content", "form"),
    [
        (bouguet(), "Bouguet"),
        ({"stereoParams": stereo_params()}, "stereoParams"),
        ({"s": stereo_params("m", K="K")}, "stereoParams"),
        ({"calibrationSession": {"CameraParameters": stereo_params()}}, "stereoParams"),
    ],
)
def test_both_toolboxes_files(tmp_path, content, form):
    savemat(tmp_path / "c.mat", content, do_compression=True)
    described = read(tmp_path / "c.mat")
    found = described.usable()
    assert form in described.form and found.frame_size == (640, 480)
    assert np.allclose(found.K1, K_LEFT) and np.allclose(found.K2, K_RIGHT)
    assert found.D1.tolist() == [0.1, 0.2, 0.01, 0.02, 0.3]  # k1 k2 p1 p2 k3
    assert np.allclose(found.R, cv2.Rodrigues(TURN)[0], atol=1e-15)
    assert found.T_mm.ravel() == pytest.approx(SHIFT_MM)
    assert not described.oddities


def without(name, side=None):
    params = stereo_params()
    del (params if side is None else params[side])[name]
    return {"s": params}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"x": 1.0}, "neither fc_left nor"),
        ({**bouguet(), "fc_left": np.ones(3)}, "fc_left must hold 2 numbers"),
        ({**bouguet(), "kc_left": np.ones(3)}, "k1 k2 p1 p2 k3"),
        ({**bouguet(), "T": [np.nan, 0, 0]}, "T holds a number that is not finite"),
        (without("RotationOfCamera2"), "no RotationOfCamera2"),
        (without("IntrinsicMatrix", "CameraParameters1"), "no 3x3 IntrinsicMatrix"),
    ],
)
def test_what_is_missing_is_said(tmp_path, content, message):
    savemat(tmp_path / "c.mat", content)
    refuses(message, matlab_numbers, tmp_path / "c.mat")


def test_an_unknown_unit_is_odd(tmp_path):
    savemat(tmp_path / "c.mat", {"s": stereo_params("furlongs")})
    described = read(tmp_path / "c.mat")
    odd = "the translation has the unknown unit 'furlongs': it is taken for millimetres"
    assert described.oddities == [odd]


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (b"MATLAB 7.3 MAT-file, Platform: GLNXA64", "MATLAB 7.3: save it with -v7"),
        (b"\x89HDF\r\n\x1a\n", "MATLAB 7.3: save it with -v7"),
        (b"", "not a MATLAB 5 or 7 file"),
        (bytes(200), "not a MATLAB 5 or 7 file"),
    ],
)
def test_other_versions_are_refused(tmp_path, start, message):
    (tmp_path / "c.mat").write_bytes(start + bytes(600 if start else 0))
    refuses(message, matlab_numbers, tmp_path / "c.mat")


def test_a_file_that_scipy_crashes_on_is_damaged(tmp_path):
    path = tmp_path / "c.mat"
    savemat(path, {"s": stereo_params()})
    assert read_calibration_file(path, print).frame_size == (640, 480)
    content = bytearray(path.read_bytes())
    assert content[520] == 9  # the type of a field's numbers: double
    content[520] = 0
    path.write_bytes(content)
    refuses("damaged", read_matlab_numbers, path)
