"""Lens distortion as OpenCV writes it: the order of its numbers, and where it folds back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DISTORTION_SIZES = (4, 5, 8, 12, 14)
"""How many coefficients OpenCV's models have."""
_STEPS = 4000
_FARTHEST = 4.0
"""How far the walk goes out, in distances of the farthest corner."""


def distortion(k1: float, k2: float, p1: float, p2: float, k3: float = 0.0) -> NDArray[np.float64]:
    """OpenCV's five coefficients in OpenCV's order: k1, k2, p1, p2, k3.

    The third radial coefficient stands last, behind the two tangential ones. Bouguet's ``kc`` has
    the same order; MATLAB keeps ``RadialDistortion`` (k1, k2, k3) and ``TangentialDistortion``
    (p1, p2) apart.

    Parameters
    ----------
    k1, k2, k3 : float
        Radial: a point at r from the axis (on the plane at distance 1) is seen at
        r * (1 + k1 r^2 + k2 r^4 + k3 r^6).
    p1, p2 : float
        Tangential: x moves by 2 p1 x y + p2 (r^2 + 2 x^2), y by p1 (r^2 + 2 y^2) + 2 p2 x y.

    Returns
    -------
    array of float64, shape (5,)
    """
    return np.array([k1, k2, p1, p2, k3], np.float64)


def folds_back_at_px(
    K: NDArray[np.float64], D: NDArray[np.float64], frame_size: tuple[int, int]
) -> float | None:
    """Where, inside the frame, radial distortion stops moving outwards; None where it does not.

    Parameters
    ----------
    K : array, shape (3, 3)
        Camera matrix in pixels, with positive focal lengths.
    D : array, shape (4..14,)
        OpenCV's coefficients; of the longer models the rational part (k4, k5, k6) is looked at.
    frame_size : (int, int)
        Width and height in pixels.

    Returns
    -------
    float or None
        Distance from the principal point in pixels. Beyond it nothing can be undistorted: two
        directions are seen at one place, and others nowhere.
    """
    corner = _farthest_corner(K, frame_size)
    k1, k2, _, _, k3, k4, k5, k6 = np.pad(np.ravel(D), (0, 8))[:8]
    r = np.linspace(0.0, _FARTHEST * corner, _STEPS)
    r2 = r * r
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        outwards = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        seen = r * outwards / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        rising = np.diff(seen) > 0
    stops = len(rising) if rising.all() else int(np.argmin(rising))
    if seen[stops] >= corner:
        return None
    return float(seen[stops] * K[0, 0])


def _farthest_corner(K: NDArray[np.float64], frame_size: tuple[int, int]) -> float:
    """Distance of the farthest frame corner from the axis, on the plane at distance 1."""
    width, height = frame_size
    x = max(abs(K[0, 2]), abs(width - 1 - K[0, 2])) / K[0, 0]
    y = max(abs(K[1, 2]), abs(height - 1 - K[1, 2])) / K[1, 1]
    return float(np.hypot(x, y))
