"""Sampling points of local binary patterns (LBP), rounded as scikit-image rounds."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F64, U8

_DECIMALS = 5


class LbpPoints(NamedTuple):
    """P sampling points on a circle of R pixels, over a view of some height and width.

    A point's position is split into a whole pixel and a fraction. The fraction is taken of the
    absolute position, as scikit-image does: its last bits depend on the row and the column. Points
    go by their place on the circle, in `point` grouped by distinct column offset.
    """

    reach: int  # whole pixels that a point reads beyond the centre, at most
    first: NDArray[np.int32]  # (n_columns + 1,): where each column offset's points begin in `point`
    point: NDArray[np.int32]  # (P,): places on the circle
    row_floor: NDArray[np.int32]  # (P,): from the centre, the upper of the two rows it lies between
    row_fraction: F64  # (P, height): how far below that row, by the centre's row, px
    column_floor: NDArray[np.int32]  # (n_columns,)
    column_fraction: F64  # (n_columns, width)


def _fractions(offsets: F64, size: int) -> F64:
    positions = np.arange(size, dtype=np.float64) + offsets[:, None]
    return np.ascontiguousarray(positions - np.floor(positions))


def lbp_points(points: int, radius: float, height: int, width: int) -> LbpPoints:
    """The sampling points of (P, R) over a view of `height` x `width` pixels."""
    angles = 2 * np.pi * np.arange(points, dtype=np.float64) / points
    rows = np.round(-radius * np.sin(angles), _DECIMALS)
    columns, column_of = np.unique(
        np.round(radius * np.cos(angles), _DECIMALS), return_inverse=True
    )
    members = np.bincount(column_of, minlength=len(columns))
    return LbpPoints(
        reach=int(np.ceil(radius)) + 1,
        first=np.concatenate([[0], np.cumsum(members)]).astype(np.int32),
        point=np.argsort(column_of, kind="stable").astype(np.int32),
        row_floor=np.floor(rows).astype(np.int32),
        row_fraction=_fractions(rows, height),
        column_floor=np.floor(columns).astype(np.int32),
        column_fraction=_fractions(columns, width),
    )


@lru_cache(maxsize=64)
def nearest_points(points: int, radius: float) -> NDArray[np.int32]:
    """The sampling points of (P, R) moved to the nearest whole pixel, half ones to even.

    Rows and columns from the centre, (points, 2), in the order of `lbp_points`.
    """
    angles = 2 * np.pi * np.arange(points, dtype=np.float64) / points
    offsets = np.stack([-radius * np.sin(angles), radius * np.cos(angles)], axis=1)
    return np.round(np.round(offsets, _DECIMALS)).astype(np.int32)


def pattern_codes(points: int) -> U8:
    """The bin of each pattern of set points, uint8, shape (2 ** points,).

    A uniform pattern (at most two changes between neighbours on the open chain of points, as
    scikit-image counts them) is in the bin of its number of ones, any other in bin points + 1.
    """
    patterns = np.arange(1 << points, dtype=np.uint64)
    chain = np.uint64((1 << (points - 1)) - 1)
    changes = np.bitwise_count((patterns ^ (patterns >> np.uint64(1))) & chain)
    return np.where(changes <= 2, np.bitwise_count(patterns), points + 1).astype(np.uint8)
