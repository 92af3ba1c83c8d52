"""Calibration from checkerboard pictures, rendered here through known cameras."""

import shutil

import cv2
import numpy as np
import pytest

from tests.calls import refused, refuses
from tests.inference.test_faults import hold_row
from tokt.inference.stereo.calibration import StereoCalibration, load_calibration
from tokt.training.rig.calibrate.checkerboard import parse_board

CORNERS, SQUARE_MM = (7, 5), 40.0
SIZE = (480, 360)
CELL = 60  # pixels of a square of the flat board


class Cameras:
    """Two known cameras that draw what they see of the board."""

    def __init__(self, calibration):
        self.calibration = calibration
        pixels = np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), axis=-1)
        pixels = pixels.reshape(-1, 1, 2).astype(np.float64)
        self._rays = []
        for K, D in ((calibration.K1, calibration.D1), (calibration.K2, calibration.D2)):
            steps = (cv2.TERM_CRITERIA_COUNT, 20, 0)
            rays = cv2.undistortPoints(pixels, K, D, criteria=steps)[:, 0]
            self._rays.append(np.column_stack([rays, np.ones(len(rays))]))
        self._flat = cv2.GaussianBlur(_flat_board(), (0, 0), 4.0)

    def picture(self, side, turn, at_mm):
        """The board, turned, its first corner at `at_mm` in the left camera's axes."""
        R, t = cv2.Rodrigues(turn)[0], at_mm.reshape(3, 1)
        if side == 1:
            R, t = self.calibration.R @ R, self.calibration.R @ t + self.calibration.T_mm
        # A ray meets the board's plane where [r1 r2 t]^-1 sends it.
        plane = np.linalg.inv(np.column_stack([R[:, 0], R[:, 1], t]))
        on_board = self._rays[side] @ plane.T
        squares = on_board[:, :2] / on_board[:, 2:] / SQUARE_MM
        place = ((squares + 2) * CELL - 0.5).astype(np.float32).reshape(SIZE[1], SIZE[0], 2)
        white = (None, cv2.BORDER_CONSTANT, 235)
        return cv2.remap(self._flat, place, None, cv2.INTER_LINEAR, *white)


def _flat_board():
    """The board from straight above with a white rim; its first inner corner at (2, 2) squares."""
    rows, cols = CORNERS[1] + 3, CORNERS[0] + 3
    squares = np.indices((rows, cols)).sum(axis=0) % 2 * 215 + 20
    squares[[0, -1]] = 235
    squares[:, [0, -1]] = 235
    return np.kron(squares, np.ones((CELL, CELL))).astype(np.uint8)


@pytest.fixture(scope="module")
def cameras():
    def matrix(focal, x, y):
        return np.array([[focal, 0, x], [0, focal, y], [0, 0, 1.0]])

    left = (matrix(520.0, 236.0, 184.0), np.array([-0.20, 0.08, 0.001, -0.0005, 0.0]))
    right = (matrix(526.0, 246.0, 175.0), np.array([-0.18, 0.05, 0.0, 0.001, 0.0]))
    turn = cv2.Rodrigues(np.array([0.02, 0.03, -0.01]))[0]
    return Cameras(
        StereoCalibration(*left, *right, turn, np.array([[-120.0], [3.0], [-2.0]]), SIZE)
    )


@pytest.fixture(scope="module")
def boards(cameras, tmp_path_factory):
    """Fourteen pairs; the board all over the picture, near and far, tilted every way."""
    folder = tmp_path_factory.mktemp("boards")
    rng = np.random.default_rng(3)
    half = np.array([(CORNERS[0] - 1) / 2, (CORNERS[1] - 1) / 2, 0]) * SQUARE_MM
    for side in ("Left", "Right"):
        (folder / side).mkdir()
    for number in range(1, 15):
        turn = rng.uniform(-0.5, 0.5, 3)
        away = rng.uniform(560, 800)
        middle = np.array([60 + 0.13 * away * rng.uniform(-1, 1), 90 * rng.uniform(-1, 1), away])
        at = middle - cv2.Rodrigues(turn)[0] @ half
        for index, side in enumerate(("Left", "Right")):
            picture = cameras.picture(index, turn, at)
            cv2.imwrite(str(folder / side / f"b_{number}.png"), picture)
    return folder


def test_recovers_the_cameras(cameras, boards, tmp_path, told):
    file = tmp_path / "board.yml"
    said = told("calibrate", boards, "--board", "7x5", "--square", SQUARE_MM, "-o", file)
    truth, found = cameras.calibration, load_calibration(file)
    assert said["boards"] == said["pairs"] == 14
    assert said["reprojection_px"]["stereo"] < 0.15
    # Four of the fourteen took no part in the rig that the vertical error is of.
    assert said["test_frames"] == "2,6,10,14"
    held_out = said["vertical_error"]["after"]
    assert held_out["matches"] == 4 * CORNERS[0] * CORNERS[1]
    assert held_out["median"] < 0.15
    assert found.frame_size == SIZE
    for K, true in ((found.K1, truth.K1), (found.K2, truth.K2)):
        np.testing.assert_allclose(np.diag(K)[:2], np.diag(true)[:2], rtol=0.005)
        np.testing.assert_allclose(K[:2, 2], true[:2, 2], atol=2.5)
    for D, true in ((found.D1, truth.D1), (found.D2, truth.D2)):
        np.testing.assert_allclose(D[0], true[0], atol=0.03)
    turned = cv2.Rodrigues(found.R @ truth.R.T)[0]
    assert np.abs(turned).max() < 0.003
    np.testing.assert_allclose(found.T_mm, truth.T_mm, atol=1.0)


def test_too_few_boards_are_one_line(boards, tmp_path, refused):
    few = tmp_path / "few"
    for side in ("Left", "Right"):
        (few / side).mkdir(parents=True)
        for number in (1, 2, 3):
            shutil.copy(boards / side / f"b_{number}.png", few / side)
        cv2.imwrite(str(few / side / "b_4.png"), np.full((SIZE[1], SIZE[0]), 20, np.uint8))
    file = tmp_path / "no.yml"
    why = "tokt: error: 3 of 4 pairs show the whole"
    refused(why, "calibrate", few, "--board", "7x5", "--square", 40, "-o", file)
    assert not file.exists()


def test_board_words():
    assert parse_board("9x6") == (9, 6)
    for text in ("9", "9x", "1x6", "9x60", "x", "9*6", "-9x6"):
        refuses("inner corners", parse_board, text)


@pytest.mark.parametrize("board", [(), ("--board", "9x6", "--square", 25)])
def test_pictures_that_cannot_be_read_are_named(tmp_path, board):
    """Without it, it was said of 12-bit levels in 16 bits that no picture shows the board."""
    for camera in ("Left", "Right"):
        (tmp_path / camera).mkdir()
        levels = np.full((40, 60), 4095, np.uint16)
        assert cv2.imwrite(str(tmp_path / camera / "a_1.png"), levels)
    words = "a_1.png: its 16-bit pixels leave the upper bits empty"
    refused(words, "calibrate", tmp_path, *board, "-o", tmp_path / "rig.yml")
    hold_row(
        "12-bit levels in all 16-bit images of a board",
        "refused in one line that names the remedy, code 2",
        "nothing",
    )
