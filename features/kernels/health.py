"""The kernels this process uses, compared with every other implementation on this machine."""

from __future__ import annotations

import os
from collections.abc import Iterator
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F64, U8, U16
from tokt.features.common.errors import FAULT, NOTE, OK, Finding, ToktError
from tokt.features.frames.grid import Grid

from .block_matching import BlockMatching
from .quantization import FRAME, RATIO, Quantization

if TYPE_CHECKING:
    from .dispatch import Kernels

# dispatch.py has this name too, but cannot be imported while the variable's value is wrong.
_VARIABLE = "TOKT_KERNELS"
_KERNELS = f"{__package__}.dispatch"
_RELATIVE = 1e-9
_GRID = Grid(2, 2, 72)
_HEIGHT = 54
_BORDERS = ("patch", "frame")
_LBP = ((10, 5, "patch"), (10, 5, "frame"), (24, 8, "patch"), (24, 8, "frame"))
_QUANTIZATIONS = (
    Quantization(8.0, 64, 3, 21),
    Quantization(2.0, 256, 1, 33, RATIO),
    Quantization(9.0, 32, 1, 9, FRAME),
)
_RANGES = np.array([[0, 30], [30, 107]]), np.array([[1, 60], [50, 145]])
_MATCHING = BlockMatching(2, 16, 9, 31, 50, 10)


def kernel_findings() -> Iterator[Finding]:
    """The kernels in use, then each other implementation compared with them.

    Afterwards `tokt.features.kernels.dispatch` can be imported, also where ``TOKT_KERNELS`` asks
    for kernels that are not there: the default ones then, so that what needs any can be examined.

    Raises ImportError if this machine has no kernels at all.
    """
    fault = _load_default_on_fault()
    from .dispatch import COMPILED, KERNELS, NAMES, load_kernels

    wanted = os.environ.get(_VARIABLE, "")
    setting = f"{_VARIABLE}={wanted}" if wanted else f"{_VARIABLE} is not set"
    figures = {
        "kernels": KERNELS.name,
        "detail": KERNELS.detail,
        "why": KERNELS.why,
        "variable": wanted,
    }
    if fault:
        text = f"{fault}; no model can be trained or run; examined with {KERNELS.name}"
        yield Finding("kernels", FAULT, text, figures)
    else:
        why = KERNELS.why if KERNELS.why == setting else f"{KERNELS.why}; {setting}"
        state = OK if KERNELS.name == COMPILED else NOTE
        yield Finding("kernels", state, f"{KERNELS.name}, {KERNELS.detail} ({why})", figures)
    for name in NAMES:
        if name != KERNELS.name:
            try:
                other = load_kernels(name)
            except ImportError as error:
                yield Finding(f"{name} kernels", NOTE, f"not on this machine ({error})")
            else:
                yield compared(KERNELS, other)


def _load_default_on_fault() -> str:
    """Import the kernels; what is wrong with the user's choice, or nothing."""
    try:
        import_module(_KERNELS)
    except ToktError as error:
        wanted = os.environ.pop(_VARIABLE)
        try:
            import_module(_KERNELS)
        finally:
            os.environ[_VARIABLE] = wanted
        return str(error)
    return ""


def _frame() -> U8:
    """Four textures, one of them dark with many zeros; BGR, twice as large as their picture."""
    rng = np.random.default_rng(0)
    frame = rng.normal(70, 25, (2 * _HEIGHT + 1, 2 * 72 + 1, 3))
    frame[:_HEIGHT, :72] -= 65
    return np.asarray(frame.clip(0, 255), np.uint8)


def compared(active: Kernels, other: Kernels) -> Finding:
    """Whether two implementations describe a small picture alike.

    Pictures and counts have to be identical, Haralick features equal to 1e-9 of their value. The
    picture is one where every implementation is accurate to more than that.
    """
    both, frame = (active, other), _frame()
    gray = active.resized_gray(frame, _HEIGHT, 72)
    gray16 = active.resized_gray16(frame, _HEIGHT, 72)
    pixels = int(np.count_nonzero(gray != other.resized_gray(frame, _HEIGHT, 72)))
    pairs = zip(*(_integers(kernels, frame, gray, gray16) for kernels in both), strict=True)
    deep = sum(int(np.count_nonzero(one != two)) for one, two in pairs)
    one, two = (np.hstack([each.lbp_counts(gray, _GRID, *lbp) for lbp in _LBP]) for each in both)
    counts, zeros = int(np.abs(one - two).sum()), (False, True)
    relative = _relative_difference(
        *(np.vstack([each.haralick_features(gray, _GRID, no) for no in zeros]) for each in both)
    )
    same = pixels == 0 and deep == 0 and counts == 0 and relative <= _RELATIVE
    text = (
        f"gray pixels that differ from {active.name}: {pixels}, 16-bit gray ones: {deep}, "
        f"LBP counts: {counts}, largest relative difference of Haralick features: {relative:.1e}"
    )
    if same:
        text = f"same as {active.name} (LBP identical, Haralick features to {relative:.1e})"
    figures = {
        "compared_with": active.name,
        "gray_difference": pixels,
        "deep_difference": deep,
        "lbp_difference": counts,
        "haralick_relative_difference": relative if np.isfinite(relative) else None,
    }
    return Finding(f"{other.name} kernels", OK if same else FAULT, text, figures)


def _integers(kernels: Kernels, frame: U8, gray: U8, gray16: U16) -> list[NDArray[np.integer]]:
    """16-bit gray, what it is quantized to, whole sums over patches, and disparities."""
    return [
        kernels.resized_gray16(frame, _HEIGHT, 72),
        *(kernels.quantize(gray16, quantization) for quantization in _QUANTIZATIONS),
        kernels.level_counts(gray, _GRID),
        kernels.structure_sums(gray, _GRID),
        kernels.gradient_sums(gray16, _GRID, 5),
        kernels.box_sums(frame, *_RANGES),
        kernels.line_sums(gray, _GRID, 128, (4, 16)),
        kernels.difference_sums(frame, np.arange(8), 2, (1, 16)),
        kernels.curvature_sums(gray16, _GRID, (1, 4)),
        *(kernels.lbp_nearest_counts(gray, _GRID, 8, 5, border) for border in _BORDERS),
        # Of the picture and of itself moved by a few pixels.
        kernels.block_disparity(gray, np.roll(gray, -9, axis=1), _MATCHING, np.ones_like(gray)),
    ]


def _relative_difference(one: F64, two: F64) -> float:
    """Largest difference relative to the larger value; infinite where one is not a number."""
    size = np.maximum(np.abs(one), np.abs(two))
    difference = np.divide(np.abs(one - two), size, out=np.zeros_like(size), where=size != 0)
    return float(np.nan_to_num(difference, nan=np.inf).max())
