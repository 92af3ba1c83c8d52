"""A stereo calibration, checked before it is used."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError

from .calibration_files import PARTS, CalibrationNumbers, folds_back_at_px, read_numbers
from .calibration_files import StereoCalibration as StereoCalibration

_ROTATION_TOLERANCE = 1e-3
# Where a calibration is usable, but unlike those of two cameras on one vehicle.
_FOCAL_DIFFERENCE = 0.05
_ASPECT_DIFFERENCE = 0.02
_FOCAL_OF_WIDTH = (0.3, 10.0)
_BASELINE_MM = (50.0, 2000.0)
_ROTATION_DEG = 10.0
_OFF_CENTRE = 0.1  # part of the frame's diagonal
_TANGENTIAL = 0.02
_MAX_PIXELS = 100_000_000  # no camera has more, and rectifying takes memory for each


@dataclass(frozen=True)
class CheckedCalibration:
    """A calibration as a file has it, and what the checks found."""

    path: Path
    calibration: StereoCalibration  # without skew, which OpenCV's rectification does not know
    form: str  # what kind of file it is, in words
    oddities: list[str]  # what is strange yet usable, and what was assumed or left out in reading
    refusals: list[str]  # why it cannot be used; empty for one that can

    def usable(self, notice: Callable[[str], object] = lambda _: None) -> StereoCalibration:
        """The calibration, what is odd about it told to `notice`; ToktError if it is of no use."""
        if self.refusals:
            raise ToktError(f"calibration {self.path}: {'; '.join(self.refusals)}")
        for oddity in self.oddities:
            notice(f"calibration {self.path}: {oddity}")
        return self.calibration


def load_calibration(path: Path | str) -> StereoCalibration:
    """Read a calibration as `read_calibration`; ToktError also if its cameras cannot be."""
    return read_calibration(path).usable()


def read_calibration(*paths: Path | str) -> CheckedCalibration:
    """Read a calibration in OpenCV's form, however implausible its numbers are.

    Parameters
    ----------
    *paths : Path
        OpenCV FileStorage (YAML, JSON, XML) with K1 D1 K2 D2 R T_mm, or the usual other names;
        in one file, or in several, such as OpenCV's sample program writes (intrinsics and
        extrinsics). Frames are of 1360x1024 where none says ``image_width`` and
        ``image_height``. R1 and R2, where they are present, follow from R and T_mm: they are held
        against them, and computed anew.

    Raises
    ------
    ToktError
        If a file cannot be read, is of another tool's form, or holds a number that is not finite,
        and if a part is missing.
    """
    return check_calibration(read_numbers(*map(Path, paths)))


def check_calibration(numbers: CalibrationNumbers) -> CheckedCalibration:
    """Check what was read from a file."""
    with np.errstate(all="ignore"):  # whatever overflows is refused, not warned of
        reasons = refusals(numbers) or _rectifying_faults(numbers)
        odd = [*numbers.remarks, *oddities(numbers)]
    parts = {name: getattr(numbers, name).copy() for name in PARTS}
    parts["K1"][0, 1] = parts["K2"][0, 1] = 0.0
    plain = StereoCalibration(**parts, frame_size=numbers.frame_size)
    return CheckedCalibration(numbers.path, plain, numbers.form, odd, reasons)


def refusals(calibration: StereoCalibration) -> list[str]:
    """Reasons why a finite calibration cannot be that of two cameras side by side."""
    width, height = calibration.frame_size
    if width < 1 or height < 1 or width * height > _MAX_PIXELS:
        return [f"the frame size is {width}x{height}"]
    found = []
    for name, K in (("K1 (left)", calibration.K1), ("K2 (right)", calibration.K2)):
        if K[0, 0] <= 0 or K[1, 1] <= 0 or K[1, 0] or not np.allclose(K[2], [0, 0, 1]):
            found.append(f"{name} is not a camera matrix")
        elif not (0 < K[0, 2] < width and 0 < K[1, 2] < height):
            found.append(
                f"the principal point of {name} lies outside the {width}x{height} frame, at "
                f"({K[0, 2]:.1f}, {K[1, 2]:.1f})"
            )
    R = calibration.R
    if not _is_one(R @ R.T) or np.linalg.det(R) < 0:
        found.append("R is not a rotation")
    x, *others = calibration.T_mm.ravel()
    if abs(x) <= np.abs(others).max():
        found.append("T_mm is not that of two cameras side by side")
    elif x > 0:
        found.append(
            "by T_mm the right camera is left of the left one. Left and right are exchanged, or "
            "T_mm is the right camera's position C (it should be -R @ C) or the way from right to "
            "left"
        )
    return found


def oddities(calibration: StereoCalibration) -> list[str]:
    """Warnings on a finite calibration: what is strange, yet usable."""
    found = []
    left = ("K1 (left)", calibration.K1, calibration.D1)
    right = ("K2 (right)", calibration.K2, calibration.D2)
    for name, K, D in (left, right):
        if K[0, 0] > 0 and K[1, 1] > 0 and min(calibration.frame_size) > 0:
            found += _camera_oddities(name, K, D, calibration.frame_size)
    first, second = calibration.K1[0, 0], calibration.K2[0, 0]
    if first > 0 and abs(second / first - 1) > _FOCAL_DIFFERENCE:
        found.append(f"the focal lengths of the cameras differ: {first:.1f} and {second:.1f} px")
    baseline = float(np.linalg.norm(calibration.T_mm))
    if not _BASELINE_MM[0] <= baseline <= _BASELINE_MM[1]:
        metres = ": is T in metres?" if 0.05 <= baseline <= 2 else ""
        found.append(f"the cameras stand {baseline:g} mm apart{metres}")
    angle = np.degrees(np.arccos(np.clip((np.trace(calibration.R) - 1) / 2, -1, 1)))
    if angle > _ROTATION_DEG:
        found.append(f"the cameras are turned by {angle:.1f} degrees against each other")
    return found


def _camera_oddities(name: str, K: F64, D: F64, frame_size: tuple[int, int]) -> list[str]:
    """The same of one camera, with positive focal lengths."""
    found = []
    fx, fy = K[0, 0], K[1, 1]
    width, height = frame_size
    if abs(fx / fy - 1) > _ASPECT_DIFFERENCE:
        found.append(f"{name}: fx and fy differ by more than 2 %: {fx:.1f} and {fy:.1f} px")
    if not _FOCAL_OF_WIDTH[0] <= fx / width <= _FOCAL_OF_WIDTH[1]:
        found.append(f"{name}: a focal length of {fx:g} px is strange for {width} px wide frames")
    off = np.hypot(K[0, 2] - (width - 1) / 2, K[1, 2] - (height - 1) / 2)
    if off > _OFF_CENTRE * np.hypot(width, height):
        found.append(f"{name}: the principal point is {off:.0f} px from the frame's centre")
    if K[0, 1]:
        moved = abs(K[0, 1] / fy) * height / 2
        found.append(
            f"{name}: the skew {K[0, 1]:g} px is left out, since OpenCV rectifies without: up to "
            f"{moved:.2g} px at the frame's edge"
        )
    if np.abs(D[2:4]).max() > _TANGENTIAL:
        found.append(
            f"{name}: tangential distortion p1 = {D[2]:g}, p2 = {D[3]:g} is large: is its order "
            "k1 k2 p1 p2 k3?"
        )
    fold = folds_back_at_px(K, D, frame_size)
    if fold is not None:
        found.append(f"{name}: its distortion folds back {fold:.0f} px from the principal point")
    return found


def _rectifying_faults(numbers: CalibrationNumbers) -> list[str]:
    """R1 and R2, where given, turn both cameras the same way."""
    R1, R2 = numbers.R1, numbers.R2
    if R1 is None and R2 is None:
        return []
    if R1 is None or R2 is None or R1.size != 9 or R2.size != 9:
        return ["R1 and R2 must both be 3x3, or both be left out"]
    if _is_one(R2.reshape(3, 3) @ numbers.R @ R1.reshape(3, 3).T):
        return []
    return ["R1 and R2 do not belong to its R"]


def _is_one(matrix: F64) -> bool:
    return bool(np.abs(matrix - np.eye(3)).max() <= _ROTATION_TOLERANCE)
