"""The kernels that compute the texture features: compiled, numpy, or the reference libraries.

All three give the same: identical pictures and counts, Haralick features equal to rounding. The
choice is made once, when this module is imported: the compiled extension if it was built,
otherwise numpy; the environment variable ``TOKT_KERNELS`` (``compiled``, ``numpy`` or ``library``)
forces one.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, F64, I16, I64, U8, U16, U32, U64
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid

from .block_matching import BlockMatching, check_views
from .checks import (
    check_box,
    check_contrast,
    check_frame,
    check_gray,
    check_gray16,
    check_gray16_size,
    check_lags,
    check_lbp,
    check_ranges,
    check_rows,
    check_samples,
    check_signs,
    check_size,
    check_sums,
    check_view,
    check_weights,
)
from .quantization import Quantization

VARIABLE = "TOKT_KERNELS"
COMPILED, NUMPY, LIBRARY = "compiled", "numpy", "library"
_MODULES = {COMPILED: "compiled_kernels", NUMPY: "numpy_kernels", LIBRARY: "reference"}
NAMES = tuple(_MODULES)


@dataclass(frozen=True)
class Kernels:
    """One implementation of everything that is computed from pixels.

    What it is given is checked here: a TypeError or ValueError says what an argument must be. The
    rows of a picture are shared among `threads`, where the implementation knows any; what comes
    out does not depend on it. Where nothing else is said a `gray` picture is an array of uint8 of
    shape (height, width), the resized gray frame with the patches of `grid`, and a `frame` one of
    shape (rows, columns) or (rows, columns, 3), gray or BGR, as the camera gave it.

    Parameters
    ----------
    name : {"compiled", "numpy", "library"}
    why : str
        Why it was chosen, for people.
    module : module
        Has a function for each method here, which takes what was checked, in C order.
    """

    name: str
    why: str
    module: Any

    @property
    def detail(self) -> str:
        """What it consists of: the instruction set, or the libraries' versions."""
        return str(self.module.DETAIL)

    def lbp_counts(
        self, gray: U8, grid: Grid, points: int, radius: float, border: str, threads: int = 1
    ) -> I64:
        """Histograms of uniform rotation-invariant local binary patterns, one a patch.

        Parameters
        ----------
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
        gray = check_gray(gray, threads)
        check_lbp(points, radius, border)
        return np.asarray(self.module.lbp_counts(gray, grid, points, radius, border, threads))

    def lbp_nearest_counts(
        self, gray: U8, grid: Grid, points: int, radius: float, border: str, threads: int = 1
    ) -> I64:
        """`lbp_counts` with each point moved to the nearest whole pixel, half ones to even."""
        gray = check_gray(gray, threads)
        check_lbp(points, radius, border)
        counts = self.module.lbp_nearest_counts(gray, grid, points, radius, border, threads)
        return np.asarray(counts)

    def haralick_features(self, gray: U8, grid: Grid, ignore_zeros: bool, threads: int = 1) -> F64:
        """Haralick's first 13 texture features, mean over the 4 directions, one row a patch.

        Parameters
        ----------
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
        gray = check_gray(gray, threads)
        return np.asarray(self.module.haralick_features(gray, grid, ignore_zeros, threads))

    def resized_gray(self, frame: U8, height: int, width: int, threads: int = 1) -> U8:
        """A frame resized by area, then gray, each step rounded to whole grey levels.

        Returns
        -------
        numpy.ndarray
            uint8, shape (height, width), the pixels that OpenCV gives; the frame itself when it is
            gray and of that size.

        References
        ----------
        OpenCV ``resize`` with ``INTER_AREA``; ITU-R BT.601.
        """
        frame = check_frame(frame, threads)
        check_size(height, width)
        return np.asarray(self.module.resized_gray(frame, height, width, threads))

    def resized_gray16(self, frame: U8, height: int, width: int, threads: int = 1) -> U16:
        """A frame resized by area and gray, in 1/256 grey level, rounded once.

        A picture larger than the frame is made by the same rule: its pixels are the frame's, mixed
        where a border between two falls into one.

        Returns
        -------
        numpy.ndarray
            uint16, shape (height, width), 0 to 255 * 256.

        References
        ----------
        ITU-R BT.601, weights 4899, 9617, 1868 of 16384 as in OpenCV.
        """
        frame = check_frame(frame, threads)
        check_gray16_size(frame.shape, height, width)
        return np.asarray(self.module.resized_gray16(frame, height, width, threads))

    def resized_grays(self, frame: U8, height: int, width: int, threads: int = 1) -> tuple[U16, U8]:
        """`resized_gray16` and `resized_gray`, which take hardly more together than one alone."""
        frame = check_frame(frame, threads)
        check_gray16_size(frame.shape, height, width)
        gray16, gray = self.module.resized_grays(frame, height, width, threads)
        return gray16, gray

    def summed_area(self, gray16: U16) -> U32:
        """Sum all pixels above and left of each corner of a 16-bit gray picture's pixels.

        Returns
        -------
        numpy.ndarray
            uint32, shape (height + 1, width + 1), modulo 2**32: sums over boxes are differences.

        References
        ----------
        Crow (1984), "Summed-area tables for texture mapping", SIGGRAPH.
        """
        return np.asarray(self.module.summed_area(check_gray16(gray16)))

    def area_means(self, picture: NDArray[Any], height: int, width: int, threads: int = 1) -> F32:
        """A frame made gray in whole grey levels, or a view of float32, then resized by area.

        Returns
        -------
        numpy.ndarray
            float32, shape (height, width), grey levels and fractions: what OpenCV gives on x86 by
            ``resize`` with ``INTER_AREA`` in single precision.
        """
        check = check_view if getattr(picture, "dtype", None) == np.float32 else check_frame
        check_size(height, width)
        return np.asarray(self.module.area_means(check(picture, threads), height, width, threads))

    def local_contrast(self, view: F32, window: int, gain: float, least: float) -> tuple[F32, U8]:
        """The standard deviation around each pixel of a view, and the view made even by it.

        Parameters
        ----------
        view : array of float32, shape (height, width)
            Grey levels, 0 to 255.
        window : int
            Height and width in pixels of what is around a pixel, odd; mirrored beyond the edge.
        gain, least : float
            Grey levels that one local deviation becomes, and that a smaller one counts as.

        Returns
        -------
        sigma : array of float32, shape (height, width)
            Local standard deviations in grey levels.
        even : array of uint8, shape (height, width)
            The view with the same local contrast everywhere, 128 being the local mean.
        """
        check_contrast(window, gain, least)
        sigma, even = self.module.local_contrast(check_view(view), window, gain, least)
        return sigma, even

    def quantize(
        self, gray16: U16, quantization: Quantization, threads: int = 1, sums: U32 | None = None
    ) -> U8:
        """A 16-bit gray picture quantized, as `Quantization` says.

        Parameters
        ----------
        sums : array of uint32, shape (height + 1, width + 1), optional
            `summed_area` of the picture, where the caller has it.

        Returns
        -------
        numpy.ndarray
            uint8, shape (height, width), 0 to ``quantization.levels - 1``.
        """
        gray16 = check_gray16(gray16, threads)
        sums = check_sums(self.summed_area(gray16) if sums is None else sums, gray16.shape)
        return np.asarray(self.module.quantize(gray16, sums, quantization, threads))

    def level_counts(self, gray: U8, grid: Grid, threads: int = 1) -> I64:
        """Histograms of 256 levels, one a patch, int64, shape (n_patches, 256)."""
        return np.asarray(self.module.level_counts(check_gray(gray, threads), grid, threads))

    def structure_sums(self, gray: U8, grid: Grid, threads: int = 1) -> I64:
        """Sums of the structure tensor over each patch: changes across, down, and both together.

        With gx the pixel to the right less the one to the left and gy the one below less the one
        above, 0 where the picture ends: the sums of gx gx, gy gy and gx gy over a patch's pixels.

        Returns
        -------
        numpy.ndarray
            int64, shape (n_patches, 3).
        """
        return np.asarray(self.module.structure_sums(check_gray(gray, threads), grid, threads))

    def gradient_sums(self, gray16: U16, grid: Grid, box: int, threads: int = 1) -> I64:
        """Sums of squared gradients over each patch, and how strong its strong gradients are.

        Each pixel becomes the mean of the `box` x `box` pixels around it, rounded to a whole step;
        beyond the picture counts its nearest pixel. Then gx is the mean to the right less the one
        to the left and gy the one below less the one above, 0 where the picture ends.

        Parameters
        ----------
        gray16 : array of uint16, shape (height, width)
            As `resized_gray16` gives it.
        box : int
            Pixels, odd, 1 to 15.

        Returns
        -------
        numpy.ndarray
            int64, shape (n_patches, 3): the sums of gx gx and of gy gy over a patch's pixels, then
            the 95th of 100 of gx gx + gy gy in rising order, of which the first 4 binary digits
            are kept. It is the least that 19 of 20 pixels or more do not exceed.
        """
        gray16 = check_gray16(gray16, threads)
        check_box(box)
        return np.asarray(self.module.gradient_sums(gray16, grid, box, threads))

    def difference_sums(self, frame: U8, rows: I64, cols: int, lags: Sequence[int]) -> I64:
        """Sums of how much a frame's levels differ from those `lags` pixels away, across and down.

        Parameters
        ----------
        rows : array of int64, shape (n,)
            The rows that are looked at; below each there are as many as the largest lag.
        cols : int
            Equal patches side by side, ``width // cols`` pixels wide.
        lags : sequence of int
            In pixels, at least 1.

        Returns
        -------
        numpy.ndarray
            int64, shape (n, cols, 2 + 2 * len(lags)), of one row of a patch in all its channels:
            the sum of levels, how many are 250 or more, the sums of differences (without their
            signs) from the pixel each lag to the right, where there is one, and from the one each
            lag below.
        """
        frame = check_frame(frame)
        check_lags(lags)
        check_rows(rows, cols, frame.shape, max(lags))
        return np.asarray(self.module.difference_sums(frame, rows, cols, lags))

    def curvature_sums(self, gray16: U16, grid: Grid, lags: Sequence[int], threads: int = 1) -> I64:
        """Sums of squared second differences over each patch, across and down together.

        That of a pixel is the one `lag` before it, less twice itself, and the one `lag` behind it;
        0 where one of them is beyond the picture, and 16 grey levels at most: even light has none.

        Parameters
        ----------
        gray16 : array of uint16, shape (height, width)
            As `resized_gray16` gives it.
        lags : sequence of int
            In pixels, at least 1.

        Returns
        -------
        numpy.ndarray
            int64, shape (n_patches, len(lags)).
        """
        gray16 = check_gray16(gray16, threads)
        check_lags(lags)
        return np.asarray(self.module.curvature_sums(gray16, grid, lags, threads))

    def box_sums(self, frame: U8, rows: I64, columns: I64, threads: int = 1) -> I64:
        """Sums of a frame's pixels over boxes: where ranges of its rows and columns cross.

        Parameters
        ----------
        rows, columns : array of int64, shape (n, 2)
            First pixel and one past the last of each range. Ranges may overlap and stand in any
            order.

        Returns
        -------
        numpy.ndarray
            int64, shape (len(rows), len(columns), channels), 3 channels or 1.
        """
        frame = check_frame(frame, threads)
        rows = check_ranges(rows, frame.shape[0])
        columns = check_ranges(columns, frame.shape[1])
        return np.asarray(self.module.box_sums(frame, rows, columns, threads))

    def line_sums(
        self, gray: U8, grid: Grid, middle: int, samples: Sequence[int], threads: int = 1
    ) -> I64:
        """How much longer lines through a patch's pixels, bright or dark, are in one direction.

        S is the sum of n samples, two pixels or a knight's or king's move apart, on a line through
        the pixel (sample n / 2 is the pixel itself), of levels less `middle`; 0 beyond the picture.

        Parameters
        ----------
        middle : int
            The level that counts as nothing.
        samples : sequence of int
            The numbers n, increasing powers of 2 from 2 to 64.

        Returns
        -------
        numpy.ndarray
            int64, shape (n_patches, len(samples), 9): sums over a patch's pixels, first of 8 times
            the largest of the directions' S less all of them, then of each direction's S squared.
        """
        gray = check_gray(gray, threads)
        check_samples(samples, middle)
        return np.asarray(self.module.line_sums(gray, grid, middle, samples, threads))

    def row_marks(self, gray: U8, weights: U64, lag: int, largest: int) -> tuple[U64, U64]:
        """Marks by which rows are known again: hashes of their pieces, and signs of differences.

        Parameters
        ----------
        gray : array of uint8, shape (height, width)
            The picture's rows.
        weights : array of uint64, shape (pieces, words), in C order
            Of each 8 pixels of a row's pieces, at least one of each; as many as a row has.
        lag, largest : int
            Differences are those of pixels so far apart, and count up to so many grey levels.

        Returns
        -------
        hashes : array of uint64, shape (height, pieces)
            Sums of pixels, 8 as one number, times weights, modulo 2**64.
        signs : array of uint64, shape (2, height, tiles)
            A bit for each pixel where the one `lag` further on is brighter, then darker; the first
            pixel lowest. As many tiles of 64 as a row has whole ones.
        """
        gray = check_gray(gray)
        check_weights(weights, gray.shape[1])
        hashes, signs = self.module.row_marks(gray, weights, lag, largest)
        return hashes, signs

    def sign_counts(self, signs: U64, others: U64) -> I64:
        """Where the signs of other pictures are those of one, and where they are opposite.

        Parameters
        ----------
        signs : array of uint64, shape (2, height, tiles), in C order
            As `row_marks` gives them.
        others : array of uint64, shape (n, 2, height, tiles), in C order

        Returns
        -------
        numpy.ndarray
            int64, shape (n, 2).
        """
        check_signs(signs, others)
        return np.asarray(self.module.sign_counts(signs, others))

    def block_disparity(self, left: U8, right: U8, settings: BlockMatching, wanted: U8) -> I16:
        """Disparity of the wanted pixels of the left view, the integers of OpenCV's StereoBM.

        Parameters
        ----------
        left, right : array of uint8, shape (height, width)
            Rectified views.
        settings : BlockMatching
        wanted : array of uint8, shape (height, width)
            Not 0 where a disparity is wanted.

        Returns
        -------
        array of int16, shape (height, width)
            In 1/16 pixel; ``settings.unmatched`` where none is wanted, where the block leaves the
            view, and where it has too little texture or no unique match.
        """
        left, right, wanted = check_views(left, right, wanted)
        return np.asarray(self.module.block_disparity(left, right, settings, wanted))


def load_kernels(name: str, why: str = "asked for") -> Kernels:
    """The kernels of that name; ToktError if it is not known, ImportError if they are not here."""
    if name not in NAMES:
        raise ToktError(f"{VARIABLE}={name}: unknown kernels (choose from {', '.join(NAMES)})")
    # Only the one asked for: the reference needs scikit-image and mahotas.
    return Kernels(name, why, import_module(f".{_MODULES[name]}", __package__))


def _reason(error: ImportError) -> str:
    if str(error).startswith("cannot import name '_native'"):
        return "they were not built; install a platform's wheel, or where there is a C compiler"
    return str(error)


def choose_kernels(wanted: str) -> Kernels:
    """The kernels that `VARIABLE` names, or the fastest here; ToktError if they are not here."""
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
