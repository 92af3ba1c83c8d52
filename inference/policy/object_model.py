"""The look of one named object: learnt from a box in one picture, found again in others.

Two things have to be right: the texture of its cells (LBP and Haralick's features), which sets it
apart from the rest of its picture, and its fine detail, which no other of its make has. Both are
learnt from the one picture in which a person drew the box, in some milliseconds, and are never
changed: a model that follows what it last saw drifts off the object, a bit a frame.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from tokt.features.common.arrays import F32, F64, U8
from tokt.features.common.errors import ToktError
from tokt.features.extractors.frame_pictures import SharedPictures
from tokt.features.extractors.textures import LOG, NEAREST, Glcm, Join, Lbp
from tokt.features.frames.grid import Grid
from tokt.features.kernels.quantization import FRAME, Quantization

WIDTH, CELL, MIN_SIDE = 360, 12, 24
"""In pixels: the width that pictures are resized to, the side of a cell, and a box's shortest."""
MAX_SHARE = 0.8
"""Of the picture that a box may cover: it is told from the rest."""
SIZE_STEP, SIZES = 0.05, range(-10, 11)
"""Sizes that are looked for: steps of ln of the size over that in the box."""
_DETAIL = Quantization(gain=8, smooth=5, window=21, by=FRAME)
MIDDLE = _DETAIL.levels // 2
_EXTRACTOR = Join([Lbp(8, 5, "frame", None, NEAREST), Glcm(False, None, LOG)])

Box = tuple[float, float, float, float]
"""x, y, width and height in shares of the picture's sides."""


class ObjectPlace(NamedTuple):
    """Where the object may be, in pixels of a picture `WIDTH` wide."""

    x: float  # its centre, from the left edge
    y: float  # from the upper edge
    size: float  # ln of its size over that in the box
    match: float  # correlation of the fine detail there, -1 to 1


def detail_picture(picture: U8, shared: SharedPictures | None = None) -> U8:
    """What all is learnt and found by, `WIDTH` wide; ToktError if its shape is no camera's.

    `shared` are the pictures of its frame that were made already.
    """
    height, width = picture.shape[:2]
    if not 0.1 < height / width < 10:
        raise ToktError(f"no picture of a camera is {width}x{height}")
    if width < WIDTH:
        picture = np.asarray(cv2.resize(picture, (WIDTH, round(height * WIDTH / width))), np.uint8)
    return (shared or SharedPictures()).of(picture, Grid(1, 1, WIDTH)).picture(_DETAIL)


def inside(box: Box, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """The rows and columns of a picture, or a grid, of that shape that a box takes."""
    x, y, wide, high = box
    ends = ((y, y + high, shape[0]), (x, x + wide, shape[1]))
    rows, cols = (slice(*(max(round(end * n), 0) for end in (a, b))) for a, b, n in ends)
    return rows, cols


class ObjectModel:
    """The model of what a person drew a box around, in a picture's fine detail.

    Raises ToktError if the box is no part of the picture, too small or large, or blank.
    """

    def __init__(self, detail: U8, box: Box) -> None:
        x, y, wide, high = box
        self._height = height = len(detail)
        if fault := _box_fault(box, detail):
            raise ToktError(f"the box cannot be held: {fault}")
        self._wide, self._high, self.share = wide * WIDTH, high * height, wide * high
        self.place = ObjectPlace((x + wide / 2) * WIDTH, (y + high / 2) * height, 0.0, 1.0)
        own, cells = detail[inside(box, detail.shape)], _cells(detail)
        self._own = {
            step: np.asarray(cv2.resize(own, None, fx=times, fy=times), np.uint8)
            for step, times in zip(SIZES, np.exp(SIZE_STEP * np.array(SIZES)), strict=True)
        }
        self._halves = {step: _halved(self._own[step]) for step in SIZES[::2]}
        rest = np.ones(cells.shape[:2], bool)
        rest[inside(box, rest.shape)] = False
        self._mean, self._spread = cells[rest].mean(axis=0), cells[rest].std(axis=0) + 1e-3
        self._texture = self._apart(own)

    def fits(self, picture: U8) -> bool:
        """Whether a picture has the shape of the one that this was learnt from."""
        height, width = picture.shape[:2]
        return bool(abs(height / width * WIDTH / self._height - 1) < 0.02)

    def size_of(self, share: float) -> float:
        """The size at which it covers that share of the picture."""
        return 0.5 * math.log(share / self.share)

    def box_at(self, place: ObjectPlace) -> Box:
        """The box around the object at a place."""
        wide, high = (math.exp(place.size) * side for side in (self._wide, self._high))
        x, y = place.x - wide / 2, place.y - high / 2
        return x / WIDTH, y / self._height, wide / WIDTH, high / self._height

    def texture(self, detail: U8, place: ObjectPlace) -> float:
        """How like the object's the texture at a place is, -1 to 1."""
        times, (high, wide) = math.exp(place.size), self._own[0].shape
        x, y = place.x - times * wide / 2, place.y - times * high / 2
        there, how = np.array([[times, 0, x], [0, times, y]]), cv2.WARP_INVERSE_MAP
        seen = cv2.warpAffine(detail, there, (wide, high), flags=how, borderValue=MIDDLE)
        apart = self._apart(np.asarray(seen, np.uint8))
        lengths = np.linalg.norm(apart) * np.linalg.norm(self._texture)
        return float(apart @ self._texture / max(float(lengths), 1e-9))

    def find(self, detail: U8, about: ObjectPlace, px: float, size: float) -> ObjectPlace:
        """Where the fine detail matches best, at most `px` and `size` from a place."""
        best, matches, step = about._replace(match=-1.0), dict[int, float](), 0
        for each in SIZES:
            if abs(SIZE_STEP * each - about.size) > size:
                continue
            found, left, top = _matches(detail, self._own[each], (about.x, about.y), px)
            _, matches[each], _, (x, y) = cv2.minMaxLoc(found)
            if matches[each] > best.match:
                step, match = each, matches[each]
                best = ObjectPlace(left + x, top + y, SIZE_STEP * each, match)
        before, after = matches.get(step - 1), matches.get(step + 1)
        if before is not None and after is not None and before + after < 2 * best.match:
            # Where a parabola through the three has its top.
            more = (before - after) / (2 * (before - 2 * best.match + after))
            best = best._replace(size=best.size + SIZE_STEP * more)
        return best

    def search(
        self, detail: U8, about: ObjectPlace, px: float, size: float, but: ObjectPlace | None = None
    ) -> ObjectPlace:
        """The same, of a wide reach: in half the pixels first. `but` is what it must not be."""
        half, best = _halved(detail), about._replace(match=-1.0)
        for each, own in self._halves.items():
            if abs(SIZE_STEP * each - about.size) > size:
                continue
            found, left, top = _matches(half, own, (about.x / 2, about.y / 2), px / 2)
            if but is not None:
                (high, wide), x, y = own.shape, but.x / 2 - left, but.y / 2 - top
                first = round(x - wide / 2), round(y - high / 2)
                last = round(x + wide / 2) - 1, round(y + high / 2) - 1
                cv2.rectangle(found, first, last, -1.0, cv2.FILLED)
            _, match, _, (x, y) = cv2.minMaxLoc(found)
            if match > best.match:
                best = ObjectPlace(2 * (left + x), 2 * (top + y), SIZE_STEP * each, match)
        return self.find(detail, best, 3.0, 1.5 * SIZE_STEP)

    def _apart(self, detail: U8) -> F64:
        """What sets the cells of a picture of the object apart, in the spread of the rest's."""
        return np.asarray((_cells(detail) - self._mean) / self._spread).ravel()


def _box_fault(box: Box, detail: U8) -> str:
    """Why a box is none that can be held; or nothing."""
    x, y, wide, high = box
    if not (min(box) >= 0 and x + wide <= 1 and y + high <= 1):
        return "it is not inside the picture"
    if min(wide * WIDTH, high * len(detail)) < MIN_SIDE:
        return f"a side is less than 1/{WIDTH // MIN_SIDE} of the picture's width"
    if wide * high > MAX_SHARE:
        return f"it covers more than {100 * MAX_SHARE:.0f} % of the picture"
    if detail[inside(box, detail.shape)].std() < 1:
        return "there is nothing in it"
    return ""


def _halved(picture: U8) -> U8:
    return np.asarray(
        cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8
    )


def _matches(
    detail: U8, own: U8, about: tuple[float, float], px: float
) -> tuple[F32, float, float]:
    """How well an object matches with its centre at most `px` from a place, -1 to 1.

    A row and a column a pixel, and x and y of the first. Half of it may be out of the picture.
    """
    (height, width), (high, wide) = detail.shape, own.shape
    left, right = (round(min(max(about[0] + to, 0), width)) for to in (-px, px))
    top, bottom = (round(min(max(about[1] + to, 0), height)) for to in (-px, px))
    edges = high // 2, high - high // 2, wide // 2, wide - wide // 2
    around = cv2.copyMakeBorder(detail, *edges, cv2.BORDER_CONSTANT, value=MIDDLE)
    where = around[top : high + bottom, left : wide + right]
    found = cv2.matchTemplate(where, own, cv2.TM_CCOEFF_NORMED)
    return np.asarray(found, np.float32), left + wide % 2 / 2, top + high % 2 / 2


def _cells(detail: U8) -> F64:
    """LBP and Haralick's features of a picture's cells: (rows, cols, features)."""
    height, width = detail.shape
    grid = Grid(height // CELL, width // CELL, width)
    # In 256 levels hardly two of a cell's pairs of pixels would be alike.
    found = _EXTRACTOR.describe(np.ascontiguousarray(detail >> 3), grid)
    return found.reshape(grid.rows, grid.cols, -1)
