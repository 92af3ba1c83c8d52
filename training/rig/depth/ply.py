"""Point clouds as PLY files: binary little endian, with colours.

A header of ten lines and the bytes of one structured array. A library would do no more with it:
plyfile would be one dependency more for these lines, open3d several hundred megabytes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError

VERTEX = np.dtype(
    [(axis, "<f4") for axis in ("x", "y", "z")] + [(hue, "u1") for hue in ("red", "green", "blue")]
)
_TYPE_NAMES = {"<f4": "float", "|u1": "uchar"}


def ply_bytes(
    points_m: NDArray[np.float64], colors: NDArray[np.uint8], comments: Sequence[str] = ()
) -> bytes:
    """A PLY file of coloured points.

    Parameters
    ----------
    points_m : array of float, shape (n, 3)
        x, y, z in metres.
    colors : array of uint8, shape (n, 3)
        Red, green, blue.
    comments : sequence of str
        For whoever opens the file in an editor.

    Raises
    ------
    ToktError
        If a coordinate is not finite, or there is not one colour for each point.
    """
    if points_m.shape != colors.shape or points_m.shape[1:] != (3,):
        raise ToktError(f"{points_m.shape} coordinates and {colors.shape} colours are no cloud")
    if not np.isfinite(points_m).all():
        raise ToktError("a point cloud holds a coordinate that is not finite")
    vertices = np.empty(len(points_m), VERTEX)
    for place, name in enumerate(VERTEX.names or ()):
        vertices[name] = points_m[:, place] if place < 3 else colors[:, place - 3]
    return _header(len(vertices), comments) + vertices.tobytes()


def _header(count: int, comments: Sequence[str]) -> bytes:
    """ASCII, as the format wants it: a file's name in a comment may hold anything."""
    words = [" ".join(comment.split()) for comment in comments]
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in words)]
    lines.append(f"element vertex {count}")
    lines += [f"property {_TYPE_NAMES[VERTEX[name].str]} {name}" for name in (VERTEX.names or ())]
    return "\n".join([*lines, "end_header", ""]).encode("ascii", "replace")
