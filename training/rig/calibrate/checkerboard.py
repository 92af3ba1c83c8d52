"""Calibrate a stereo rig from pictures of a checkerboard."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from tokt import __version__
from tokt.features.common.arrays import F32, F64, U8
from tokt.features.common.errors import FrameError, ToktError
from tokt.features.frames.mission import LEFT, RIGHT, Mission, format_frames, frame_size
from tokt.inference.stereo.calibration import StereoCalibration

from .frame_selection import Progress, stereo_frames
from .matching import FramePoints, gray_frame
from .vertical_error import VerticalError, vertical_error

MIN_BOARDS = 8
"""Two cameras have some 20 numbers; from fewer boards, tilted too little, they come out wrong."""
_TEST_EACH = 4  # every fourth board is held out of the first fit
_SIDE = range(3, 51)
_STEPS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
_FIND = (cv2.CALIB_CB_ACCURACY, cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE)
"""Evened out, dark pictures give a board that they otherwise would not: and bright ones lose it."""


@dataclass(frozen=True)
class BoardCalibration:
    """A calibration from checkerboards."""

    calibration: StereoCalibration
    frames: list[int]
    looked_at: int
    test_frames: list[int]
    left_px: float  # root mean square reprojection error of a camera alone, or of both together
    right_px: float
    stereo_px: float
    held_out: VerticalError  # on the boards `test_frames`, of a fit to the others

    @property
    def baseline_mm(self) -> float:
        """Distance between the cameras."""
        return float(np.linalg.norm(self.calibration.T_mm))

    @property
    def focal_px(self) -> float:
        """The left focal length."""
        return float(self.calibration.K1[0, 0])

    def notes(self) -> dict[str, str]:
        """How it was made, for the calibration's file."""
        return {
            "made_by": f"tokt {__version__} calibrate --board, {len(self.frames)} boards",
            "reprojection_error": f"{self.stereo_px:.3f} px root mean square",
            "vertical_error": (
                f"median {self.held_out.median_px:.3f} px, p90 {self.held_out.p90_px:.3f} px on "
                f"{len(self.test_frames)} boards held out of a first fit"
            ),
        }

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {
            "boards": len(self.frames),
            "frames": format_frames(self.frames),
            "pairs": self.looked_at,
            "reprojection_px": {
                "left": round(self.left_px, 4),
                "right": round(self.right_px, 4),
                "stereo": round(self.stereo_px, 4),
            },
            "test_frames": format_frames(self.test_frames),
            "vertical_error": {"after": self.held_out.figures()},
            "baseline_mm": round(self.baseline_mm, 3),
            "focal_px": round(self.focal_px, 2),
        }


def parse_board(text: str) -> tuple[int, int]:
    """The inner corners along a board's two sides, as ``9x6``; ToktError unless from 3 to 50."""
    match = re.fullmatch(r"\s*(\d{1,2})\s*[xX]\s*(\d{1,2})\s*", text)
    if match is None or not all(int(side) in _SIDE for side in match.groups()):
        raise ToktError(f"a board is given by its inner corners, as 9x6, not as {text!r}")
    return int(match[1]), int(match[2])


def calibrate_boards(
    mission: Mission, corners: tuple[int, int], square_mm: float, progress: Progress
) -> BoardCalibration:
    """Calibrate both cameras and how they stand from pictures of one board.

    Each camera by Zhang's method (``cv2.calibrateCamera``), then R and T with the cameras kept
    (``cv2.stereoCalibrate``). The mission is a folder with ``Left/`` and ``Right/``, `corners` the
    inner ones along the board's rows and columns, and `square_mm` the side of a square.

    Raises ToktError if no left picture can be read, too few show the whole board, or they differ in
    size.
    """
    present = stereo_frames(mission)
    frame_size(mission)  # where no picture can be read, this says why
    boards, sizes = [], set()
    for frame in progress(present, len(present), "find boards"):
        found = _find(mission, frame, corners)
        if found is not None:
            boards.append(found[0])
            sizes.add(found[1])
    if len(boards) < MIN_BOARDS:
        raise ToktError(
            f"{len(boards)} of {len(present)} pairs show the whole {corners[0]}x{corners[1]} board "
            f"in both pictures; {MIN_BOARDS} are needed, tilted and spread over the picture"
        )
    if len(sizes) > 1:
        raise ToktError("the pictures of the board are not all of one size")
    size = sizes.pop()
    points = _board_points(corners, square_mm)
    test = boards[1::_TEST_EACH]
    fitted = _fit([one for one in boards if one not in test], points, size)[0]
    calibration, left_px, right_px, stereo_px = _fit(boards, points, size)
    return BoardCalibration(
        calibration,
        [one.frame for one in boards],
        len(present),
        [one.frame for one in test],
        left_px,
        right_px,
        stereo_px,
        vertical_error(fitted, test),
    )


def _board_points(corners: tuple[int, int], square_mm: float) -> F32:
    across, down = np.meshgrid(np.arange(corners[0]), np.arange(corners[1]))
    flat = np.stack([across.ravel(), down.ravel(), np.zeros(across.size)], axis=1)
    return (flat * square_mm).astype(np.float32)


def _find(
    mission: Mission, frame: int, corners: tuple[int, int]
) -> tuple[FramePoints, tuple[int, int]] | None:
    """The board's inner corners in both pictures, and their size; None where one lacks it."""
    try:
        images = [gray_frame(mission, frame, camera) for camera in (LEFT, RIGHT)]
    except FrameError:
        return None
    left = _corners(images[0], corners)
    right = None if left is None else _corners(images[1], corners)
    if left is None or right is None:
        return None
    height, width = images[0].shape
    if images[1].shape != images[0].shape:
        raise ToktError(f"frame {frame}: the left and the right picture differ in size")
    # A board that looks the same upside down may be counted from opposite corners.
    if (left[-1] - left[0]) @ (right[-1] - right[0]) < 0:
        right = right[::-1]
    return FramePoints(frame, left, right), (width, height)


def _corners(image: U8, corners: tuple[int, int]) -> F64 | None:
    for flags in _FIND:
        good, found = cv2.findChessboardCornersSB(image, corners, flags=flags)
        if good:
            return np.asarray(found, np.float64).reshape(-1, 2)
    return None


def _fit(
    boards: Sequence[FramePoints], points: F32, size: tuple[int, int]
) -> tuple[StereoCalibration, float, float, float]:
    """Calibration and the three reprojection errors of it."""
    world = [points] * len(boards)
    left = [one.left.astype(np.float32).reshape(-1, 1, 2) for one in boards]
    right = [one.right.astype(np.float32).reshape(-1, 1, 2) for one in boards]
    # k3 stays 0: beyond the outermost corner that was seen it runs away.
    how: Any = {"flags": cv2.CALIB_FIX_K3, "criteria": _STEPS}
    left_px, K1, D1, *_ = cv2.calibrateCamera(world, left, size, None, None, **how)
    right_px, K2, D2, *_ = cv2.calibrateCamera(world, right, size, None, None, **how)
    stereo_px, K1, D1, K2, D2, R, T, *_ = cv2.stereoCalibrate(
        world, left, right, K1, D1, K2, D2, size,
        flags=cv2.CALIB_FIX_INTRINSIC, criteria=_STEPS,
    )  # fmt: skip
    K1, D1, K2, D2, R, T = (np.asarray(value, np.float64) for value in (K1, D1, K2, D2, R, T))
    calibration = StereoCalibration(K1, D1.ravel(), K2, D2.ravel(), R, T.reshape(3, 1), size)
    return calibration, float(left_px), float(right_px), float(stereo_px)
