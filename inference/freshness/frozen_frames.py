"""Pictures that are no new ones: repeated, coming round again, or an old one with small changes.

A camera's noise makes each of its pictures another, down to parts of a row. Pictures are known
again by that. Of the last `REMEMBERED` pictures of a camera are kept the hash of each piece of some
rows, and the signs of the finest differences in fewer of them; of the last new picture and the last
copy of it also the noise in a few tiles, which is found again where the picture has moved
(`tokt.inference.freshness.noise_match`).

A camera or an encoder may filter noise in time. New pictures are then alike too, and a picture is
an old one where it is much more like those before than they were (`GROWS`).

What cannot be told from a new picture:

- Buffers that go round, and loops, of more than `REMEMBERED` pictures.
- Of a ring, compressed anew, a picture at times where they are 360 wide: 4 of 750 drawn ones, none
  of 750 at 640x480.
- A picture that moves too, in a ring of several; one that is zoomed by more than 1 % from each
  picture to the next; one with noise put on top that has moved by more than half a tile.
- One with noise of more than 4 grey levels put on top, or compressed below quality 70 (85 in
  pictures 360 wide, 90 where it moves too) each time; part of a picture compressed otherwise each
  time, at times; one that lost its noise and was given other noise.
- An old picture in a stream whose compression leaves no noise (`NOISY`), where no more than
  `MOSTLY_SAME` of it stays as it was. JPEG of quality 75 leaves none where the noise is below 1.5
  grey levels.
- One that froze before the run began and changes all over: no picture without its noise is known.
- One that changes all over, of a camera whose filter leaves half of the noise and more in the next
  picture.
- One that changes all over, before what is textured all over, or has texture as fine as noise in
  it that has just moved: new pictures of that are alike too.
- One that moves or changes all over, in pictures smaller than 310x230, or where fewer than eight of
  twelve tiles show water.
- Less than `PART` of a picture.

A label written into each picture, which covers `PART` of it, looks like a part that is frozen.
Texture as fine as noise that is in a third of the view all at once, and has not been seen to move,
is taken for a frozen picture.
"""

import hashlib
import math
from collections import deque
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np

from tokt.features.common.arrays import U8, U64
from tokt.features.kernels.dispatch import KERNELS
from tokt.inference.config import Limits
from tokt.inference.frame import Frame, shape_fault
from tokt.inference.reason import Fault, Reason

from .noise_match import FAR_PX, LAG_PX, LARGEST, QUIET, TILE_PX, Common, Noise, in_common, noise_of

# Measured on the 490 pairs of successive frames of the sea trial of 20 April 2016, 245 of each
# camera, and on still water drawn with noise of 0.5 to 3 grey levels ("drawn").

REMEMBERED = 320
"""Pictures of each camera that must not come again, 10 s of 30 a second. Of each one 1.3 kB of
hashes and 2.7 kB of signs are kept, for 1360x1024."""

PART = 0.05
"""Part of a picture that is the same to the last bit as in an earlier one: a frozen part, as noise
forbids that. Measured: no piece of a row in 490 pairs, nor in 245 frames before; drawn, 360 pixels
wide and more, where there is noise (`NOISY`): none."""

MOSTLY_SAME = 0.35
"""The same where a picture has no noise. Drawn, after JPEG of quality 75: at most 0.06 of
1360x1024, 0.09 of 360x271; a sensor of less noise still, or a picture of 180x135, may come to it.
"""

NOISY = 0.1
"""Part of the finest differences that are not zero, above which a picture has noise. Measured: 0.3
and more."""

SAME_NOISE = 0.16
"""By how much more often signs agree with those of one of the last pictures than with the lower
quarter of the others, from -1 to 1. Measured: at most 0.13; one frozen picture, compressed again at
quality 75 to 95, 0.42 and more; with noise of 1 grey level put on top 0.59, of 2 0.29."""
_SIGMAS, _FEWEST_SIGNS = 5.0, 50

_ROWS = 32
_SIGN_STEP = 4  # signs of every fourth of them are remembered
_PIECE_PX = 240
"""At least, unless the picture is narrower: compressed, a shorter one comes again by chance."""
_WORD = 8
_FEWEST_WORDS = 2  # in a row, so that a flat piece is seen
_BLOCK = 8
"""A JPEG block's width in pixels. Steps between blocks come from the picture, not from noise."""

QUIET_PART = 0.25
"""Signs are compared where so much of the picture is `QUIET`. A sea floor that goes by slowly was
frozen by its own texture before: 17 of 24 frames of a drawn reef. Measured: 0.30 of the picture and
more, close to the tower; of that reef 0.1."""

GROWS = 2.0
"""A picture is an old one that is so many times as much like those before as any of the last new
ones was. Noise filtered in time, with gains of 0.3 to 0.85, varies by 1.8 times at most."""
STAYS = 0.8
"""The multiple of `SAME_NOISE` or `CHANCE` above which a picture is still an old one after another
one. Measured on new pictures: 0.83 and 0.72 at most."""
_BEFORE = 8  # pictures whose likeness is known
_FEWEST_KNOWN = 2  # of them that have to be
_FEWEST_OTHERS = 5  # pictures, of which the lower quarter tells what is by chance

_NONE, _ALL = np.uint64(0), np.uint64(2**64 - 1)  # of a tile's pixels
_INSIDE = np.full(8, 2 ** (_BLOCK - LAG_PX) - 1, np.uint8).view(np.uint64)
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
    words = width // _WORD // pieces
    # Chance enough, and without the 5 MB that `numpy.random` loads.
    drawn = hashlib.shake_128(b"weights").digest(8 * pieces * words)
    weights = np.frombuffer(drawn, "<u8").astype(np.uint64).reshape(pieces, words)
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
    hashes, signs = KERNELS.row_marks(rows, _weights(rows.shape[1]), LAG_PX, LARGEST)
    signs &= _INSIDE
    inside = signs[0].size * TILE_PX * (_BLOCK - LAG_PX) / _BLOCK
    return _Look(rows, hashes, signs, int(np.bitwise_count(signs).sum()) / max(inside, 1))


def _quiet(rows: U8) -> U64:
    """Where rows show noise alone: they change no more over some pixels than over `LAG_PX`."""
    wide = max(rows.shape[1] - LAG_PX, 0) // TILE_PX * TILE_PX  # of whole tiles
    earlier, later = rows[:, :wide], rows[:, LAG_PX : wide + LAG_PX]
    if not earlier.size:
        return np.zeros((len(rows), 0), np.uint64)
    far = np.zeros(earlier.shape, np.uint8)
    far[:, FAR_PX:] = cv2.absdiff(earlier[:, FAR_PX:], earlier[:, :-FAR_PX])
    near, over = (
        cv2.reduce(each.reshape(-1, TILE_PX), 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S)
        for each in (cv2.absdiff(earlier, later), far)
    )
    tiles = over <= QUIET * near
    if np.count_nonzero(tiles) < QUIET_PART * len(tiles):
        tiles[:] = False
    return np.where(tiles, _ALL, _NONE).reshape(len(rows), -1)


def _fewer(signs: U64) -> U64:
    """Those of some rows, as many as are remembered."""
    return np.ascontiguousarray(signs[:, ::_SIGN_STEP])


def _sign_likeness(one: U64, others: U64) -> float | None:
    """How much more a picture's signs agree with those of one of the others than by chance.

    As a multiple of `SAME_NOISE`, or of what chance may do at most where that is more. None where
    most of the others show too much else, so that what is by chance is not known.
    """
    alike, opposite = KERNELS.sign_counts(one, others).T
    counted = alike + opposite
    enough = counted >= _FEWEST_SIGNS
    if np.count_nonzero(enough) < max(2, min(len(others) // 2 + 1, _FEWEST_OTHERS)):
        return None
    agreement = (alike - opposite)[enough] / counted[enough]
    order = np.argsort(agreement)
    # A low one of the rest: where a copy was not known, it and its picture agree as well.
    best, low = order[-1], order[(len(order) - 2) // 4]
    error = math.sqrt((1 / counted[enough][[best, low]]).sum())
    return float(agreement[best] - agreement[low]) / max(SAME_NOISE, _SIGMAS * error)


class _Likeness:
    """How much pictures are like those before, as a multiple of what new ones are at most.

    A camera that filters noise in time puts some of each picture's into the next one. What is usual
    is learnt from pictures that are new.
    """

    def __init__(self) -> None:
        self._of_new: deque[float | None] = deque(maxlen=_BEFORE)

    def is_of_old(self, like: float | None, again: bool) -> bool:
        """Whether a picture is an old one; with `again`, where the one before it was."""
        known = [each for each in self._of_new if each is not None]
        if like is None or len(known) < _FEWEST_KNOWN:
            return False
        usual = max(known)
        return like > (max(STAYS, usual) if again else max(1.0, GROWS * usual))

    def add(self, like: float | None) -> None:
        """Learn from a new picture."""
        self._of_new.append(like)


class _Camera:
    """The last pictures of one camera, when the last new one came, and how often since."""

    def __init__(self) -> None:
        self._picture: U8 | None = None
        self._since: float | None = None
        self._repeats = 0
        self._again = False  # whether an old picture has come since
        self._known = np.zeros((0, 0, 0), np.uint64)  # a ring of hashes, the last one's at `_place`
        self._place = 0
        self._signs = np.zeros((0, 0, 0, 0), np.uint64)  # a ring of those with noise
        self._noisy = 0  # pictures that it was given
        self._noise: Noise | None = None  # of the last new picture
        self._shown: Noise | None = None  # of the last one
        # Whether new pictures had something in common that had moved: texture as fine as noise.
        self._textured: deque[bool] = deque(maxlen=_BEFORE)
        self._likeness = _Likeness(), _Likeness()  # of signs, and of noise
        self._new: _Look | None = None  # the last new one's, until it is prepared for

    def fault(self, picture: U8, frame: Frame, limits: Limits) -> str:
        """What is wrong with the next picture, in words: empty if it is a new one."""
        self.prepare()
        look, last = _look(picture), self._picture
        if last is None or last.shape != picture.shape:
            self._known = np.zeros((REMEMBERED, *look.hashes.shape), np.uint64)
            shape = REMEMBERED, *_fewer(look.signs).shape
            self._signs, self._noisy = np.zeros(shape, np.uint64), 0
            self._likeness = _Likeness(), _Likeness()  # of signs, and of noise
            self._noise = None
            self._textured.clear()
        # Hashes first: they differ in any two frames of a live camera.
        elif (self._known[self._place] == look.hashes).all() and np.array_equal(last, picture):
            return self._repeated(frame, limits)
        plane = picture if picture.ndim == 2 else picture[:, :, 1]
        noise = noise_of(plane, self._noise)
        if last is not None and (words := self._old(look, noise)):
            self._again, self._shown = True, noise
            return words
        self._picture, self._since, self._repeats = picture, frame.arrived, 0
        self._again, self._new = False, look
        self._noise = self._shown = noise
        return ""

    def prepare(self) -> None:
        """Remember the last picture: what the next one need not wait for."""
        look, self._new = self._new, None
        if look is None:
            return
        self._place = (self._place + 1) % REMEMBERED
        self._known[self._place] = look.hashes
        if look.noise > NOISY:
            self._signs[self._noisy % REMEMBERED] = _fewer(look.signs & _quiet(look.rows))
            self._noisy += 1

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

    def _old(self, look: _Look, noise: Noise | None) -> str:
        """What an earlier picture has to do with one that does not repeat the last."""
        some = self._known == look.hashes
        if some.any():
            same = np.count_nonzero(some & (look.hashes != 0), axis=(1, 2))
            limit = (PART if look.noise > NOISY else MOSTLY_SAME) * look.hashes.size
            if same[self._place] > limit:
                return "repeats a part of its last picture"
            if same.max() > limit:
                return "gives an earlier picture again"
        common = self._common(noise)
        likes = (
            _sign_likeness(_fewer(look.signs), self._signs[: self._noisy]),
            None if common is None else common.like,
        )
        alike = any(
            before.is_of_old(like, self._again)
            for before, like in zip(self._likeness, likes, strict=True)
        )
        if alike and not any(self._textured):
            return "gives an earlier picture again with the same noise"
        self._likeness[0].add(likes[0])
        self._likeness[1].add(None if common is None else common.somewhere)
        self._textured.append(common is not None and common.moved)
        return ""

    def _common(self, noise: Noise | None) -> Common | None:
        """What a picture has in common with the last new one, or with the last copy of it."""
        common = in_common(self._noise, noise)
        if common is None or not self._again:
            return common
        return max(common, in_common(self._shown, noise) or common)


class StuckFrameDetector:
    """Remove the pictures that a camera has given before, so that no detector judges them."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._cameras = {"left": _Camera(), "right": _Camera()}

    def remove(self, frame: Frame) -> Frame:
        """The same frame, without a picture where a camera has frozen.

        Its pictures are kept until the next ones of the run come. What is masked tells nothing: a
        label that covers much of the view stays the same, and a clock runs on over a frozen one.
        """
        covered = frame.covered
        for side, camera in self._cameras.items():
            picture = getattr(covered, side)
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
