"""Pictures that are no new ones: repeated, coming round again, or an old one with small changes.

A camera's noise makes each of its pictures another, down to parts of a row. Pictures are known
again by that: a picture is described by some of its rows, the hash of each piece of one, and the
signs of its finest differences, where noise is all that there is in water.

What cannot be told from a new picture:

- Buffers that go round and are more than `REMEMBERED`; more than `COMPARED`, where each picture is
  compressed anew or gets noise on top.
- An old picture in a stream whose compression leaves no noise (`NOISY`), where no more than
  `MOSTLY_SAME` of it stays as it was: it is compressed otherwise each time, or brighter and
  darker. JPEG of quality 75 leaves none where the noise is below 1.5 grey levels.
- One compressed below quality 70 (85 in pictures 360 wide), or with noise of 3 grey levels and
  more put on top; part of a picture compressed otherwise each time, at times.
- One that froze before the run began and changes all over: no picture without its noise is known.
- One with noise on top, or compressed again, before what is textured all over: new pictures of it
  are alike too (`GROWS`). One that moves by parts of a pixel as well (`DRIFT`).
- Less than `PART` of a picture.

A label written into each picture, which covers `PART` of it, looks like a part that is frozen.
"""

import math
from collections import deque
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np

from tokt.features.common.arrays import U8, U64
from tokt.features.kernels.dispatch import KERNELS

from .config import Limits
from .frame import Frame, shape_fault
from .reason import Fault, Reason

# Measured on the 490 pairs of successive frames of the sea trial of 20 April 2016, 245 of each
# camera, and on still water drawn with noise of 0.5 to 3 grey levels ("drawn").

REMEMBERED = 64
"""Pictures of each camera that must not come again: 1.3 kB of hashes each, for 1360x1024."""

PART = 0.05
"""Part of a picture that is the same to the last bit as in an earlier one: a frozen part, as noise
forbids that. Measured: no piece of a row in 490 pairs, nor in 64 frames before; drawn, 360 pixels
wide and more, where there is noise (`NOISY`): none."""

MOSTLY_SAME = 0.35
"""The same where a picture has no noise. Drawn, after JPEG of quality 75: at most 0.06 of
1360x1024, 0.09 of 360x271; a sensor of less noise still, or a picture of 180x135, may come to it.
"""

NOISY = 0.1
"""Part of the finest differences that are not zero, above which a picture has noise. Measured: 0.3
and more."""

COMPARED = 8
"""Pictures of each camera whose noise must not come again: as many as drivers have buffers."""

SAME_NOISE = 0.16
"""By how much more often signs agree with those of one of the last pictures than with the median of
the others, from -1 to 1. Measured: at most 0.12; one frozen picture, compressed again at quality
75 to 95, 0.42 and more; with noise of 1 grey level put on top 0.59, of 2 0.29, of 3 0.16."""
_SIGMAS, _FEWEST_SIGNS = 5.0, 50

_ROWS = 32
_PIECE_PX = 240
"""At least, unless the picture is narrower: compressed, a shorter one comes again by chance."""
_WORD = 8
_FEWEST_WORDS = 2  # in a row, so that a flat piece is seen
_LAG = 2
_BLOCK = 8
"""A JPEG block's width in pixels. Steps between blocks come from the picture, not from noise."""
_LARGEST = 8  # grey levels; larger differences are the picture's, not noise

QUIET = 2.0
QUIET_PART = 0.25
"""Noise is compared where a row changes no more over 16 pixels than this multiple of what it does
over 2, which texture does; and where so much of the picture is such water. A sea floor that goes by
slowly was frozen by its own texture before: 17 of 24 frames of a drawn reef. Measured: 0.30 of the
picture and more, close to the tower; of that reef 0.1."""
_FAR_PX, _TILE_PX = 16, 64

GROWS = 2.0
"""Signs agree so many times as much as in any of the last pictures. A finely textured wall comes to
rest before a vehicle by less and less of a pixel: new pictures are alike as well then, and more and
more. A frozen one is so at once. Such walls were frozen for good before: the closed loop's."""

DRIFT = 6.0
"""Standard errors by which fine detail has moved in a picture that is none again, as a wall's does
where a vehicle stops at once. Measured: copies of 82 frames in three sizes with noise, other light
or compressed again, 4.9 at most; a drawn wall that moves by a tenth of a pixel, 10 and more."""
_STEEPEST = 16
"""Grey levels from pixel to pixel. Of edges that are steeper, a part: few would decide."""
_PARTS, _FEWEST_LINES = 4, 8

_NONE, _ALL = np.uint64(0), np.uint64(2**64 - 1)  # of a tile's pixels
_INSIDE = np.full(8, 2 ** (_BLOCK - _LAG) - 1, np.uint8).view(np.uint64)
"""Those that do not reach into the next JPEG block."""


class _Look(NamedTuple):
    """What is kept of a picture."""

    rows: U8  # some of its rows, grey
    hashes: U64  # of pieces of rows; 0 where a piece is flat
    signs: U64  # a bit a pixel where a difference is above zero, and where below
    noise: float  # part of the differences that are not zero


@lru_cache(maxsize=8)
def _weights(width: int) -> U64:
    """The weights of a row's words, by its pieces; they come to zero for a flat piece."""
    pieces = max(width // _PIECE_PX, 1)
    weights = np.random.default_rng(0).integers(
        2**64, size=(pieces, width // _WORD // pieces), dtype=np.uint64
    )
    weights[:, -1] -= weights.sum(axis=1, dtype=np.uint64)
    return weights


def _one_channel(picture: U8) -> U8:
    """A gray picture itself, of a BGR one the green channel: shape (height, width), in C order."""
    if picture.ndim == 2 or not picture.size:
        return np.ascontiguousarray(picture if picture.ndim == 2 else picture[:, :, 1])
    return np.asarray(cv2.extractChannel(picture, 1), np.uint8)


def _some(lines: U8) -> U8:
    step = max(len(lines) // _ROWS, 1)
    return lines[step // 2 :: step]


def _look(picture: U8) -> _Look:
    rows = _one_channel(_some(picture))
    if rows.shape[1] < _FEWEST_WORDS * _WORD:
        none = np.zeros((2, len(rows), 0), np.uint64)
        return _Look(rows, none[0], none, 0.0)
    hashes, signs = KERNELS.row_marks(rows, _weights(rows.shape[1]), _LAG, _LARGEST)
    signs &= _INSIDE
    inside = signs[0].size * _TILE_PX * (_BLOCK - _LAG) / _BLOCK
    return _Look(rows, hashes, signs, int(np.bitwise_count(signs).sum()) / max(inside, 1))


def _quiet(rows: U8) -> U64:
    """Where rows show noise alone: they change no more over some pixels than over `_LAG`."""
    wide = max(rows.shape[1] - _LAG, 0) // _TILE_PX * _TILE_PX  # of whole tiles
    earlier, later = rows[:, :wide], rows[:, _LAG : wide + _LAG]
    if not earlier.size:
        return np.zeros((len(rows), 0), np.uint64)
    far = np.zeros(earlier.shape, np.uint8)
    far[:, _FAR_PX:] = cv2.absdiff(earlier[:, _FAR_PX:], earlier[:, :-_FAR_PX])
    near, over = (
        cv2.reduce(each.reshape(-1, _TILE_PX), 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S)
        for each in (cv2.absdiff(earlier, later), far)
    )
    tiles = over <= QUIET * near
    if np.count_nonzero(tiles) < QUIET_PART * len(tiles):
        tiles[:] = False
    return np.where(tiles, _ALL, _NONE).reshape(len(rows), -1)


def _plane(picture: U8) -> U8:
    return picture if picture.ndim == 2 else picture[:, :, 1]


def _likeness(one: U64, others: U64) -> tuple[float, float, int]:
    """By how much more a picture's signs agree with those of one of the others than by chance.

    Then what of that chance may do at most, and which one of the others it is.
    """
    found = [
        ((alike - opposite) / (alike + opposite), 1 / (alike + opposite), place)
        for place, (alike, opposite) in enumerate(KERNELS.sign_counts(one, others).tolist())
        if alike + opposite >= _FEWEST_SIGNS
    ]
    # Where most of the others show too much else, what is by chance is not known.
    if len(found) < max(2, len(others) // 2 + 1):
        return 0.0, SAME_NOISE, 0
    *rest, (best, its_variance, place) = sorted(found)
    # The middle one: where a copy was not known, it and its picture agree as well.
    by_chance, variance, _ = rest[(len(rest) - 1) // 2]
    return best - by_chance, max(SAME_NOISE, _SIGMAS * math.sqrt(variance + its_variance)), place


def _lines(picture: U8) -> tuple[U8, U8]:
    """Some rows of a picture, and some columns."""
    plane = _plane(picture)
    return np.ascontiguousarray(_some(plane)), np.ascontiguousarray(_some(plane.T))


def _drifts(old: U8, new: U8) -> bool:
    """Whether fine detail has moved along lines, all of them or the same part of each.

    The shift of least squares (Lucas and Kanade 1981), judged by how it differs from line to line.
    What noise, brightness and compression do to a copy points neither way.
    """
    before, after = (
        np.diff(each.astype(np.float32), axis=1).clip(-_STEEPEST, _STEEPEST) for each in (old, new)
    )
    both = before + after
    # Without the ends, whose one-sided slopes noise alone would move inwards.
    moved = (both[:, 2:] - both[:, :-2]) * (after - before)[:, 1:-1]
    length = moved.shape[1] // _PARTS * _PARTS
    if len(moved) < _FEWEST_LINES or not length:
        return False
    parts = moved[:, :length].reshape(len(moved), _PARTS, -1).sum(axis=2)
    sums = np.column_stack([parts, parts.sum(axis=1)])
    error = sums.std(axis=0, ddof=1) / math.sqrt(len(sums))
    return bool((np.abs(sums.mean(axis=0)) > DRIFT * error).any())


def _middles(picture: U8) -> tuple[U64, U64]:
    """The middle `_WORD` pixels of each row, and of each column."""
    y, x = (size // 2 for size in picture.shape)
    middles = picture[:, x : x + _WORD], picture[y : y + _WORD].T
    rows, columns = (np.ascontiguousarray(each).view(np.uint64)[:, 0] for each in middles)
    return rows, columns


def _moved(last: U8, middles: tuple[U64, U64], picture: U8) -> bool:
    """Whether the middle row of a picture, or its middle column, is another one of the last."""
    for old, middle, new in zip((last, last.T), middles, (picture, picture.T), strict=True):
        line, x = new[len(new) // 2], new.shape[1] // 2
        near = np.flatnonzero(middle == np.frombuffer(line[x : x + _WORD].tobytes(), np.uint64))
        if not near.size or line.min() == line.max():  # the latter is drawn, as a crosshair
            continue
        if any(np.array_equal(old[index], line) for index in near[:REMEMBERED]):
            return True
    return False


class _Camera:
    """The last pictures of one camera, when the last one came first, and how often since."""

    def __init__(self) -> None:
        self._picture: U8 | None = None
        self._since: float | None = None
        self._repeats = 0
        self._again = False  # whether an old picture has come since
        self._known = np.zeros((0, 0, 0), np.uint64)  # a ring of hashes, the last one's at `_place`
        self._place = 0
        self._signs: deque[U64] = deque(maxlen=COMPARED)  # of the last pictures with noise
        self._lines: deque[tuple[U8, U8]] = deque(maxlen=COMPARED)  # of these, rows and columns
        self._compared = np.zeros((0, 0, 0, 0), np.uint64)  # the same, as one array
        self._alike: deque[float] = deque(maxlen=COMPARED)  # of new pictures to those before
        self._middles: tuple[U64, U64] | None = None
        self._new: _Look | None = None  # the last one's, until it is prepared for

    def fault(self, picture: U8, frame: Frame, limits: Limits) -> str:
        """What is wrong with the next picture, in words: empty if it is a new one."""
        self.prepare()
        look, last = _look(picture), self._picture
        if last is None or last.shape != picture.shape:
            self._known = np.zeros((REMEMBERED, *look.hashes.shape), np.uint64)
            for each in (self._signs, self._lines, self._alike):
                each.clear()
            self._middles = None
        # Hashes first: they differ in any two frames of a live camera.
        elif (self._known[self._place] == look.hashes).all() and np.array_equal(last, picture):
            return self._repeated(frame, limits)
        elif words := self._old(last, picture, look):
            self._again = True
            return words
        self._picture, self._since, self._repeats = picture, frame.arrived, 0
        self._again, self._new = False, look
        return ""

    def prepare(self) -> None:
        """Remember the last picture: what the next one need not wait for."""
        look, self._new = self._new, None
        if look is None or self._picture is None:
            return
        self._place = (self._place + 1) % REMEMBERED
        self._known[self._place] = look.hashes
        if min(self._picture.shape[:2]) >= 2 * _WORD:
            self._middles = _middles(_plane(self._picture))
        if look.noise > NOISY:
            self._signs.append(look.signs & _quiet(look.rows))
            self._lines.append(_lines(self._picture))
        none = np.zeros((0, *look.signs.shape), np.uint64)
        self._compared = np.stack(self._signs) if self._signs else none

    def _repeated(self, frame: Frame, limits: Limits) -> str:
        self._repeats += 1
        age_s = 0.0
        if frame.timed and frame.arrived is not None and self._since is not None:
            age_s = frame.arrived - self._since
        if self._again:
            return "gives an earlier picture again"
        if self._repeats <= limits.frozen_repeats and age_s <= limits.stale_s:
            return ""
        return f"repeats its last picture, {self._repeats} times"

    def _old(self, last: U8, picture: U8, look: _Look) -> str:
        """What an earlier picture has to do with one that does not repeat the last."""
        some = self._known == look.hashes
        if some.any():
            same = np.count_nonzero(some & (look.hashes != 0), axis=(1, 2))
            limit = (PART if look.noise > NOISY else MOSTLY_SAME) * look.hashes.size
            if same[self._place] > limit:
                return "repeats a part of its last picture"
            if same.max() > limit:
                return "gives an earlier picture again"
        middles = self._middles if look.noise > NOISY else None
        if middles is not None and _moved(_plane(last), middles, _plane(picture)):
            return "gives its last picture again, moved"
        like, least, place = _likeness(look.signs, self._compared)
        least = max(least, GROWS * max(self._alike, default=0.0))
        if like > least and not any(map(_drifts, self._lines[place], _lines(picture))):
            return "gives an earlier picture again with the same noise"
        self._alike.append(like)
        return ""


class StuckFrameDetector:
    """Remove the pictures that a camera has given before, so that no detector judges them."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._cameras = {"left": _Camera(), "right": _Camera()}

    def remove(self, frame: Frame) -> Frame:
        """The same frame, without a picture where a camera has frozen.

        Its pictures are kept until the next ones of the run come.
        """
        for side, camera in self._cameras.items():
            picture = getattr(frame, side)
            if picture is None or shape_fault(picture):
                continue
            if words := camera.fault(picture, frame, self._limits):
                fault = Fault(Reason.FROZEN, f"the {side} camera {words}: frozen")
                gone: dict[str, Any] = {side: None, f"{side}_fault": fault}
                frame = replace(frame, **gone)
        return frame

    def prepare(self) -> None:
        """Get ready for the next frame, once this one's verdict has been sent."""
        for camera in self._cameras.values():
            camera.prepare()
