"""Scratch memory of the compiled kernels, one set a thread.

It is used again for every frame, because a large block that is freed and asked for again costs
more in page faults than the counting itself.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native


class Scratch(threading.local):
    """Memory of one thread for intermediate results."""

    def __init__(self) -> None:
        self.arrays: dict[tuple[str, type], NDArray[Any]] = {}
        self.glcm: tuple[int, Any] = (0, None)

    def array(self, use: str, size: int, dtype: type) -> NDArray[Any]:
        """An array of at least that size, its content left from the last use."""
        kept = self.arrays.get((use, dtype))
        if kept is None or kept.size < size:
            kept = self.arrays[use, dtype] = np.zeros(size, dtype)
        return kept

    def glcm_scratch(self, patch_width: int) -> Any:
        """Counters for patches up to that width; every count is zero between calls."""
        width, scratch = self.glcm
        if scratch is None or width < patch_width:
            scratch = _native.GlcmScratch(
                np.zeros((4, 256 * 256), np.uint32),
                np.zeros((4, 256 * 256), np.uint16),
                np.zeros(_native.GlcmScratch.sums_size(), np.int64),
                np.zeros(4 * patch_width, np.uint16),
            )
            self.glcm = patch_width, scratch
        return scratch


SCRATCH = Scratch()
