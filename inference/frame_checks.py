"""Checks that a frame can be judged: not black, blank, saturated, noise, damaged, or held back.

Most is seen on one gray picture, `PATCH_GRID`'s: the frame resized to width 360, or the frame as
it is when it is narrower, as interpolation makes no new noise. Darkness and saturation are looked
for among single pixels of the frame as well: in the picture, which averages over many, a few hot
pixels of a black frame are many dim ones, and noise takes a saturated frame below saturation.
"""

import math
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import U8
from tokt.features.extractors.extractor import gray_picture
from tokt.features.frames.grid import Grid

from .clock import Clock
from .config import Limits
from .frame import MANY_MISSED, Frame
from .reason import NO_FAULT, Fault, Reason

# The measured values below are of the gray pictures of the 492 frames, 246 of each camera, of the
# sea trial of 20 April 2016: one dive. A resized picture has less noise than its frame: these
# are not the figures of frames.

DARK_GREY = 8
DARK_FRACTION = 0.999
"""Grey level. A frame of which this fraction of the pixels stays below is too dark: a covered lens
or a lamp that is out. Measured: the level that 99.9 % stay at or below is 28 and more in the
picture, 28 and more among single pixels."""

BLANK_GREY = 1.0
"""Grey levels, standard deviation. A frame below shows nothing. Measured: 6.0 and more, from the
fall of the light towards the edges alone."""

NOISE_FACTOR = 2.0
"""Light falls off over any real scene, open water too, while noise is alike everywhere: a covered
lens under automatic gain, snow. A frame shows no picture where its patches' mean grey levels have a
standard deviation below `BLANK_GREY`, or below this multiple of what noise alone gives them.
Measured: 5.9 grey levels and 26 times and more; on five dives of another site 5.2 and 25 times and
more. Noise of 4 to 40 grey levels, sharp or blurred: 0.6 levels or 1.3 times at most."""

SATURATED_GREY = 250
SATURATED_FRACTION = 0.5
"""A frame with this fraction of its pixels at `SATURATED_GREY` or above is saturated. Measured:
0.020 at most, close to the tower, in the picture; 0.021 among single pixels."""

BLANK_PATCHES = 0.03
"""A frame with this fraction of its patches blank is damaged or covered. A patch is blank when all
its pixels have one grey level: a camera's picture has noise, while the missing end of a JPEG and
zeroed data decode to one level. Measured: no patch is blank; the least standard deviation of one
is 0.31 grey levels, the least difference between its brightest and its darkest pixel 2. A patch
that is one level of `SATURATED_GREY` or more does not count: a close, bright thing gives that."""

BAND_ROWS = 12
_BAND_PARTS = 3
"""So many rows of the picture one below the other that are equal over a third of the width are a
band that the camera never gave: a lost packet, filled with one colour or with the row above.
Measured: no two such rows are equal, on both sites. JPEG's blocks are 8 rows high."""

PATCH_GRID = Grid(10, 10, 360)
"""The patches of `BLANK_PATCHES`: those it was measured on, whatever grid a model has, as in
much smaller ones (40x40 at width 360) a real frame does have some blank."""

WIDTH_TOLERANCE = 0.15
"""Of the picture's width: a frame reduced by a whole number will do, which is a tenth of the work.
Measured on the frames reduced by 4: as above but for 24.7 times, and in a patch a standard
deviation of 0.27 grey levels and a difference of 1."""

_STEP_ROWS = 32
_MIN_PATCH_PX = 8
"""Height and width in pixels of a patch below which one grey level in it proves nothing."""
_MIN_NOISE_PX = 3
"""The same of its mean: the least of a grid. At 64x48, 40x30 and 32x32 the frames of both sites
have 2.4 times what noise gives, and more; noise 1.2 times at most."""


def shape_fault(frame: U8) -> Fault:
    """Why an array is no picture, uint8 (height, width) or (height, width, 3); or nothing."""
    picture = frame.ndim == 2 or (frame.ndim == 3 and frame.shape[2] == 3)
    if frame.dtype != np.uint8 or not picture or 0 in frame.shape:
        words = f"the frame is {frame.dtype} of shape {frame.shape}, not an 8-bit picture"
        return Fault(Reason.WRONG_SIZE, words)
    return NO_FAULT


def pair_shape_fault(frame: Frame, frame_size: tuple[int, int]) -> Fault:
    """Why a pair cannot be matched: a picture is missing, or not of the calibration's size.

    Empty where it can. The size is width, height in pixels.
    """
    if frame.left is None:
        return frame.left_fault or Fault(Reason.MISSING, "there is no left frame")
    if frame.right is None:
        return frame.right_fault or Fault(Reason.MISSING, "there is no right frame")
    for side, picture in (("left", frame.left), ("right", frame.right)):
        fault = shape_fault(picture)
        if fault:
            return fault.about(side)
        height, width = picture.shape[:2]
        if (width, height) != frame_size:
            expected = "x".join(map(str, frame_size))
            words = f"the {side} frame is {width}x{height}, the calibration is for {expected}"
            return Fault(Reason.WRONG_SIZE, words)
    return NO_FAULT


def frame_fault(frame: U8, gray: U8 | None = None, grid: Grid | None = None) -> Fault:
    """Why a frame, as the camera gave it, is outside what can be judged, or an empty string.

    `gray` is ``gray_picture(frame, grid)``, where the caller has it already: what is looked at when
    it is about as wide (`WIDTH_TOLERANCE`) as `PATCH_GRID` wants it.
    """
    fault = shape_fault(frame)
    if fault:
        return fault
    narrow = PATCH_GRID.width is not None and frame.shape[1] < PATCH_GRID.width
    own_grid = replace(PATCH_GRID, width=None) if narrow else PATCH_GRID
    wanted, given = own_grid.width or 0, 0 if grid is None else grid.width or 0
    if gray is None or abs(given - wanted) > WIDTH_TOLERANCE * wanted:
        try:
            gray = gray_picture(frame, own_grid)
        except ValueError as error:
            return Fault(Reason.WRONG_SIZE, f"the frame cannot be looked at: {error}")
    pixels = np.ascontiguousarray(frame[::_STEP_ROWS])  # as many as a fraction needs
    if pixels.ndim == 3:
        pixels = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), np.uint8)
    fault = _whole_frame_fault(gray, pixels)
    least = min(gray.shape[0] // own_grid.rows, gray.shape[1] // own_grid.cols)
    if least >= _MIN_PATCH_PX:
        fault = fault or _blank_patches_fault(gray, own_grid)
    if least >= _MIN_NOISE_PX:
        fault = fault or _no_structure_fault(gray, own_grid)
    return fault or _band_fault(gray)


def one_channel(picture: U8) -> U8:
    """A gray picture itself, of a BGR one the green channel: shape (height, width), in C order."""
    if picture.ndim == 2 or not picture.size:
        return np.ascontiguousarray(picture if picture.ndim == 2 else picture[:, :, 1])
    return np.asarray(cv2.extractChannel(picture, 1), np.uint8)


def _whole_frame_fault(gray: U8, pixels: U8) -> Fault:
    """Whether a picture, or the single pixels of its frame, are dark, blank or saturated."""
    for seen in (gray, pixels):
        if np.count_nonzero(seen >= DARK_GREY) <= (1 - DARK_FRACTION) * seen.size:
            return Fault(Reason.DARK, "the frame is too dark to judge")
    if cv2.meanStdDev(gray)[1].item() < BLANK_GREY:
        return Fault(Reason.BLANK, "the frame is blank")
    for seen in (gray, pixels):
        if np.count_nonzero(seen >= SATURATED_GREY) >= SATURATED_FRACTION * seen.size:
            return Fault(Reason.SATURATED, "the frame is saturated")
    return NO_FAULT


def _by_patch(reduce: np.ufunc, gray: U8, grid: Grid, dtype: type = np.uint8) -> NDArray[Any]:
    """One value of each patch's grey levels; down first, whole rows at a time."""
    height, width = grid.patch_size(*gray.shape)
    covered = gray[: grid.rows * height, : grid.cols * width]
    down = reduce.reduce(covered.reshape(grid.rows, height, -1), axis=1, dtype=dtype)
    across = down.reshape(grid.rows, grid.cols, width)
    return np.asarray(reduce.reduce(across, axis=2, dtype=dtype))


def _blank_patches_fault(gray: U8, grid: Grid) -> Fault:
    """Why a picture is damaged or covered, or an empty string."""
    darkest, brightest = _by_patch(np.minimum, gray, grid), _by_patch(np.maximum, gray, grid)
    blank = int(np.sum((darkest == brightest) & (brightest < SATURATED_GREY)))
    if blank < BLANK_PATCHES * grid.n_patches:
        return NO_FAULT
    words = f"{blank} of {grid.n_patches} patches are blank: the picture is damaged or covered"
    return Fault(Reason.DAMAGED, words)


def _band_fault(gray: U8) -> Fault:
    """Why a picture has a band that no camera gave, or an empty string."""
    height, width = gray.shape[0], gray.shape[1] // _BAND_PARTS * _BAND_PARTS
    if width == 0:
        return NO_FAULT
    parts = gray[:, :width].reshape(height, _BAND_PARTS, -1)
    below, above = parts[1:], parts[:-1]
    some = np.s_[BAND_ROWS - 2 :: BAND_ROWS - 1]  # one pair of each band at least
    if not (below[some] == above[some]).all(axis=2).any():
        return NO_FAULT
    equal = (below == above).all(axis=2) & (below[:, :, 0] < SATURATED_GREY)
    # How many rows before each row are equal to it and to one another.
    row = np.arange(1, height)[:, None]
    longest = int((row - np.maximum.accumulate(np.where(equal, 0, row))).max(initial=0))
    if longest < BAND_ROWS - 1:
        return NO_FAULT
    words = f"{longest + 1} rows of the picture are one and the same: a part of it was lost"
    return Fault(Reason.DAMAGED, words)


def _no_structure_fault(gray: U8, grid: Grid) -> Fault:
    """Why a picture is noise alone, or an empty string."""
    height, width = grid.patch_size(*gray.shape)
    covered, patch_px = gray[: grid.rows * height, : grid.cols * width], height * width
    between = cv2.meanStdDev(
        cv2.resize(covered, (grid.cols, grid.rows), interpolation=cv2.INTER_AREA)
    )[1].item()
    whole = cv2.meanStdDev(gray)[1].item()
    if between >= max(BLANK_GREY, NOISE_FACTOR * whole / math.sqrt(patch_px)):
        return NO_FAULT
    return Fault(Reason.BLANK, "the frame shows noise and no picture: covered, or no signal")


_DETAIL_ROWS = 48  # rows of a frame that its fine detail is looked for in, or a few more
_MIN_TILE_PX = 4


def fine_detail(frame: U8) -> float:
    """How much of a picture's detail is as fine as its pixels.

    The mean difference of neighbouring pixels over that of pixels two apart, in rows or in columns,
    whichever is less, of the patch a quarter of the patches exceed: close things fill some patches,
    noise of the sensor all. The frame is as the camera gave it.

    0.5 where nothing changes from one pixel to the next alone (blurred, enlarged, compressed), 1
    for noise. Measured: 0.58 to 0.66 on the sea trial, 0.61 and more on the other site; blurred by
    8 pixels or enlarged to twice the size, saved at JPEG quality 95 or not, at most 0.55 and 0.59.
    1 also of frames too small to tell. What the sensor adds to a blurred picture is as fine as its
    pixels: a lens out of focus is not seen by this.
    """
    last = len(frame) - 2
    step = max(last // _DETAIL_ROWS, 1)
    rows, next_rows, third_rows = (
        one_channel(frame[first : last + first : step]) for first in range(3)
    )
    if min(rows.shape[0] // PATCH_GRID.rows, rows.shape[1] // PATCH_GRID.cols) < _MIN_TILE_PX:
        return 1.0
    pixels = rows[:, :-2]
    across = _detail(pixels, rows[:, 1:-1], rows[:, 2:])
    return min(across, _detail(rows, next_rows, third_rows))


def _detail(pixels: U8, neighbours: U8, second: U8) -> float:
    near, far = (
        _by_patch(np.add, np.asarray(cv2.absdiff(pixels, other), np.uint8), PATCH_GRID, np.uint32)
        for other in (neighbours, second)
    )
    return float(np.sort(near / np.maximum(far, 1), axis=None)[-1 - PATCH_GRID.n_patches // 4])


_SUSPENDED_S = 0.05


class SuspendDetector:
    """Remove the pictures of frames that may be older than they look: after a suspend.

    What was in a camera's or its driver's buffers when the computer was suspended is handed over
    afterwards as if it were new. From the first frame on that comes then, nothing is believed for
    as long as a frame may be old.
    """

    def __init__(self, clock: Clock, limits: Limits) -> None:
        self._clock = clock
        self._limits = limits
        self._suspended_s = clock.suspended()
        self._believed_from = -math.inf

    def remove(self, frame: Frame) -> Frame:
        """The same frame; without its pictures, and none before it known, where it is in doubt."""
        suspended_s = self._clock.suspended()
        if suspended_s - self._suspended_s > _SUSPENDED_S:
            self._suspended_s = suspended_s
            self._believed_from = self._clock.monotonic() + self._limits.stale_s
        if frame.arrived is None or frame.arrived >= self._believed_from:
            return frame
        fault = Fault(Reason.STALE, "stale: the computer was suspended just before this frame")
        doubtful: dict[str, Any] = {"missed": MANY_MISSED}
        for side in ("left", "right"):
            if getattr(frame, side) is not None:
                doubtful |= {side: None, f"{side}_fault": fault}
        return replace(frame, **doubtful)
