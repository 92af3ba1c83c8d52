"""Whether a frame holds a pair of pictures that a stereo calibration is for."""

from __future__ import annotations

from .frame_check import shape_fault
from .reason import NO_FAULT, Fault, Reason
from .sources import Frame


def pair_fault(frame: Frame, frame_size: tuple[int, int]) -> Fault:
    """Why a pair cannot be looked at at all, or an empty string.

    Parameters
    ----------
    frame : Frame
    frame_size : (width, height) of int
        Of the calibration, in pixels.
    """
    if frame.left is None:
        return frame.left_fault or Fault(Reason.MISSING, "there is no left frame")
    if frame.right is None:
        return frame.right_fault or Fault(Reason.MISSING, "there is no right frame")
    for side, picture in (("left", frame.left), ("right", frame.right)):
        fault = shape_fault(picture)
        if fault:
            return fault.about(side)
        height, width = picture.shape[:2]
        if (width, height) != frame_size:
            expected = "x".join(map(str, frame_size))
            words = f"the {side} frame is {width}x{height}, the calibration is for {expected}"
            return Fault(Reason.WRONG_SIZE, words)
    return NO_FAULT
