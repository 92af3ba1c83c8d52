"""Calibration files as commands take them: every form, MATLAB's binary files included."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tokt.cli.output import say

if TYPE_CHECKING:
    from tokt.inference.stereo.calibration import CheckedCalibration, StereoCalibration


def read_calibration_file(path: Path) -> StereoCalibration:
    """Read a calibration that is to be used; what is odd about it is said on standard error.

    Raises
    ------
    ToktError
        If it cannot be read or cannot be used.
    """
    described = describe_calibration_file(path)
    calibration = described.usable()
    for oddity in described.oddities:
        say(f"calibration {path}: {oddity}")
    return calibration


def describe_calibration_file(path: Path) -> CheckedCalibration:
    """Read a calibration that is to be looked at, usable or not.

    Raises
    ------
    ToktError
        If it cannot be read.
    """
    from tokt.inference.stereo.calibration import check_calibration, read_calibration

    if path.suffix.lower() != ".mat":
        return read_calibration(path)
    from tokt.training.rig.calibrate.matlab_file import read_matlab_numbers

    return check_calibration(read_matlab_numbers(path))
