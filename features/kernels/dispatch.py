"""The kernels that compute the texture features: compiled, numpy, or the reference libraries.

All three give the same: identical pictures and counts, Haralick features equal to rounding. The
choice is made once, when this module is imported: the compiled extension if it was built,
otherwise numpy; the environment variable ``TOKT_KERNELS`` (``compiled``, ``numpy`` or ``library``)
forces one.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields
from types import ModuleType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid

from .block_matching import BlockMatching
from .quantization import Quantization

VARIABLE = "TOKT_KERNELS"
COMPILED, NUMPY, LIBRARY = "compiled", "numpy", "library"
NAMES = (COMPILED, NUMPY, LIBRARY)


class LbpCounts(Protocol):
    """Histograms of uniform rotation-invariant local binary patterns, one a patch."""

    def __call__(
        self,
        gray: NDArray[np.uint8],
        grid: Grid,
        points: int,
        radius: float,
        border: str,
        threads: int = 1,
    ) -> NDArray[np.int64]:
        """Counts, int64, shape (n_patches, points + 2)."""


class HaralickFeatures(Protocol):
    """Haralick's first 13 features, mean over 4 directions, one row a patch."""

    def __call__(
        self, gray: NDArray[np.uint8], grid: Grid, ignore_zeros: bool, threads: int = 1
    ) -> NDArray[np.float64]:
        """Features, float64, shape (n_patches, 13)."""


class ResizedGray(Protocol):
    """Area resize and BGR to gray (ITU-R BT.601), the pixels that OpenCV gives."""

    def __call__(
        self, frame: NDArray[np.uint8], height: int, width: int, threads: int = 1
    ) -> NDArray[np.uint8]:
        """Gray picture, uint8, shape (height, width)."""


class ResizedGray16(Protocol):
    """Area resize and BGR to gray (ITU-R BT.601) in 1/256 grey level, rounded once."""

    def __call__(
        self, frame: NDArray[np.uint8], height: int, width: int, threads: int = 1
    ) -> NDArray[np.uint16]:
        """16-bit gray picture, uint16, shape (height, width)."""


class Quantize(Protocol):
    """A 16-bit gray picture flattened and quantized to a number of levels."""

    def __call__(
        self, gray16: NDArray[np.uint16], quantization: Quantization, threads: int = 1
    ) -> NDArray[np.uint8]:
        """Picture, uint8, shape (height, width)."""


class LevelCounts(Protocol):
    """Histograms of a picture's levels, one a patch."""

    def __call__(self, gray: NDArray[np.uint8], grid: Grid, threads: int = 1) -> NDArray[np.int64]:
        """Counts, int64, shape (n_patches, 256)."""


class StructureSums(Protocol):
    """Sums of the structure tensor, one a patch."""

    def __call__(self, gray: NDArray[np.uint8], grid: Grid, threads: int = 1) -> NDArray[np.int64]:
        """Sums, int64, shape (n_patches, 3)."""


class LineSums(Protocol):
    """Sums along lines in 8 directions, one row a patch and number of samples."""

    def __call__(
        self,
        gray: NDArray[np.uint8],
        grid: Grid,
        middle: int,
        samples: Sequence[int],
        threads: int = 1,
    ) -> NDArray[np.int64]:
        """Sums, int64, shape (n_patches, len(samples), 9)."""


class BlockDisparity(Protocol):
    """Block matching of two rectified views, the integers that OpenCV's StereoBM gives."""

    def __call__(
        self,
        left: NDArray[np.uint8],
        right: NDArray[np.uint8],
        settings: BlockMatching,
        wanted: NDArray[np.uint8],
    ) -> NDArray[np.int16]:
        """Disparity in 1/16 pixel of the wanted pixels, int16, shape (height, width)."""


@dataclass(frozen=True)
class Kernels:
    """One implementation of everything that is computed from pixels.

    Parameters
    ----------
    name : {"compiled", "numpy", "library"}
    why : str
        Why it was chosen, for people.
    detail : str
        What it consists of: the instruction set, or the libraries' versions.
    lbp_counts, lbp_nearest_counts : LbpCounts
    haralick_features : HaralickFeatures
    resized_gray : ResizedGray
    resized_gray16 : ResizedGray16
    quantize : Quantize
    level_counts : LevelCounts
    structure_sums : StructureSums
    line_sums : LineSums
    block_disparity : BlockDisparity
    """

    name: str
    why: str
    detail: str
    lbp_counts: LbpCounts
    lbp_nearest_counts: LbpCounts
    haralick_features: HaralickFeatures
    resized_gray: ResizedGray
    resized_gray16: ResizedGray16
    quantize: Quantize
    level_counts: LevelCounts
    structure_sums: StructureSums
    line_sums: LineSums
    block_disparity: BlockDisparity


def _module(name: str) -> ModuleType:
    # Only the one asked for: the reference needs scikit-image and mahotas.
    if name == COMPILED:
        from . import compiled_kernels

        return compiled_kernels
    if name == NUMPY:
        from . import numpy_kernels

        return numpy_kernels
    from . import reference

    return reference


def load_kernels(name: str, why: str = "asked for") -> Kernels:
    """The kernels of that name.

    Raises
    ------
    ToktError
        If the name is not known.
    ImportError
        If this machine does not have them.
    """
    if name not in NAMES:
        raise ToktError(f"{VARIABLE}={name}: unknown kernels (choose from {', '.join(NAMES)})")
    module = _module(name)
    made = {each.name: getattr(module, each.name) for each in fields(Kernels)[3:]}
    return Kernels(name, why, module.DETAIL, **made)


def _reason(error: ImportError) -> str:
    if str(error).startswith("cannot import name '_native'"):
        return "they were not built; install tokt again where there is a C compiler"
    return str(error)


def choose_kernels(wanted: str) -> Kernels:
    """The kernels that `VARIABLE` asks for, or the fastest this machine has.

    Parameters
    ----------
    wanted : str
        The variable's value; empty for the fastest.

    Raises
    ------
    ToktError
        If the ones asked for are not known or not there.
    """
    if wanted:
        try:
            return load_kernels(wanted, f"{VARIABLE}={wanted}")
        except ImportError as error:
            raise ToktError(f"{VARIABLE}={wanted}: not on this machine: {_reason(error)}") from None
    try:
        return load_kernels(COMPILED, "the fastest there are")
    except ImportError as error:
        return load_kernels(NUMPY, f"no compiled ones: {_reason(error)}")


KERNELS = choose_kernels(os.environ.get(VARIABLE, ""))
"""What the extractors of this process use."""
