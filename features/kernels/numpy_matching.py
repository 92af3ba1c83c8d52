"""Block matching by OpenCV itself: for machines without a compiler, and what ours is held to."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .block_matching import PADDING, BlockMatching, check_views, padded


def block_disparity(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    settings: BlockMatching,
    wanted: NDArray[np.uint8],
) -> NDArray[np.int16]:
    """Disparity of the wanted pixels of the left view.

    Parameters
    ----------
    left, right : array of uint8, shape (height, width)
        Rectified views.
    settings : BlockMatching
    wanted : array of uint8, shape (height, width)
        Not 0 where a disparity is wanted.

    Returns
    -------
    array of int16, shape (height, width)
        In 1/16 pixel; ``settings.unmatched`` where none is wanted, where the block leaves the
        view, and where it has too little texture or no unique match.

    Raises
    ------
    TypeError, ValueError
        If the views are not of uint8 and of one shape.
    """
    left, right, wanted = check_views(left, right, wanted)
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
