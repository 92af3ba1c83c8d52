"""The noise that two pictures have in common, wherever it has been moved to.

A camera's noise is new in each picture. Where a picture is an old one that was panned, zoomed,
stabilised or given grain, its noise comes again, shifted by about as many pixels everywhere.

::

    tiles of both ── fine differences ── spectra, phases alone ── correlation by shift
                                                                   .  .  .  .  .
                                                                   .  .  ^  .  .   one peak: old
                                                                   .  .  .  .  .

This is phase correlation (Kuglin and Hines 1975), summed over tiles before its peak is looked for.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, U8, Bools

TILE_PX = 64  # side of a tile, and the length of a row that is quiet or not
LAG_PX = 2  # between the pixels whose difference shows the noise
_DOWN, _ACROSS = 3, 4  # tiles
_MARGIN = 0.08  # of the height and the width, where lenses are dark and captions stand
LARGEST = 8  # grey levels; larger differences are the picture's, not noise
_FEWEST_PAIRS = 2
_FEWEST_EVERYWHERE = 4  # pairs of tiles that tell whether something is everywhere

FAR_PX = 16
QUIET = 2.0
"""Noise is looked for where a picture changes no more over `FAR_PX` than this multiple of what it
does over `LAG_PX`, which texture does."""

CHANCE = 0.125
"""What new noise has in common with other noise at the best of all shifts, at most, over the square
root of the number of pairs of tiles. Measured on the sea trial of 20 April 2016, each picture
against the one before: 0.09. One picture given noise of 4 grey levels each time: 0.14 and more;
moved by parts of a pixel 0.4, zoomed by 1 % 0.11, both against the copy before."""

CHECKED = 0.6
"""Above this multiple of `CHANCE`, whether all tiles have it in common is looked at. Before a drawn
structure where a vehicle hovers it was 0.8 to 4.0, and nearly all of that in one pair of tiles."""
MOST_OF_ONE = 2.0
"""How many times what more than half of the pairs reach one pair counts at most."""


class Noise(NamedTuple):
    """The noise of one picture's tiles."""

    phases: NDArray[np.complex64]  # (pairs, 64, 64), of length 1; 0 where neither tile is quiet
    quiet: Bools  # (tiles,): where there is noise and nothing else


class Common(NamedTuple):
    """What two pictures have in common."""

    like: float  # what is everywhere, as a multiple of `CHANCE`; 0 where too few tiles tell
    somewhere: float  # what may be in one place, as that multiple
    moved: bool  # whether something is at another place in the one than in the other


@lru_cache(maxsize=1)
def _window() -> F32:
    return np.asarray(cv2.createHanningWindow((TILE_PX, TILE_PX), cv2.CV_32F), np.float32)


@lru_cache(maxsize=8)
def _corners(height: int, width: int) -> list[tuple[int, int]]:
    """Row and column at the top left of each tile; none of a picture that is too small."""
    down, across = (
        np.linspace(_MARGIN * size, (1 - _MARGIN) * size - needed, count).astype(int).tolist()
        for size, needed, count in ((height, TILE_PX, _DOWN), (width, TILE_PX + LAG_PX, _ACROSS))
    )
    # None lies on another, so that no noise counts twice.
    fits = all(places[1] - places[0] >= TILE_PX for places in (down, across))
    return [(y, x) for y in down for x in across] if fits else []


def noise_of(plane: U8, before: Noise | None) -> Noise | None:
    """The noise of a gray picture, shape (height, width); None of one too small for tiles.

    It is taken from tiles that are quiet, or were in the picture `before`, whose copy this may be.
    """
    corners = _corners(*plane.shape)
    if not corners:
        return None
    columns = TILE_PX + LAG_PX
    tiles = np.concatenate([plane[y : y + TILE_PX, x : x + columns] for y, x in corners])
    near, far = (_mean_difference(tiles, by) for by in (LAG_PX, FAR_PX))
    quiet = far <= QUIET * near
    steps = cv2.subtract(tiles[:, LAG_PX:], tiles[:, :-LAG_PX], dtype=cv2.CV_32F)
    fine = np.asarray(steps, np.float32)
    fine = np.clip(fine, -LARGEST, LARGEST, out=fine).reshape(-1, TILE_PX, TILE_PX)
    used = quiet if before is None else quiet | before.quiet
    fine *= _window() * (used / np.maximum(near, 1e-3))[:, None, None]
    # Two tiles as the parts of complex numbers, so that the sum of their correlations is the real
    # part of one. Both count as much.
    pairs = np.empty((len(fine) // 2, TILE_PX, TILE_PX, 2), np.float32)
    pairs[..., 0], pairs[..., 1] = fine[0::2], fine[1::2]
    for pair in pairs:
        cv2.dft(pair, dst=pair)
    phases = pairs.view(np.complex64)[..., 0]
    lengths = np.abs(phases)
    phases *= 1 / (lengths + 1e-3 * lengths.max() + 1e-6)
    return Noise(phases, quiet)


def _mean_difference(tiles: U8, by: int) -> F32:
    """How much each tile differs from itself so many pixels further left, in grey levels."""
    differences = cv2.absdiff(tiles[:, by:], tiles[:, :-by])
    each = differences.reshape(_DOWN * _ACROSS, -1)
    return np.asarray(cv2.reduce(each, 1, cv2.REDUCE_AVG, dtype=cv2.CV_32F)[:, 0], np.float32)


def in_common(old: Noise | None, new: Noise | None) -> Common | None:
    """How much noise two pictures have in common; None where they have too few quiet tiles."""
    if old is None or new is None:
        return None
    shared = new.phases * old.phases.conj()
    pairs = np.count_nonzero(shared[:, 1, 1])
    if pairs < _FEWEST_PAIRS:
        return None
    by_shift = _correlation(shared.sum(axis=0))
    best = int(by_shift.argmax())
    like = somewhere = float(by_shift.flat[best]) / (CHANCE * math.sqrt(pairs))
    if pairs < _FEWEST_EVERYWHERE:
        like = 0.0
    elif somewhere > CHECKED:
        like = min(somewhere, _everywhere(shared[shared[:, 1, 1] != 0], best))
    return Common(like, somewhere, moved=best != 0 and somewhere > CHECKED)


def _correlation(shared: NDArray[np.complex64]) -> F32:
    """Correlation of phases by shift, shape (64, 64), from the product of two spectra."""
    parts = np.ascontiguousarray(shared).view(np.float32).reshape(TILE_PX, TILE_PX, 2)
    return np.asarray(cv2.idft(parts, flags=cv2.DFT_SCALE)[..., 0], np.float32)


def _everywhere(shared: NDArray[np.complex64], best: int) -> float:
    """What most pairs of tiles have in common, at one shift or each at its own, in `CHANCE`.

    An old picture's noise comes again in all of it. What comes again in one place is texture.
    """
    each = [_correlation(pair) for pair in shared]
    half = (len(each) - 1) // 2  # more than half of the pairs reach the value of this place
    there = np.sort([pair.flat[best] for pair in each])
    together = np.minimum(there, MOST_OF_ONE * there[half]).sum() / math.sqrt(len(each))
    apart = np.sort([pair.max() for pair in each])[half]  # where it is zoomed or turned
    return float(max(together, apart)) / CHANCE
