"""The texture features as scikit-image, mahotas and OpenCV compute them.

These are the definition that the fast kernels are held against; ``TOKT_KERNELS=library`` runs
them. They know no threads: `threads` is taken so that all kernels are called alike.
"""

from __future__ import annotations

from importlib.metadata import version

import mahotas.features
import numpy as np
from numpy.typing import NDArray
from skimage.feature import local_binary_pattern

from .area import resized_gray as resized_gray
from .grid import Grid

DETAIL = ", ".join(f"{name} {version(name)}" for name in ("scikit-image", "mahotas"))


def lbp_counts(
    gray: NDArray[np.uint8],
    grid: Grid,
    points: int,
    radius: float,
    border: str,
    threads: int = 1,
) -> NDArray[np.int64]:
    """Histograms of uniform rotation-invariant local binary patterns, one a patch.

    Parameters
    ----------
    gray : array of uint8, shape (height, width)
        The resized gray frame.
    grid : Grid
        The patches.
    points, radius : int, float
        P sampling points on a circle of R pixels.
    border : {"patch", "frame"}
        Whether a patch is cut out first (zeros beyond its edge, as in the thesis) or its
        neighbours' pixels are read.

    Returns
    -------
    numpy.ndarray
        int64, shape (n_patches, points + 2); each row sums to the pixels of a patch.

    References
    ----------
    Ojala, Pietikainen, Maenpaa (2002), IEEE TPAMI 24(7); `skimage.feature`.
    """
    if border == "frame":
        codes = grid.cells(local_binary_pattern(gray, points, radius, method="uniform"))
    else:
        patches = grid.cells(gray)
        codes = np.stack(
            [local_binary_pattern(patch, points, radius, method="uniform") for patch in patches]
        )
    flat = codes.reshape(grid.n_patches, -1).astype(np.int64)
    bins = points + 2
    offset = np.arange(grid.n_patches)[:, None] * bins
    return np.bincount((flat + offset).ravel(), minlength=grid.n_patches * bins).reshape(-1, bins)


def haralick_features(
    gray: NDArray[np.uint8], grid: Grid, ignore_zeros: bool, threads: int = 1
) -> NDArray[np.float64]:
    """Haralick's first 13 texture features, mean over the 4 directions, one row a patch.

    Parameters
    ----------
    gray : array of uint8, shape (height, width)
        The resized gray frame.
    grid : Grid
        The patches.
    ignore_zeros : bool
        Leave grey level 0 out of the co-occurrence counts, as the thesis does. A patch with no
        pair left in one of the directions has no such features; it gets those with the zeros
        counted (an all-zero patch: those of a constant patch).

    Returns
    -------
    numpy.ndarray
        float64, shape (n_patches, 13).

    References
    ----------
    Haralick, Shanmugam, Dinstein (1973), IEEE TSMC 3(6); `mahotas.features.haralick`.
    """
    return np.stack([_haralick(patch, ignore_zeros) for patch in grid.cells(gray)])


def _haralick(patch: NDArray[np.uint8], ignore_zeros: bool) -> NDArray[np.float64]:
    if ignore_zeros:
        try:
            directions = mahotas.features.haralick(patch, ignore_zeros=True)
        except ValueError:
            directions = mahotas.features.haralick(patch)
    else:
        directions = mahotas.features.haralick(patch)
    mean: NDArray[np.float64] = directions.mean(axis=0)
    return mean
