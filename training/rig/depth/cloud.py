"""Filtered, coloured point clouds from the matches of one pair, and PLY files of them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tokt.features.common.arrays import F64, I64, U8, Bools
from tokt.features.common.errors import ToktError
from tokt.inference.stereo.matching import Matches
from tokt.inference.stereo.rectify import Rectifier
from tokt.training.evaluation.pictures import raise_contrast

NEAREST_M, FARTHEST_M = 0.3, 10.0
"""Range that is kept. A disparity of half resolution is uncertain by about a quarter of a pixel:
7 cm at 10 m with the mission's cameras, and growing with the square of the distance."""
NEIGHBOURS = 16
OUTLIER_SIGMA = 2.0
"""A point is an outlier when its mean distance to its nearest `NEIGHBOURS` is more than so many
standard deviations above the cloud's mean. Source: R. B. Rusu et al., Towards 3D point cloud based
object maps for household environments, Robotics and Autonomous Systems 56 (2008), section 3.1."""
VERTEX, FAR_VERTEX = (
    np.dtype([(axis, real) for axis in "xyz"] + [(hue, "u1") for hue in ("red", "green", "blue")])
    for real in ("<f4", "<f8")
)
"""The second for places beyond `_FAR_M`, where float32 does not tell millimetres apart."""
_FAR_M = 1e4
_TYPE_NAMES = {"<f4": "float", "<f8": "double", "|u1": "uchar"}


class PointCloud(NamedTuple):
    """Coloured points, and how many there were before filtering."""

    points_m: F64  # (n, 3): metres in the left camera's axes: x right, y down, z along its axis
    colors: U8  # (n, 3): RGB, of the left frame with its contrast raised
    matched: int  # valid matches
    out_of_range: int  # of these left out
    outliers: int


def cloud_of(
    rectifier: Rectifier, matches: Matches, left: U8, farthest_m: float = FARTHEST_M
) -> PointCloud:
    """The points that one pair shows.

    Parameters
    ----------
    rectifier : Rectifier
        Whose views were matched.
    left : array of uint8
        The left frame, as decoded.
    farthest_m : float
        Points beyond are left out.
    """
    points = rectifier.points_m(matches.disparity_px, matches.valid)
    pixels = np.argwhere(matches.valid)[:, ::-1]
    return cloud_of_points(rectifier, points, pixels, left, farthest_m)


def cloud_of_points(
    rectifier: Rectifier, points: F64, pixels: I64, left: U8, farthest_m: float
) -> PointCloud:
    """The same of points in the left camera's axes, and of their pixels (x, y) in the view."""
    near = (points[:, 2] >= NEAREST_M) & (points[:, 2] <= farthest_m)
    kept = np.flatnonzero(near)
    kept = kept[~outliers(points[kept])]
    colors = _colors(rectifier, pixels[kept], left)
    n_near = int(near.sum())
    return PointCloud(points[kept], colors, len(points), len(points) - n_near, n_near - len(kept))


def outliers(points_m: F64) -> Bools:
    """Which points stand alone; bool, shape (n,).

    Distances are taken in units of a point's own distance from the camera, as neighbouring pixels
    are the farther apart the farther they are away.
    """
    if len(points_m) <= NEIGHBOURS:
        return np.zeros(len(points_m), bool)
    distances, _ = cKDTree(points_m).query(points_m, NEIGHBOURS + 1)
    spread = distances[:, 1:].mean(axis=1) / np.linalg.norm(points_m, axis=1)
    return np.asarray(spread > spread.mean() + OUTLIER_SIGMA * spread.std())


def _colors(rectifier: Rectifier, pixels: I64, left: U8) -> U8:
    """The left frame's colour at pixels (x, y) of the left view."""
    frame_width, frame_height = rectifier.calibration.frame_size
    width, height = rectifier.size
    places = rectifier.to_frame(pixels)
    x = (places[:, 0] + 0.5) * width / frame_width - 0.5
    y = (places[:, 1] + 0.5) * height / frame_height - 0.5
    at = np.column_stack([np.rint(x).clip(0, width - 1), np.rint(y).clip(0, height - 1)])
    column, row = at.astype(np.int64).T
    return np.asarray(raise_contrast(left, width, height)[row, column], np.uint8)


def ply_bytes(points_m: F64, colors: U8, comments: Sequence[str] = ()) -> bytes:
    """A PLY file of coloured points, binary little endian.

    A header of ten lines and the bytes of one structured array. A library would do no more with
    it: plyfile would be one dependency more, open3d several hundred megabytes. Comments are for
    whoever opens the file in an editor. Raises ToktError if a coordinate is not finite, or there is
    not one colour for each point.
    """
    if points_m.shape != colors.shape or points_m.shape[1:] != (3,):
        raise ToktError(f"{points_m.shape} coordinates and {colors.shape} colours are no cloud")
    if not np.isfinite(points_m).all():
        raise ToktError("a point cloud holds a coordinate that is not finite")
    far = np.abs(points_m).max(initial=0) > _FAR_M
    vertices = np.empty(len(points_m), FAR_VERTEX if far else VERTEX)
    for place, name in enumerate(VERTEX.names or ()):
        vertices[name] = points_m[:, place] if place < 3 else colors[:, place - 3]
    return _header(vertices, comments) + vertices.tobytes()


def _header(vertices: NDArray[Any], comments: Sequence[str]) -> bytes:
    """ASCII, as the format wants it: a file's name in a comment may hold anything."""
    words = [" ".join(comment.split()) for comment in comments]
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in words)]
    lines.append(f"element vertex {len(vertices)}")
    kinds = {name: vertices.dtype[name].str for name in vertices.dtype.names or ()}
    lines += [f"property {_TYPE_NAMES[kind]} {name}" for name, kind in kinds.items()]
    return "\n".join([*lines, "end_header", ""]).encode("ascii", "replace")
