"""The thesis's steps after block matching: a map, its margin cut off, a point cloud.

The map is `tokt.studies.baselines.thesis_stereo`'s. The cloud's projection is that of the author's
own earlier program (points3Dmaker): the map's 0..255 are taken for disparities, a focal length
of 57 (the camera's 2222 px times 35 over 1360, in whole numbers as its Python divided), the mean
of the printed principal points, and no baseline, so that its lengths have no unit. Whether figure
3.10 was drawn with exactly this is not known here.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from .thesis_stereo import (
    BLOCK_PX,
    CROP_PX,
    LEFT_CAMERA,
    MIN_DISPARITY_PX,
    N_DISPARITIES_PX,
    RIGHT_CAMERA,
)

Float = NDArray[np.float64]

FOCAL, CENTRE = 2222 * 35 // 1360, ((681.42537 + 637.64260) / 2, (22.08306 + 33.60849) / 2)
"""Of the cloud. Source: points3Dmaker of ROV_objectAvoidance_StereoVision."""


@dataclass(frozen=True)
class Margin:
    """The effect of cutting 200 columns off either side of a map.

    Parameters
    ----------
    matched_inside, matched_margin : float
        Parts of the pixels that have a disparity, without the margin and in it.
    mean_whole, mean_inside : float
        Mean value with the margin and without it, 0..255.
    """

    matched_inside: float
    matched_margin: float
    mean_whole: float
    mean_inside: float


def cropped(stretched: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A map without its margin."""
    return stretched[:, CROP_PX:-CROP_PX]


def margin_of(stretched: NDArray[np.uint8]) -> Margin:
    """Measure the effect of cutting the margin off a map."""
    inside = cropped(stretched)
    margin = np.hstack([stretched[:, :CROP_PX], stretched[:, -CROP_PX:]])
    return Margin(
        float((inside > 0).mean()),
        float((margin > 0).mean()),
        float(stretched.mean()),
        float(inside.mean()),
    )


def thesis_cloud(stretched: NDArray[np.uint8]) -> tuple[Float, NDArray[np.bool_]]:
    """The points of a map, without a unit, and which pixels they are.

    Returns
    -------
    points : array of float, shape (n, 3)
        x to the right, y up, z backwards, as its program writes them.
    matched : array of bool, shape (1024, 1360)
    """
    (cx, cy), f = CENTRE, FOCAL
    projection = np.array([[1, 0, 0, -cx], [0, -1, 0, cy], [0, 0, 0, -f], [0, 0, 1, 0]])
    matched = stretched > 0
    points = cv2.reprojectImageTo3D(stretched.astype(np.float32), projection)
    return np.asarray(points[matched], np.float64), matched


def in_thesis_view(points: Float, camera: tuple[float, float, tuple[float, ...]]) -> Float:
    """Where points (n, 2) of a frame lie in the picture that the thesis undistorts it to."""
    fx, fy, distortion = camera
    matrix = np.diag([fx, fy, 1.0])
    seen = np.ascontiguousarray(points, np.float64).reshape(-1, 1, 2)
    moved = cv2.undistortPoints(seen, matrix, np.array(distortion), None, None, matrix)
    return np.asarray(moved, np.float64).reshape(-1, 2)


def searched(left: Float, right: Float) -> tuple[Float, NDArray[np.bool_]]:
    """Disparities of matched points of a pair's frames as the thesis's program would need them.

    Parameters
    ----------
    left, right : array of float, shape (n, 2)
        Pixels of the left and of the right frame.

    Returns
    -------
    disparity_px : array of float, shape (n,)
    found : array of bool, shape (n,)
        Whether its search covers that disparity, and the point is in one row, give or take a
        block's half, of both of its pictures.
    """
    seen = in_thesis_view(left, LEFT_CAMERA), in_thesis_view(right, RIGHT_CAMERA)
    disparity = seen[0][:, 0] - seen[1][:, 0]
    rows = np.abs(seen[0][:, 1] - seen[1][:, 1]) <= BLOCK_PX / 2
    last = MIN_DISPARITY_PX + N_DISPARITIES_PX - 1
    return disparity, (disparity >= MIN_DISPARITY_PX) & (disparity <= last) & rows
