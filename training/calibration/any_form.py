"""Calibration files of any form, other tools' included, as commands that are no run read them."""

from collections.abc import Callable
from pathlib import Path

from tokt.inference.stereo.calibration import (
    CheckedCalibration,
    StereoCalibration,
    check_calibration,
    read_calibration,
)
from tokt.inference.stereo.calibration_files import BOUGUET, MATLAB, PRINTED, read_form


def read_calibration_file(path: Path, notice: Callable[[str], object]) -> StereoCalibration:
    """Read a calibration that is to be used; `notice` is told what is odd about it."""
    return describe_calibration_file(path).usable(notice)


def describe_calibration_file(*paths: Path) -> CheckedCalibration:
    """Read a calibration, usable or not; several files share the parts of OpenCV's form."""
    form, text = read_form(paths[0])
    if len(paths) > 1 or form not in (MATLAB, BOUGUET, PRINTED):
        return read_calibration(*paths)
    if form == MATLAB:
        from .matlab_file import read_matlab_numbers

        return check_calibration(read_matlab_numbers(paths[0]))
    if form == BOUGUET:
        from .bouguet import read_bouguet

        return check_calibration(read_bouguet(paths[0], text))
    from .printed_table import read_printed

    return check_calibration(read_printed(paths[0], text))
