"""Extractors that know the water: gradients, colour, place, and what differs from the frame's own.

How bright, grainy and colourful water looks differs from dive to dive; how a patch differs from the
quietest patches of its own frame does so much less.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from tokt.features.common.arrays import F64, I64, Bools
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.quantization import STEPS_PER_LEVEL

from .frame_pictures import FramePictures
from .textures import SPEC_VERSION, Extractor, Join

_NO_ENERGY = 1e-3
"""Squared grey levels a pixel that count as no gradient: the logarithm of less says nothing."""
_NO_GRADIENT = 0.03  # grey levels a pixel, the same of a single pixel's gradient
_NO_COLOUR_ENERGY = 0.01  # squared units of Lab from box to box that count as no change of colour


class Gradients(Extractor):
    """Logarithms of a patch's gradients at several smoothings: energy across and down, strong ones.

    They are of the gray frame in 1/256 grey level, smoothed by a mean of n x n pixels, n odd; the
    strong one is that which 5 % of a patch's pixels exceed.
    """

    images = ()

    def __init__(self, smooth: Sequence[int]) -> None:
        self.smooth = tuple(smooth)
        kinds = ("across", "down", "strong")
        self.names = tuple(f"gradient_{n}_{kind}" for n in smooth for kind in kinds)
        self.dim = len(self.names)
        self.energies = (True, True, False) * len(self.smooth)
        self._spec = {"name": "gradients", "version": SPEC_VERSION, "smooth": list(smooth)}

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """One row a patch, natural logarithms of grey levels (squared) a pixel."""
        grid, gray16 = pictures.grid, pictures.gray16
        height, width = grid.patch_size(*gray16.shape)
        # Neighbours are two pixels apart: a difference is twice the gradient.
        step = 2.0 * STEPS_PER_LEVEL
        out = []
        for n in self.smooth:
            sums = KERNELS.gradient_sums(gray16, grid, n, pictures.threads)
            out.append(np.log(sums[:, :2] / (height * width * step**2) + _NO_ENERGY))
            out.append(np.log(np.sqrt(sums[:, 2:]) / step + _NO_GRADIENT))
        return np.hstack(out)


class Colour(Extractor):
    """A patch's mean colour in CIELAB, and how much a and b change within it, across and down.

    It is looked at in cells x cells parts. Reference: CIE 15:2004, for sRGB and D65.
    """

    images = ()
    needs_colour = True

    def __init__(self, cells: int) -> None:
        self.cells = cells
        kinds = ("a_across", "a_down", "b_across", "b_down")
        self.names = tuple(f"colour_{kind}" for kind in ("lightness", "a", "b", *kinds))
        self.dim = len(self.names)
        self.energies = (False, False, False, True, True, True, True)
        self._spec = {"name": "colour", "version": SPEC_VERSION, "cells": cells}

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """One row a patch; ToktError if the frame has no colour."""
        if not pictures.has_colour:
            raise ToktError("the model looks at colours, and the frame is gray")
        grid, cells = pictures.grid, self.cells
        lab = lab_of(pictures.box_means(cells))
        change = np.zeros((2, *lab.shape[:2], 2))
        change[0, :, 1:-1] = lab[:, 2:, 1:] - lab[:, :-2, 1:]
        change[1, 1:-1] = lab[2:, :, 1:] - lab[:-2, :, 1:]
        energy = (change**2).transpose(1, 2, 3, 0).reshape(*lab.shape[:2], 4)
        both = np.concatenate([lab, energy], axis=2)
        parts = both.reshape(grid.rows, cells, grid.cols, cells, self.dim)
        mean = parts.mean(axis=(1, 3)).reshape(grid.n_patches, self.dim)
        return np.hstack([mean[:, :3], np.log(mean[:, 3:] / 4 + _NO_COLOUR_ENERGY)])


# From linear sRGB (columns B, G, R) to X, Y, Z over those of white (IEC 61966-2-1).
_XYZ = np.array(
    [
        [0.1804375, 0.3575761, 0.4124564],
        [0.0721750, 0.7151522, 0.2126729],
        [0.9503041, 0.1191920, 0.0193339],
    ]
) / np.array([[0.95047], [1.0], [1.08883]])
_DARK, _SLOPE = 216 / 24389, 24389 / 27 / 116


@lru_cache(maxsize=1)
def _linear() -> F64:
    """Linear light of an sRGB level in steps of 1/256, 0 to 255 levels."""
    level = np.arange(255 * STEPS_PER_LEVEL + 1) / (255.0 * STEPS_PER_LEVEL)
    return np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)


def lab_of(bgr16: I64) -> F64:
    """CIELAB of sRGB colours, float64, shape (..., 3).

    These are blue, green and red in 1/256 level, 0 to 255 * 256.
    """
    xyz = _linear()[bgr16] @ _XYZ.T
    curved = np.where(xyz > _DARK, np.cbrt(xyz), _SLOPE * xyz + 16 / 116)
    x, y, z = np.moveaxis(curved, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


class PatchPlace(Extractor):
    """Where a patch stands in the frame: its row, and how far it is from the middle column."""

    images = ()
    names = ("place_row", "place_from_middle")
    dim = 2

    def __init__(self) -> None:
        self._spec = {"name": "place", "version": SPEC_VERSION}

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """One row a patch: -1/2 (top) to 1/2, and 0 to 1/2."""
        return _places(pictures.grid)


@lru_cache(maxsize=4)
def _places(grid: Grid) -> F64:
    row, col = np.divmod(np.arange(grid.n_patches), grid.cols)
    down = row / max(grid.rows - 1, 1) - 0.5
    right = col / max(grid.cols - 1, 1) - 0.5
    return np.stack([down, np.abs(right)], axis=1)


class Relative(Join):
    """Several extractors' features less those of the frame's own water.

    The water is what the quietest patches show, so large a part of all, those with the least energy
    of gradients and colours: the median of each feature over them. Where a frame holds no water
    they are the smoothest of what it does hold. At least one of the parts has energies.
    """

    def __init__(self, parts: Sequence[Extractor], quietest: float) -> None:
        super().__init__(parts)
        self.quietest = quietest
        self.names = tuple(f"relative.{name}" for name in self.names)
        self._energies: Bools = np.array(self.energies, bool)
        self.energies = (False,) * self.dim
        self._spec |= {"name": "relative", "quietest": quietest}

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """The parts' features, in order, each less its median over the quietest patches."""
        features = super().describe_pictures(pictures)
        energy = features[:, self._energies].mean(axis=1)
        quiet = np.argsort(energy, kind="stable")[: max(1, round(self.quietest * len(energy)))]
        return features - np.median(features[quiet], axis=0)
