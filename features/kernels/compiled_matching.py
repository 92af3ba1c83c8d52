"""Block matching by the compiled extension; `numpy_matching` says what it gives."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from . import _native
from .block_matching import PADDING, BlockMatching, check_views, padded
from .compiled_scratch import SCRATCH


def block_disparity(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    settings: BlockMatching,
    wanted: NDArray[np.uint8],
) -> NDArray[np.int16]:
    """Disparity of the wanted pixels of the left view, in 1/16 pixel.

    Takes and gives what `tokt.features.kernels.numpy_matching.block_disparity` does, to the last
    bit; the fewer and the closer together the wanted pixels are, the less it costs.

    Raises
    ------
    TypeError, ValueError
        If the views are not of uint8 and of one shape.
    """
    left, right, wanted = check_views(left, right, wanted)
    disparity = np.full(left.shape, settings.unmatched, np.int16)
    if min(left.shape) <= settings.block:
        return disparity
    half, margin = settings.block // 2, settings.margin
    # Where the block lies inside both padded views at every disparity.
    inside = np.zeros_like(wanted)
    inside[half:-half, half - 1 : -half] = wanted[half:-half, half - 1 : -half] != 0
    column, row, width, height = cv2.boundingRect(inside)
    if not width:
        return disparity
    left, right = (
        _gradients(padded(view, settings, PADDING), settings.cap) for view in (left, right)
    )
    area = (row, row + height, column + margin, column + margin + width)
    kernel = _native.MatchKernel(
        settings.min_disparity,
        settings.n_disparities,
        settings.block,
        settings.cap,
        settings.texture,
        settings.uniqueness,
    )
    scratch = SCRATCH.array("match", kernel.scratch_size(width), np.uint16)
    wide = np.full(left.shape, settings.unmatched, np.int16)
    kernel.disparities(left, right, padded(inside, settings, 0), *area, scratch, wide)
    return wide[:, margin:]


def _gradients(view: NDArray[np.uint8], cap: int) -> NDArray[np.uint8]:
    """OpenCV's XSOBEL filter: gradients across, clipped at `cap`, which itself means none."""
    gradient = cv2.Sobel(view, cv2.CV_16S, 1, 0)
    # To bytes: what is below -cap becomes 0.
    raised = cv2.addWeighted(gradient, 1.0, gradient, 0.0, float(cap), dtype=cv2.CV_8U)
    clipped = np.minimum(np.asarray(raised, np.uint8), np.uint8(2 * cap))
    clipped[:, [0, -1]] = cap
    if len(clipped) % 2:  # it works on pairs of rows, and leaves a last single one without any
        clipped[-1] = cap
    return clipped
