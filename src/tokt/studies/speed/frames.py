"""Frames that the bench measures on: of a mission, decoded once, and a textured one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.studies.baselines.thesis_texture import GRID, resized_gray

_HEIGHT, _WIDTH, _CELL = 1024, 1360, 4  # pixels


@dataclass(frozen=True)
class Picture:
    """One frame as each case wants it.

    Parameters
    ----------
    frame : array of uint8, shape (height, width) or (height, width, 3)
        As decoded.
    """

    frame: NDArray[np.uint8]

    @cached_property
    def gray(self) -> NDArray[np.uint8]:
        """At the grid's width, gray."""
        return resized_gray(self.frame)

    @cached_property
    def patches(self) -> list[NDArray[np.uint8]]:
        """The gray patches, each contiguous in memory."""
        return [np.ascontiguousarray(patch) for patch in GRID.cells(self.gray)]


def textured_frame() -> NDArray[np.uint8]:
    """A colour frame of 1360x1024 full of contrast: cells of random grey levels, 0 to 255.

    Its patches hold nearly all grey levels and hardly a pair of them twice, where frames of open
    sea hold a dozen: the most there is to count. A cell is four pixels wide, so that it is still
    there after the resize.
    """
    cells = np.random.default_rng(1).integers(0, 256, (_HEIGHT // _CELL, _WIDTH // _CELL), np.uint8)
    gray = cells.repeat(_CELL, axis=0).repeat(_CELL, axis=1)
    return np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), np.uint8)
