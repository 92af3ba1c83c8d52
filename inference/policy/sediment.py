"""Clouds of sediment: a wide part of the view that became brighter and lost its fine contrast.

Stirred-up sediment shines in the lamp and hides what is behind it, as a wall without any texture
would. The water before it is what a frame is held against, patch by patch:

- *Brighter*, and not all alike: the log of its light rose by `BRIGHTER`, unevenly by `UNEVEN`. A
  lamp or a gain that changes the whole picture is none.
- *Without contrast*: what is left of the fine contrast, over the light, is below `CONTRAST_LEFT`.
  A structure that comes near has more of it, and so has snow.
- *Wide*: a `WIDE` part of the patches. A cloud goes on until `FRAMES` frames in a row show none.

Only where nothing was seen is a frame judged so: an obstacle in a cloud is one. What the water
looks like is learnt from such frames alone, slowly, and in a cloud hardly at all.
"""

import math

import cv2
import numpy as np

from tokt.features.common.arrays import F64, U8
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.inference.reason import NO_FAULT, Fault, Reason

BRIGHTER, UNEVEN, CONTRAST_LEFT, WIDE, FRAMES = 0.15, 0.05, 0.8, 0.25, 3
_FINE_PX = 5
LEARNT_FRAMES = 8
"""Frames of water that have to be seen before one can be told to differ."""
_WATER_S, _CLOUD_S = 5.0, 300.0
"""In which the water is learnt anew, in a cloud too: a lamp that was turned is none for ever."""
_UNTIMED_S, _MAX_PASSED_S = 0.25, 1.0
"""Taken for the time between two frames: without times, and at most."""


def _looks(gray: U8) -> F64:
    """Each patch's log of light, and of fine contrast over light: (2, n_patches)."""
    grid = DEFAULT_GRID
    high, wide = grid.patch_size(*gray.shape)
    light = gray[: high * grid.rows, : wide * grid.cols].astype(np.float32)
    fine = cv2.absdiff(light, cv2.blur(light, (_FINE_PX, _FINE_PX)))
    size = (grid.cols, grid.rows)
    mean, contrast = (
        cv2.resize(each, size, interpolation=cv2.INTER_AREA).astype(np.float64).ravel() + least
        for each, least in ((light, 1.0), (fine, 0.01))
    )
    return np.stack([np.log(mean), np.log(contrast / mean)])


class SedimentWatch:
    """Follow the look of the water, and tell a cloud in it."""

    def __init__(self) -> None:
        self._water: F64 | None = None
        self._learnt = self._left = 0
        self._last_s: float | None = None

    def take(self, gray: U8, nothing_seen: bool, t_s: float | None) -> Fault:
        """Take a frame in; why it is not clear, or an empty string.

        Parameters
        ----------
        gray : array of uint8, shape (height, width)
            As `DEFAULT_GRID` has it.
        nothing_seen : bool
            Whether no detector saw an obstacle in it.
        t_s : float or None
            Its time in seconds; None where that is not known.
        """
        passed_s = self._passed(t_s)
        if not nothing_seen:
            return NO_FAULT
        looks = _looks(gray)
        if self._water is None:
            self._water = looks
        share = self._share(looks - self._water)
        self._left = FRAMES if share >= WIDE else max(self._left - 1, 0)
        self._learn(looks, passed_s, _CLOUD_S if self._left else _WATER_S)
        if not self._left:
            return NO_FAULT
        return Fault(Reason.SEDIMENT, "a cloud of sediment is in a wide part of the view")

    def _passed(self, t_s: float | None) -> float:
        """Seconds since the frame before."""
        passed_s = _UNTIMED_S if t_s is None or self._last_s is None else t_s - self._last_s
        self._last_s = t_s
        return min(max(0.0, passed_s), _MAX_PASSED_S)

    def _share(self, change: F64) -> float:
        """The part of the patches that look as sediment does, 0..1."""
        light, contrast = change
        if self._learnt < LEARNT_FRAMES or float(light.std()) < UNEVEN:
            return 0.0
        return float(((light > BRIGHTER) & (contrast < math.log(CONTRAST_LEFT))).mean())

    def _learn(self, looks: F64, passed_s: float, within_s: float) -> None:
        assert self._water is not None
        self._learnt = min(self._learnt + 1, LEARNT_FRAMES)
        weight = 1 - math.exp(-passed_s / within_s)
        if self._learnt < LEARNT_FRAMES:
            weight = 1 / self._learnt
        self._water = self._water + weight * (looks - self._water)
