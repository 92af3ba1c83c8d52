"""Calibration files of any form, MATLAB's binary files included, as users name them."""

from collections.abc import Callable
from pathlib import Path

from tokt.inference.stereo.calibration import (
    CheckedCalibration,
    StereoCalibration,
    check_calibration,
    read_calibration,
)


def read_calibration_file(path: Path, notice: Callable[[str], None]) -> StereoCalibration:
    """Read a calibration that is to be used; `notice` is told what is odd about it."""
    described = describe_calibration_file(path)
    calibration = described.usable()
    for oddity in described.oddities:
        notice(f"calibration {path}: {oddity}")
    return calibration


def describe_calibration_file(path: Path) -> CheckedCalibration:
    """Read a calibration, usable or not."""
    if path.suffix.lower() != ".mat":
        return read_calibration(path)
    from .matlab_file import read_matlab_numbers

    return check_calibration(read_matlab_numbers(path))
