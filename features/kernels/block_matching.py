"""Block matching of two rectified views: what the kernels take and give, and OpenCV's own.

Both views are smooth gradients across the rows, clipped, and matched by the least sum of absolute
differences over a block: OpenCV's ``StereoBM`` with its XSOBEL filter, whose integers all kernels
give. Beyond the left edge the views go on in `PADDING`, so that a match is looked for wherever
the right view can show it; OpenCV by itself leaves out every column that the largest disparity
would take outside.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from tokt.features.common.arrays import I16, U8

PER_PIXEL = 16
"""Disparities are whole numbers of 1/16 pixel."""
MAX_DISPARITY_PX = ((1 << 15) - 1) // PER_PIXEL
"""They are kept in 16 bits with a sign."""
PADDING = 128
_LANES = 16
_MAX_SUM = (1 << 15) - 1  # of a block: OpenCV sums 16 bits with a sign


@dataclass(frozen=True)
class BlockMatching:
    """How two views are matched; the words are those of ``cv2.StereoBM``.

    Parameters
    ----------
    min_disparity, n_disparities : int
        In pixels: the smallest disparity looked for, 0 or more, and how many, a multiple of 16.
    block : int
        Height and width of a block in pixels, odd, from 5.
    cap : int
        Where gradients are clipped, 1 to 31.
    texture : int
        Least sum of absolute gradients over a block.
    uniqueness : int
        Percent by which the sums at all other disparities have to be larger.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    min_disparity: int
    n_disparities: int
    block: int
    cap: int
    texture: int
    uniqueness: int

    def __post_init__(self) -> None:
        if self.min_disparity < 0 or self.n_disparities < _LANES or self.n_disparities % _LANES:
            raise ValueError("disparities are 0 or more, and a multiple of 16 of them")
        if self.margin > MAX_DISPARITY_PX:
            raise ValueError(f"disparities are at most {MAX_DISPARITY_PX} pixels")
        if self.block < 5 or self.block % 2 == 0 or not 1 <= self.cap <= 31:
            raise ValueError("a block is odd, from 5 pixels, and gradients are clipped at 1 to 31")
        if 2 * self.cap * self.block * self.block > _MAX_SUM:
            raise ValueError(f"sums over blocks of {self.block} pixels do not fit 16 bits")
        if min(self.texture, self.uniqueness) < 0:
            raise ValueError("texture and uniqueness are 0 or more")

    @property
    def unmatched(self) -> int:
        """The disparity, in 1/16 pixel, of a pixel that was not matched."""
        return (self.min_disparity - 1) * PER_PIXEL

    @property
    def margin(self) -> int:
        """Columns that the views are padded by on the left."""
        return self.min_disparity + self.n_disparities


def check_views(left: Any, right: Any, wanted: Any) -> tuple[U8, U8, U8]:
    """The arguments of ``block_disparity``, in C order.

    TypeError or ValueError if they are not three arrays of uint8 of one two-dimensional shape.
    """
    for array in (left, right, wanted):
        if not isinstance(array, np.ndarray) or array.dtype != np.uint8:
            raise TypeError("views are arrays of uint8")
    if left.ndim != 2 or not left.shape == right.shape == wanted.shape:
        raise ValueError(f"views of one shape are needed: {left.shape}, {right.shape}")
    return (np.ascontiguousarray(left), np.ascontiguousarray(right), np.ascontiguousarray(wanted))


def padded(view: U8, settings: BlockMatching, value: int) -> U8:
    """The view with `BlockMatching.margin` more columns of that value on its left."""
    wide = cv2.copyMakeBorder(view, 0, 0, settings.margin, 0, cv2.BORDER_CONSTANT, value=value)
    return np.asarray(wide, np.uint8)


def block_disparity(left: U8, right: U8, settings: BlockMatching, wanted: U8) -> I16:
    """`Kernels.block_disparity` by OpenCV itself: without a compiler, and what ours is held to."""
    matcher = cv2.StereoBM.create(settings.n_disparities, settings.block)
    matcher.setMinDisparity(settings.min_disparity)
    matcher.setPreFilterType(cv2.StereoBM_PREFILTER_XSOBEL)
    matcher.setPreFilterCap(settings.cap)
    matcher.setTextureThreshold(settings.texture)
    matcher.setUniquenessRatio(settings.uniqueness)
    if min(left.shape) <= settings.block or not wanted.any():
        return np.full(left.shape, settings.unmatched, np.int16)
    views = [padded(view, settings, PADDING) for view in (left, right)]
    found = matcher.compute(*views)[:, settings.margin :]
    return np.asarray(np.where(wanted != 0, found, settings.unmatched), np.int16)
