"""Edges and lines of a picture's patches in numpy and OpenCV, in whole numbers."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.frames.grid import Grid

from .checks import check_gray, check_lbp, check_samples
from .lbp_points import nearest_points

Counts = NDArray[np.int64]

LINE_STEPS = ((0, 2), (1, 2), (1, 1), (2, 1), (2, 0), (2, -1), (1, -1), (1, -2))
"""Rows and columns from one sample of a line to the next, for each direction."""


def _patch_sums(values: NDArray[np.integer], grid: Grid) -> Counts:
    return np.asarray(grid.cells(values).sum(axis=(1, 2), dtype=np.int64))


def lbp_nearest_counts(
    gray: NDArray[np.uint8],
    grid: Grid,
    points: int,
    radius: float,
    border: str,
    threads: int = 1,
) -> Counts:
    """Histograms of local binary patterns whose points are moved to the nearest whole pixel.

    Patterns are those of `tokt.features.kernels.reference.lbp_counts` but for that.

    Raises
    ------
    TypeError, ValueError
        If `gray` is not a two-dimensional array of uint8, or an option is out of range.
    """
    gray = check_gray(gray, threads)
    check_lbp(points, radius, border)
    size = grid.patch_size(*gray.shape)
    views = gray[None] if border == "frame" else grid.cells(gray)
    reach = int(np.ceil(radius))
    padded = np.pad(views, ((0, 0), (reach, reach), (reach, reach)))
    height, width = views.shape[1:]
    ones, changes = np.zeros((2, *views.shape), np.uint8)
    before: NDArray[np.bool_] | None = None
    for down, right in nearest_points(points, radius).tolist():
        top, left = reach + down, reach + right
        now = padded[:, top : top + height, left : left + width] >= views
        ones += now
        if before is not None:
            changes += before != now
        before = now
    np.copyto(ones, points + 1, where=changes > 2)
    codes = grid.cells(ones[0]) if border == "frame" else ones
    flat = codes.reshape(grid.n_patches, size[0] * size[1]).astype(np.int64)
    flat += (points + 2) * np.arange(grid.n_patches)[:, None]
    return np.bincount(flat.ravel(), minlength=grid.n_patches * (points + 2)).reshape(
        -1, points + 2
    )


def structure_sums(gray: NDArray[np.uint8], grid: Grid, threads: int = 1) -> Counts:
    """Sums of the structure tensor over each patch: changes across, down, and both together.

    With gx the pixel to the right less the one to the left and gy the one below less the one
    above, 0 where the picture ends: the sums of gx gx, gy gy and gx gy over a patch's pixels.

    Parameters
    ----------
    gray : array of uint8, shape (height, width)
    grid : Grid
    threads : int
        Taken so that all kernels are called alike.

    Returns
    -------
    numpy.ndarray
        int64, shape (n_patches, 3).

    Raises
    ------
    TypeError, ValueError
        If `gray` is not a two-dimensional array of uint8.
    """
    gray = check_gray(gray, threads)
    grid.patch_size(*gray.shape)
    # This border rule mirrors a neighbour into the other's place: their difference is 0.
    gx, gy = (
        cv2.Sobel(gray, cv2.CV_16S, *axis, ksize=1, borderType=cv2.BORDER_REFLECT_101).astype(
            np.int32
        )
        for axis in ((1, 0), (0, 1))
    )
    return np.stack([_patch_sums(product, grid) for product in (gx * gx, gy * gy, gx * gy)], axis=1)


def line_sums(
    gray: NDArray[np.uint8],
    grid: Grid,
    middle: int,
    samples: Sequence[int],
    threads: int = 1,
) -> Counts:
    """How much longer bright or dark lines through a patch's pixels are in one direction.

    S is the sum of n samples, two pixels or a knight's or king's move apart, on a line through
    the pixel (sample n / 2 is the pixel itself), of levels less `middle`; 0 beyond the picture.

    Parameters
    ----------
    gray : array of uint8, shape (height, width)
    grid : Grid
    middle : int
        The level that counts as nothing.
    samples : sequence of int
        The numbers n, increasing powers of 2 from 2 to 64.
    threads : int
        Taken so that all kernels are called alike.

    Returns
    -------
    numpy.ndarray
        int64, shape (n_patches, len(samples), 9): sums over a patch's pixels, first of 8 times
        the largest of the directions' S less all of them, then of each direction's S squared.

    Raises
    ------
    TypeError, ValueError
        If `gray` is not a two-dimensional array of uint8, or the samples or `middle` are others.
    """
    gray = check_gray(gray, threads)
    check_samples(samples, middle)
    height, width = gray.shape
    grid.patch_size(height, width)
    reach = samples[-1]
    signed = np.zeros((height + 2 * reach, width + 2 * reach), np.int32)
    signed[reach:-reach, reach:-reach] = gray.astype(np.int32) - middle
    inside = np.s_[reach:-reach, reach:-reach]
    largest = np.full((len(samples), height, width), -(1 << 20), np.int32)
    out = np.zeros((grid.n_patches, len(samples), 9), np.int64)
    for direction, (down, right) in enumerate(LINE_STEPS):
        line, n = signed, 1
        while n < samples[-1]:
            # What is rolled in at the other end is never looked at: `reach` is wide enough.
            line = line + np.roll(line, (-n * down, -n * right), (0, 1))
            n *= 2
            if n in samples:
                place = samples.index(n)
                centred = np.roll(line, (n * down // 2, n * right // 2), (0, 1))[inside]
                np.maximum(largest[place], centred, out=largest[place])
                out[:, place, 0] -= _patch_sums(centred, grid)
                out[:, place, 1 + direction] = _patch_sums(centred * centred, grid)
    for place, most in enumerate(largest):
        out[:, place, 0] += 8 * _patch_sums(most, grid)
    return out
