"""Extractors that know the water: gradients, colour, place, and what differs from the frame's own.

How bright, grainy and colourful water looks differs from dive to dive; how a patch differs from the
quietest patches of its own frame, or from the smooth field of colour that the water makes over it,
does so much less.
"""

import re
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from tokt.features.common.arrays import F64, Bools, median
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.quantization import STEPS_PER_LEVEL

from .frame_pictures import FramePictures
from .textures import SPEC_VERSION, Context, Extractor, Join, around

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

    Parameters
    ----------
    cells : int
    gray : bool
        Whether a gray frame is described too, as one without any colour; else it is refused. A spec
        that allows it is of version 2.
    """

    images = ()

    def __init__(self, cells: int, gray: bool = False) -> None:
        self.cells = cells
        self.needs_colour = not gray
        kinds = ("a_across", "a_down", "b_across", "b_down")
        self.names = tuple(f"colour_{kind}" for kind in ("lightness", "a", "b", *kinds))
        self.dim = len(self.names)
        self.energies = (False, False, False, True, True, True, True)
        newer = {"version": 2, "gray": True} if gray else {"version": SPEC_VERSION}
        self._spec = {"name": "colour", "cells": cells, **newer}

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """One row a patch; ToktError if the frame has no colour and needs it."""
        if self.needs_colour and not pictures.has_colour:
            raise ToktError("the model looks at colours, and the frame is gray")
        grid, cells = pictures.grid, self.cells
        lab = pictures.colours(cells)
        change = np.zeros((2, *lab.shape[:2], 2))
        change[0, :, 1:-1] = lab[:, 2:, 1:] - lab[:, :-2, 1:]
        change[1, 1:-1] = lab[2:, :, 1:] - lab[:-2, :, 1:]
        energy = (change**2).transpose(1, 2, 3, 0).reshape(*lab.shape[:2], 4)
        both = np.concatenate([lab, energy], axis=2)
        parts = both.reshape(grid.rows, cells, grid.cols, cells, self.dim)
        mean = parts.mean(axis=(1, 3)).reshape(grid.n_patches, self.dim)
        return np.hstack([mean[:, :3], np.log(mean[:, 3:] / 4 + _NO_COLOUR_ENERGY)])


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
def _from_middle(grid: Grid) -> tuple[F64, F64]:
    """How far each patch is below and right of the middle: -1/2 to 1/2, (n_patches,) each."""
    row, col = np.divmod(np.arange(grid.n_patches), grid.cols)
    return row / max(grid.rows - 1, 1) - 0.5, col / max(grid.cols - 1, 1) - 0.5


def _places(grid: Grid) -> F64:
    down, right = _from_middle(grid)
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
        return _less_water(features, features[:, self._energies].mean(axis=1), self.quietest)


def _less_water(features: F64, energy: F64, quietest: float) -> F64:
    """Features, (n_patches, dim), less their median over so large a part of least energy."""
    quiet = np.argsort(energy, kind="stable")[: max(1, round(quietest * len(energy)))]
    return np.asarray(features - median(features[quiet]))


_CELLS = 3  # parts of a patch, down and across, in which its colour is compared with a plane
_NO_CHANGE = 0.05  # units of Lab that count as no change: of less a logarithm says nothing
_ROUNDS = 4  # of the robust fit
_RIDGE = 1e-2 * np.diag([0.0, 1, 1, 3, 3, 3])  # so that few quiet patches give a flat field
_FRAME_PARTS = (0.1, 0.5, 0.9)  # quantiles over a frame's patches
_GRAY, _GRAY_OF_4_BITS = 1e-3, 0.35
"""How far the logarithms of a frame's energies of colour are from those of no colour at most, where
it has none; and where 4 bits are kept of them. Rendered even water with noise of one grey level is
0.48 away at 640x480, 0.11 at 1920x1080 and 0.05 at 3840x2160."""


class WaterContrast(Extractor):
    """What a patch shows against the water of its own frame, seen in several ways.

    Chosen with whole sites held out (docs/explanation/waters.md). In this order:

    - the parts' features less those of the quietest patches (`Relative`), and the mean of these
      over the eight neighbours (`Context`);
    - where the patch stands in the frame (`PatchPlace`);
    - its mean colour less a smooth field of colour, fitted robustly to the quieter half of the
      frame, and how far off that is: light and tint fall off towards a frame's edges;
    - logarithms of how much the colours of its 3x3 cells differ from a plane, and at all: the shape
      of colour, not its level;
    - of each energy the frame's 10 % quantile, and how far the median and the 90 % quantile are
      above it: the same for all patches, so that a frame without any water can be told.

    Parameters
    ----------
    parts : sequence of Extractor
        Some have energies.
    quietest : float
        As for `Relative`.
    cells : int
        Of a patch, down and across, of which colours are taken; a multiple of 3.
    """

    def __init__(self, parts: Sequence[Extractor], quietest: float, cells: int) -> None:
        self._parts = Join(parts)
        self.quietest, self.cells = quietest, cells
        self.images = self._parts.images
        self.needs_colour = self._parts.needs_colour
        self._energies = np.array(self._parts.energies, bool)
        energies = np.array(self._parts.names)[self._energies].tolist()
        channels = ("lightness", "a", "b")
        self.names = (
            *Context(Relative(parts, quietest), "mean").names,
            *PatchPlace.names,
            *(f"field_{name}" for name in (*channels, "distance")),
            *(f"cells_{kind}_{name}" for kind in ("off_plane", "spread") for name in channels),
            *(f"frame_{kind}.{name}" for kind in ("low", "middle", "high") for name in energies),
        )
        self.dim = len(self.names)
        # Where the frame's energies of colour stand, and what they are without any.
        colours = [name for name in self.names if re.match(r"frame_\w+\.colour_", name)]
        low = np.array([name.startswith("frame_low.") for name in colours], bool)
        self._colours = [self.names.index(name) for name in colours]
        self._no_colour = np.where(low, np.log(_NO_COLOUR_ENERGY), 0.0)
        self._spec = {
            "name": "water_contrast",
            "version": SPEC_VERSION,
            "parts": [part.spec for part in parts],
            "quietest": quietest,
            "cells": cells,
        }

    def is_gray(self, features: F64, *, of_4_bits: bool = False) -> Bools:
        """Tell of each row of features whether its frame has no colour, shape (n,)."""
        if not self._colours:
            return super().is_gray(features)
        off = np.abs(features[:, self._colours] - self._no_colour)
        return np.asarray((off < (_GRAY_OF_4_BITS if of_4_bits else _GRAY)).all(axis=1), bool)

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """One row a patch."""
        grid = pictures.grid
        features = self._parts.describe_pictures(pictures)
        energies = features[:, self._energies]
        energy = energies.mean(axis=1)
        relative = _less_water(features, energy, self.quietest)
        colours = pictures.colours(self.cells)
        finer = self.cells // _CELLS
        parts = colours.reshape(grid.rows, _CELLS, finer, grid.cols, _CELLS, finer, 3)
        cells = parts.mean(axis=(2, 5)).transpose(0, 2, 1, 3, 4).reshape(grid.n_patches, -1, 3)
        field = off_field(cells.mean(axis=1), energy, grid)
        low, *higher = np.quantile(energies, _FRAME_PARTS, axis=0)
        frame = np.concatenate([low, *(one - low for one in higher)])
        return np.hstack(
            [
                *(relative, around(relative, grid, "mean"), _places(grid)),
                *(field, np.sqrt((field**2).sum(axis=1, keepdims=True))),
                np.log(_NO_CHANGE + (_OFF_PLANE @ cells).std(axis=1)),
                np.log(_NO_CHANGE + cells.std(axis=1)),
                np.broadcast_to(frame, (grid.n_patches, len(frame))),
            ]
        )


def _off_plane() -> F64:
    """The matrix that takes a plane out of the values of 3x3 cells, row by row."""
    down, across = np.divmod(np.arange(_CELLS**2), _CELLS) - np.ones((2, 1))
    plane = np.stack([np.ones(_CELLS**2), down, across], axis=1)
    return np.asarray(np.eye(_CELLS**2) - plane @ np.diag(1 / (plane**2).sum(axis=0)) @ plane.T)


_OFF_PLANE = _off_plane()


@lru_cache(maxsize=4)
def _field_basis(grid: Grid) -> F64:
    """Constant, two slopes and three curvatures over the frame, (n_patches, 6)."""
    y, x = _from_middle(grid)
    return np.stack([np.ones_like(x), y, x, y * x, y**2, x**2], axis=1)


def off_field(colours: F64, energy: F64, grid: Grid) -> F64:
    """The patches' colours less a smooth field of colour over the frame.

    The field is a quadratic function of the place, fitted to the quieter half of the patches with
    weights that fall with the distance from it (iteratively reweighted least squares with Cauchy's
    weight function: Holland, Welsch (1977), "Robust regression using iteratively reweighted
    least-squares", Commun. Statist. A 6).

    Parameters
    ----------
    colours : array of float64, shape (n_patches, 3)
        CIELAB.
    energy : array of float64, shape (n_patches,)
        Low where a patch is quiet.
    grid : Grid

    Returns
    -------
    numpy.ndarray
        float64, shape (n_patches, 3).
    """
    basis = _field_basis(grid)
    quiet = np.argsort(energy, kind="stable")[: (grid.n_patches + 1) // 2]
    basis, known = basis[quiet], colours[quiet]
    weight = np.ones(len(quiet))
    for _ in range(_ROUNDS):
        weighted = basis * weight[:, None]
        field = np.linalg.solve(weighted.T @ basis + _RIDGE, weighted.T @ known)
        off = known - basis @ field
        spread = SD_OF_MAD * median(np.abs(off)) + _LEAST_SPREAD
        weight = 1 / (1 + (off / (2 * spread)) ** 2).mean(axis=1)
    return np.asarray(colours - _field_basis(grid) @ field)


SD_OF_MAD = 1.4826
"""A normal distribution's standard deviation over its median absolute deviation."""
_LEAST_SPREAD = 0.3  # units of Lab: of a field that fits to the last digit
