"""What is measured on: frames of a mission, decoded once, and a textured frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from ..thesis_images import rendered_other_image
from .thesis_way import GRID, resized_gray

_NOISE_GREY_LEVELS = 25.0


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


def spread_over(numbers: Sequence[int], count: int) -> list[int]:
    """At most `count` of `numbers`, from the first to the last, evenly spaced."""
    if len(numbers) <= count:
        return list(numbers)
    places = np.linspace(0, len(numbers) - 1, count).round().astype(int)
    return [numbers[place] for place in places]


def textured_frame() -> NDArray[np.uint8]:
    """A colour frame of 1360x1024 full of contrast: a rendered texture with strong noise on it.

    Its patches hold most of the 256 grey levels, where frames of open sea hold a dozen. The noise
    is coarse, four pixels wide, so that it is still there after the resize.
    """
    texture = rendered_other_image().astype(np.float64)
    height, width = texture.shape
    noise = np.random.default_rng(1).normal(0, _NOISE_GREY_LEVELS, (height // 4, width // 4))
    coarse = cv2.resize(noise, (width, height), interpolation=cv2.INTER_NEAREST)
    gray = np.asarray((texture + coarse).clip(0, 255), np.uint8)
    return np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), np.uint8)
