"""Calibration files as commands take them: every form, MATLAB's binary files included."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from .output import say

if TYPE_CHECKING:
    from ..inference.calibration import Described, StereoCalibration


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


def describe_calibration_file(path: Path) -> Described:
    """Read a calibration that is to be looked at, usable or not.

    Raises
    ------
    ToktError
        If it cannot be read.
    """
    from ..inference.calibration import describe, read_calibration

    if path.suffix.lower() != ".mat":
        return read_calibration(path)
    from ..training.stereo.matlab_file import read_matlab_numbers

    return describe(read_matlab_numbers(path))
