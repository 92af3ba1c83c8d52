"""Moving pictures as a camera under water gives them; each carries its own number."""

from functools import cache

import cv2
import numpy as np

from tokt.features.common.arrays import U8

_BITS, _CHECK_BITS = 20, 4
NUMBERS = 1 << _BITS
"""So many numbers there are: nine hours at 30 frames a second."""

_DARK, _BRIGHT = 24, 232
_UNSURE = 60
"""A block whose mean is nearer than this to the middle grey is of no number: a damaged picture."""

_TALL = 16
"""Rows of the blocks at most: more that are all the same would be taken for a damaged picture."""

_MARGIN = 256

CELLS = 10
PLACES = (CELLS - 1) * CELLS
"""One cell of so many rows and columns is rough as nothing else: an obstacle that jumps about. It
tells the number modulo `PLACES`, the cells below the number's own."""
_STEP = 37


def _check(number: int) -> int:
    """Four bits that tell most wrong numbers from right ones."""
    return sum((number >> shift) * 7 for shift in range(0, _BITS, 3)) % (1 << _CHECK_BITS)


def _block(width: int) -> int:
    """A block's side; whole macroblocks where the picture is large."""
    side = width // (_BITS + _CHECK_BITS)
    return side // 16 * 16 if side >= 16 else side


@cache
def _sea(width: int, height: int) -> tuple[U8, U8, U8]:
    """Water that grows dark downwards, with particles and a bottom of stones, larger than shown."""
    rng = np.random.default_rng(5)
    tall, wide = height + _MARGIN, width + _MARGIN
    luma = np.linspace(120, 70, tall)[:, None] + np.zeros(wide)
    for side, strength in ((64, 40), (16, 25), (6, 14)):
        coarse = rng.normal(0, 1, (tall // side + 2, wide // side + 2)).astype(np.float32)
        fine = cv2.resize(coarse, (wide, tall), interpolation=cv2.INTER_CUBIC)
        bottom = np.clip((np.arange(tall) / tall - 0.35) * 3, 0.15, 1.0)[:, None]
        luma += strength * fine * bottom
    for x, y in rng.integers(0, (wide - 4, tall - 4), (wide * tall // 4000, 2)).tolist():
        luma[y : y + 2, x : x + 3] += 45
    luma = np.clip(luma, 16, 235).astype(np.uint8)
    half = (height // 2, width // 2)
    blue = np.full(half, 150, np.uint8)
    red = np.linspace(96, 118, half[0])[:, None].repeat(half[1], 1).astype(np.uint8)
    return luma, blue, red


@cache
def _rough(width: int, height: int) -> U8:
    """Noise that is still rough where the picture is made 360 pixels wide."""
    grain = max(1, width // 180)
    tall, wide = height // CELLS + 1, width // CELLS + 1
    noise = np.random.default_rng(6).integers(0, 2, (tall // grain + 1, wide // grain + 1))
    grains = np.where(noise, 160, 70).astype(np.uint8)
    return grains.repeat(grain, axis=0).repeat(grain, axis=1)[:tall, :wide]


def place_of(number: int) -> tuple[int, int]:
    """The row and the column of the rough cell."""
    row, col = divmod(number * _STEP % PLACES, CELLS)
    return row + 1, col


def number_at(row: int, col: int) -> int:
    """The number modulo `PLACES` of a picture whose rough cell is there."""
    return ((row - 1) * CELLS + col) * pow(_STEP, -1, PLACES) % PLACES


def i420(number: int, size: tuple[int, int] = (320, 240)) -> U8:
    """Picture `number` of an endless film, the same each time.

    Parameters
    ----------
    number : int
        Below `NUMBERS`.
    size : (width, height)
        Even numbers, at least 96 wide.

    Returns
    -------
    array of uint8, shape (height * 3 / 2, width)
        Planar YUV 4:2:0, which encoders take as it is.
    """
    width, height = size
    luma, blue, red = _sea(width, height)
    left = abs(number * 3 % (2 * _MARGIN) - _MARGIN)
    top = abs(number % (2 * _MARGIN) - _MARGIN)
    picture = np.empty((height * 3 // 2, width), np.uint8)
    picture[:height] = luma[top : top + height, left : left + width]
    row, col = place_of(number)
    rows = slice(row * height // CELLS, (row + 1) * height // CELLS)
    cols = slice(col * width // CELLS, (col + 1) * width // CELLS)
    part = picture[rows, cols]
    part[:] = _rough(width, height)[: part.shape[0], : part.shape[1]]
    picture[height:] = np.concatenate([blue.ravel(), red.ravel()]).reshape(-1, width)
    block = _block(width)
    bits = number << _CHECK_BITS | _check(number)
    for place in range(_BITS + _CHECK_BITS):
        value = _BRIGHT if bits >> place & 1 else _DARK
        picture[: min(block, _TALL), place * block : (place + 1) * block] = value
    return picture


def bgr(number: int, size: tuple[int, int] = (320, 240)) -> U8:
    """The same in colour, shape (height, width, 3)."""
    return np.asarray(cv2.cvtColor(i420(number, size), cv2.COLOR_YUV2BGR_I420), np.uint8)


def number_of(picture: U8) -> int | None:
    """The number that a picture carries; None where its blocks are damaged.

    Parameters
    ----------
    picture : array of uint8
        In colour, gray, or I420 (of which the first rows are gray too).
    """
    block = _block(picture.shape[1])
    places = _BITS + _CHECK_BITS
    edge = max(1, block // 4)
    tall = min(block, _TALL)
    row = picture[tall // 4 : tall - tall // 4, : places * block]
    row = row.mean(axis=2) if row.ndim == 3 else row
    cells = row.reshape(len(row), places, block)[:, :, edge : block - edge]
    means = cells.mean(axis=(0, 2)) - 128.0
    if np.abs(means).min() < _UNSURE:
        return None
    bits = sum(int(mean > 0) << place for place, mean in enumerate(means))
    number = bits >> _CHECK_BITS
    return number if _check(number) == bits & ((1 << _CHECK_BITS) - 1) else None


def jpeg(number: int, size: tuple[int, int] = (320, 240), restarts: int = 0) -> bytes:
    """The picture of a number as a JPEG, with so many blocks between its restart marks."""
    flags = [cv2.IMWRITE_JPEG_QUALITY, 80, cv2.IMWRITE_JPEG_RST_INTERVAL, restarts]
    return cv2.imencode(".jpg", bgr(number, size), flags)[1].tobytes()
