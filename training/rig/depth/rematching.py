"""Pairs matched again, one at a time: for depth pictures and point clouds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.common import atomic
from tokt.features.common.errors import FrameError
from tokt.features.frames.mission import LEFT, RIGHT, Mission
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.matching import Matches
from tokt.training.evaluation.pictures import CONTRAST_METHOD

from .cloud import PointCloud, cloud_of
from .pair_depths import DepthRow
from .picture import DepthPicture
from .ply import ply_bytes

_COLOR_ENDS_M = (1.0, 10.0)
"""Of the colour bar where nothing was matched."""
_MIN_RATIO = 2.0
"""Far end of the colour bar over its near end: below, it would show the noise."""


class PairRematcher:
    """Matches some pairs again: those of a whole mission do not fit into memory.

    Parameters
    ----------
    mission : Mission
    detector : DisparityDetector
    """

    def __init__(self, mission: Mission, detector: DisparityDetector) -> None:
        self._mission = mission
        self._detector = detector

    def again(self, row: DepthRow) -> tuple[NDArray[np.uint8] | None, Matches | None]:
        """The left frame of a row, and its matches as they were; None for what there was not."""
        try:
            left = self._mission.read(row.frame, LEFT)
        except FrameError:
            return None, None
        if row.valid_fraction is None:
            return left, None
        right = self._mission.read(row.frame, RIGHT)
        return left, self._detector.match(left, right, row_shift_px=row.row_trim_px)

    def draw(
        self, folder: Path, rows: Sequence[DepthRow], progress: Callable[..., Iterable[DepthRow]]
    ) -> list[str]:
        """Write a picture ``depth_N.png`` of each row that has a left frame; return their names."""
        artist = DepthPicture(self._detector.rectifier, *_color_ends(rows))
        names = []
        for row in progress(rows, len(rows), "pictures"):
            left, matches = self.again(row)
            if left is not None:
                names.append(f"depth_{row.frame}.png")
                atomic.write_bytes(folder / names[-1], artist.png(row, left, matches))
        return names

    def write_cloud(self, file: Path, row: DepthRow, farthest_m: float) -> dict[str, Any] | None:
        """Write the point cloud of a row; what it holds, or None if no point is left for one."""
        left, matches = self.again(row)
        if left is None or matches is None:
            return None
        cloud = cloud_of(self._detector.rectifier, matches, left, farthest_m)
        if not len(cloud.points_m):
            return None
        atomic.write_bytes(file, ply_bytes(cloud.points_m, cloud.colors, self._comments(row)))
        return {"file": str(file), "frame": row.frame, **_counts(cloud)}

    def _comments(self, row: DepthRow) -> list[str]:
        return [
            f"mission {self._mission.name}, frame {row.frame}",
            "metres in the left camera's axes: x right, y down, z forward",
            f"colours: left frame, {CONTRAST_METHOD}",
        ]


def _counts(cloud: PointCloud) -> dict[str, int]:
    return {
        "points": len(cloud.points_m),
        "matched": cloud.matched,
        "out_of_range": cloud.out_of_range,
        "outliers": cloud.outliers,
    }


def _color_ends(rows: Sequence[DepthRow]) -> tuple[float, float]:
    """The depths of all that is drawn: one scale for all pictures, so that they compare."""
    near = [row.distance_m for row in rows if row.distance_m is not None]
    far = [row.far_m for row in rows if row.far_m is not None]
    if not near or not far:
        return _COLOR_ENDS_M
    return min(near), max(max(far), _MIN_RATIO * min(near))
