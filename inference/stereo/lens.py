r"""A lens: the direction of each picture column, and the sectors around the vehicle in view.

::

                 0 deg, ahead                 a column's angle, seen from above:
             k=-1  k=0  k=1                   negative left, positive right, of a pinhole camera
               \    |    /
        left    \   |   /   right             sector k: SECTOR_DEG wide, around k * SECTOR_DEG;
     of picture  \  |  /  of picture          its index is k % SECTORS, so that a thing at the
                  camera                      left has the highest indices
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tokt.features.common.errors import ToktError

from .calibration import StereoCalibration

SECTORS = 72
"""As many as MAVLink's OBSTACLE_DISTANCE has."""
SECTOR_DEG = 360 / SECTORS

MIN_FOV_DEG, MAX_FOV_DEG = 10.0, 170.0
"""Between these at least one sector is wholly in view, and a pinhole is a fair description."""


@dataclass(frozen=True)
class Lens:
    """A pinhole camera's horizontal view; distortion is left out.

    Parameters
    ----------
    focal : float
        Focal length over the picture's width.
    centre : float
        Column of the optical axis over the picture's width: 0 its left edge, 1 its right one.
    """

    focal: float
    centre: float = 0.5

    @classmethod
    def of_fov_deg(cls, fov_deg: float) -> Lens:
        """A lens that sees so many degrees from the picture's left edge to its right one.

        Raises
        ------
        ToktError
            If it is not between `MIN_FOV_DEG` and `MAX_FOV_DEG`.
        """
        if not MIN_FOV_DEG <= fov_deg <= MAX_FOV_DEG:
            raise ToktError(
                f"a camera's field of view is {MIN_FOV_DEG:g} to {MAX_FOV_DEG:g} degrees, "
                f"not {fov_deg:g}"
            )
        return cls(0.5 / math.tan(math.radians(fov_deg / 2)))

    @classmethod
    def of_calibration(cls, calibration: StereoCalibration) -> Lens:
        """The left camera's."""
        width = calibration.frame_size[0]
        # The centre of the first pixel is at 0, half a pixel from the edge.
        focal, centre = calibration.K1[0, 0] / width, (calibration.K1[0, 2] + 0.5) / width
        return cls(float(focal), float(centre))

    def angle_deg(self, column: float) -> float:
        """Direction of a column, given over the picture's width; positive to the right."""
        return math.degrees(math.atan2(column - self.centre, self.focal))

    @property
    def edges_deg(self) -> tuple[float, float]:
        """Directions of the picture's left and right edge."""
        return self.angle_deg(0.0), self.angle_deg(1.0)

    def fov_deg(self, height_over_width: float = 1.0) -> float:
        """Angle of view across the width, or across a height given over the width."""
        return 2 * math.degrees(math.atan2(height_over_width / 2, self.focal))


def lens_of(fov_deg: float | None, calibration: StereoCalibration | None) -> Lens:
    """The lens of the angle a user gave, otherwise of the calibration.

    Raises
    ------
    ToktError
        If there is neither.
    """
    if fov_deg is not None:
        return Lens.of_fov_deg(fov_deg)
    if calibration is None:
        raise ToktError(
            "MAVLink tells directions: give the camera's horizontal field of view in water "
            "(--camera-fov-deg), or a calibration"
        )
    return Lens.of_calibration(calibration)


def sectors_touching(left_deg: float, right_deg: float) -> list[int]:
    """Indices of the sectors that any part of a range of angles lies in, from left to right."""
    first = math.ceil((left_deg - SECTOR_DEG / 2) / SECTOR_DEG)
    last = math.floor((right_deg + SECTOR_DEG / 2) / SECTOR_DEG)
    return [k % SECTORS for k in range(first, last + 1)]


def sectors_within(left_deg: float, right_deg: float) -> list[int]:
    """Indices of the sectors that lie wholly in a range of angles, from left to right."""
    first = math.ceil((left_deg + SECTOR_DEG / 2) / SECTOR_DEG)
    last = math.floor((right_deg - SECTOR_DEG / 2) / SECTOR_DEG)
    return [k % SECTORS for k in range(first, last + 1)]
