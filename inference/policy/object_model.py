"""The look of one named object: learnt from a box in one picture, found again in others.

::

    picture ──> cells of 6x6 px ──> features ──> 4 linear channels ──> likeness to each template
                (360 px wide)       LBP, Haralick's  that tell the       at every place and size:
                                    moments, edges   object from the     -1..1
                                                     rest of its picture

A template is the object's own cells, in their places, at one of `SIZES`. All of it is learnt from
the one picture in which a person drew the box, in a fifth of a second, and never changed: a model
that follows what it last saw drifts off the object, a bit a frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from tokt.features.common.arrays import F32, F64, U8, Bools
from tokt.features.common.errors import ToktError
from tokt.features.extractors.frame_pictures import FramePictures
from tokt.features.extractors.textures import LOG, NEAREST, Glcm, Join, Lbp, Structure
from tokt.features.frames.grid import Grid
from tokt.features.kernels.quantization import FRAME, Quantization

WIDTH, CELL = 360, 6
"""In pixels: the width that pictures are resized to, and the side of a cell."""
SIZES = 0.06 * np.arange(-10, 11)
"""ln of the sizes that are looked for, over the size in the box: 0.55 to 1.8 times."""
SOUGHT = 0.4
"""Of ln of the size: in what is smaller yet, too much looks like the object."""
MIN_VISIBLE = 0.6
"""Share of a template that has to lie in the picture."""
MIN_CELLS, MIN_SIDE, MAX_SHARE = 12, 3, 0.8
"""Of a box: with fewer cells it looks like too much else; and its share of the picture, the rest of
which it is told from."""
MAX_ALIKE = 0.9
"""Likeness of the naming picture's own rest above which the object cannot be told from it."""
MIN_STRENGTH = 4.0
"""Variance of the object's strongest channel over that of the rest: open water has about 1."""
ASPECT_TOLERANCE = 0.02
"""Relative difference of height over width to the naming picture's."""
_CHANNELS = 4
_FAINT = 0.1
"""Share of the template's energy that every window counts as having: blank is like nothing."""
_BLANK = 8.0
_SHRUNK = 1e-2
_LEVELS_STEP = 0.02
_FINE = [0.05 * step for step in range(-2, 3)]
_MARGIN = 6

_IMAGE = Quantization(gain=8, smooth=5, window=61, by=FRAME)
_DETAIL = Quantization(gain=8, smooth=5, window=21, by=FRAME)
_EXTRACTOR = Join(
    [
        Lbp(8, 5, "frame", _IMAGE, NEAREST),
        Structure(_IMAGE),
        Glcm(False, replace(_IMAGE, levels=32), LOG),
    ]
)

Box = tuple[float, float, float, float]


class Place(NamedTuple):
    """Where the object may be, and how like it that is."""

    x: float  # its centre, in pixels of a picture `WIDTH` wide, from the left and the upper edge
    y: float
    size: float  # ln of its size over that in the box
    likeness: float  # at most 1


class Reach(NamedTuple):
    """Where the object can be: about a place, pixels to each side and so much larger or smaller."""

    about: Place
    px: float
    size: float


@dataclass(frozen=True)
class _Template:
    """The object's cells at one size: (rows, cols, channels)."""

    size: float
    cells: F32  # their squares are 1 in sum
    energy: float  # what that sum was
    corner: tuple[float, float]  # of its first cell from the object's centre, px: x, y


def box_fault(box: Box, height: int, width: int) -> str:
    """Why a box (x, y, width, height, in pixels) cannot be held in such a picture; or nothing."""
    x, y, wide, high = box
    if not (
        x >= 0 and y >= 0 and wide > 0 and high > 0 and x + wide <= width and y + high <= height
    ):
        return f"it is not inside the picture of {width}x{height}"
    cells = [side * WIDTH / width // CELL for side in (wide, high)]
    if min(cells) < MIN_SIDE or cells[0] * cells[1] < MIN_CELLS:
        return f"it is too small: {MIN_CELLS} squares of {CELL * width / WIDTH:.0f} px is the least"
    if wide * high > MAX_SHARE * width * height:
        return f"it covers more than {100 * MAX_SHARE:.0f} % of the picture"
    return ""


class ObjectModel:
    """The model of what a person drew a box around.

    Raises
    ------
    ToktError
        If the box is no part of the picture, too small, or what is in it looks like the rest.
    """

    def __init__(self, picture: U8, box: Box) -> None:
        height, width = picture.shape[:2]
        if fault := box_fault(box, height, width):
            raise ToktError(f"the box cannot be held: {fault}")
        scale, self._aspect = WIDTH / width, height / width
        x, y, self.wide, self.high = (scale * side for side in box)
        self.place = Place(x + self.wide / 2, y + self.high / 2, 0.0, 1.0)
        self.share = self.wide * self.high / (WIDTH * height * scale)
        pictures, features = _cells(picture, WIDTH)
        self._learn(features, _inside(box, scale / CELL))
        self._own = pictures.picture(_DETAIL)[_inside(box, scale)]
        self._levels: dict[int, U8] = {}
        self._visible: dict[tuple[int, tuple[int, int]], F32] = {}
        if self.strength >= MIN_STRENGTH:
            self.templates = [self._template(picture, float(size)) for size in SIZES]
            rival = Likeness(self, picture).best(without=self.place)
            self.alike = 0.0 if rival is None else max(rival.likeness, 0.0)
        if self.strength < MIN_STRENGTH or self.alike > MAX_ALIKE:
            raise ToktError("the box cannot be held: what is in it looks like what is around it")

    def _learn(self, features: F32, inside: tuple[slice, slice]) -> None:
        """The channels: the object's scatter about the rest's mean, over the rest's covariance."""
        rest = np.ones(features.shape[:2], bool)
        rest[inside] = False
        around = features[rest].astype(np.float64)
        self._mean = around.mean(axis=0)
        spread = np.cov(around.T) + 1e-6 * np.eye(features.shape[2])
        spread += _SHRUNK * np.diag(np.diag(spread))
        whiten = np.linalg.inv(np.linalg.cholesky(spread))
        own = (features[inside].reshape(-1, features.shape[2]) - self._mean) @ whiten.T
        strengths, axes = np.linalg.eigh(own.T @ own / len(own))
        self.strength = float(strengths[-1])
        self._channels: F64 = whiten.T @ axes[:, : -_CHANNELS - 1 : -1]

    @property
    def border(self) -> tuple[int, int]:
        """Half of the largest template, rows and columns: so far it may leave the picture."""
        rows, cols = self.templates[-1].cells.shape[:2]
        return rows // 2, cols // 2

    def visible(self, which: int, shape: tuple[int, int]) -> F32:
        """(rows, cols) The share of a template that lies in a picture of so many cells."""
        if (which, shape) not in self._visible:
            cells = self.templates[which].cells
            rows, cols = (side // 2 for side in cells.shape[:2])
            there = np.ones(shape, np.float32)
            there = cv2.copyMakeBorder(there, rows, rows, cols, cols, cv2.BORDER_CONSTANT)
            share = cv2.matchTemplate(there, np.square(cells).sum(axis=2), cv2.TM_CCORR)
            self._visible[which, shape] = np.maximum(share, 1e-6)
        return self._visible[which, shape]

    def box_at(self, place: Place) -> Box:
        """The box around the object at a place, in shares of the picture's sides."""
        times, high = math.exp(place.size), WIDTH * self._aspect
        wide, tall = times * self.wide / WIDTH, times * self.high / high
        return place.x / WIDTH - wide / 2, place.y / high - tall / 2, wide, tall

    def fits(self, picture: U8) -> bool:
        """Whether a picture has the shape of the one that this was learnt from."""
        height, width = picture.shape[:2]
        return width >= CELL and abs(height / width / self._aspect - 1) <= ASPECT_TOLERANCE

    def channels(self, picture: U8, width: int) -> tuple[F32, U8]:
        """What tells the object from the rest, (rows, cols, 4), and its fine detail, in levels."""
        pictures, features = _cells(picture, width)
        found = (features - self._mean) @ self._channels
        found /= np.sqrt(_BLANK**2 + np.square(found).sum(axis=2, keepdims=True))
        # Cells do not lie on the object alike in any two pictures.
        blurred = cv2.blur(found.astype(np.float32), (3, 3))
        return np.asarray(blurred, np.float32), pictures.picture(_DETAIL)

    def levels_at(self, size: float) -> U8:
        """The object's fine detail at another size, in levels."""
        at = round(size / _LEVELS_STEP)
        if at not in self._levels:
            times, (high, wide) = math.exp(at * _LEVELS_STEP), self._own.shape
            how = cv2.INTER_AREA if times < 1 else cv2.INTER_LINEAR
            resized = cv2.resize(
                self._own, (round(times * wide), round(times * high)), interpolation=how
            )
            self._levels[at] = np.asarray(resized, np.uint8)
        return self._levels[at]

    def _template(self, picture: U8, size: float) -> _Template:
        """The object's cells at another size, of its picture resized."""
        times = math.exp(size)
        seen, _ = self.channels(picture, round(times * WIDTH))
        x, y = times * self.place.x, times * self.place.y
        wide, high = times * self.wide, times * self.high
        rows = slice(max(round((y - high / 2) / CELL), 0), round((y + high / 2) / CELL))
        cols = slice(max(round((x - wide / 2) / CELL), 0), round((x + wide / 2) / CELL))
        cells = np.ascontiguousarray(seen[rows, cols])
        energy = float(np.square(cells).sum())
        corner = cols.start * CELL - x, rows.start * CELL - y
        return _Template(size, cells / np.float32(energy**0.5), energy, corner)


class Likeness:
    """How like the object the places of one picture are."""

    def __init__(self, model: ObjectModel, picture: U8) -> None:
        self._model = model
        seen, self._levels = model.channels(picture, WIDTH)
        self._shape = seen.shape[:2]
        down, across = self._border = model.border
        around = down, down, across, across, cv2.BORDER_CONSTANT
        self._seen = np.asarray(cv2.copyMakeBorder(seen, *around), np.float32)
        self._energy = cv2.integral(np.square(self._seen).sum(axis=2))

    def best(self, reach: Reach | None = None, without: Place | None = None) -> Place | None:
        """The place most like the object, and not on the place that is left out.

        Within reach; without one anywhere, of a size not more than `SOUGHT` from that in the box.
        """
        found = Place(0.0, 0.0, 0.0, -1.0)
        for which, template in enumerate(self._model.templates):
            if abs(template.size - (0.0 if reach is None else reach.about.size)) > (
                SOUGHT if reach is None else reach.size
            ):
                continue
            likeness, x, y = self._map(which, reach)
            if not likeness.size:
                continue
            likeness = np.where(self._allowed(x, y, reach, without), likeness, -1.0)
            row, col = divmod(int(likeness.argmax()), likeness.shape[1])
            if likeness[row, col] > found.likeness:
                there = float(x[col]), float(y[row]), template.size
                found = Place(*there, float(likeness[row, col]))
        return found if found.likeness > -1.0 else None

    def _map(self, which: int, reach: Reach | None) -> tuple[F32, F64, F64]:
        """Likeness of a template's places within reach, a cell apart, and their x and y in pixels.

        The cosine between the template and what is in its window, over what of it is in the view;
        -1 where that is too little.
        """
        template = self._model.templates[which]
        visible = self._model.visible(which, self._shape)
        (rows, cols), (x0, y0) = template.cells.shape[:2], template.corner
        x = (np.arange(visible.shape[1]) - cols // 2) * CELL - x0
        y = (np.arange(visible.shape[0]) - rows // 2) * CELL - y0
        first, last = (0, 0), visible.shape
        if reach is not None:
            about, px = reach.about, np.array([-reach.px, reach.px])
            (first_y, last_y), (first_x, last_x) = (
                np.searchsorted(axis, at + px) for axis, at in ((y, about.y), (x, about.x))
            )
            first, last = (int(first_y), int(first_x)), (int(last_y), int(last_x))
        there = slice(first[0], last[0]), slice(first[1], last[1])
        share = visible[there]
        if not share.size:
            return share, x, y
        # Windows in the padded map, by their first cell and one past the last.
        top, left = first[0] + self._border[0] - rows // 2, first[1] + self._border[1] - cols // 2
        bottom, right = top + share.shape[0], left + share.shape[1]
        seen = self._seen[top : bottom + rows - 1, left : right + cols - 1]
        alike = cv2.matchTemplate(seen, template.cells, cv2.TM_CCORR)
        upper, lower = (
            self._energy[at : at + share.shape[0], left : right + cols] for at in (top, top + rows)
        )
        columns = lower - upper
        inside = columns[:, cols:] - columns[:, :-cols]
        found = alike / np.sqrt(share * np.maximum(inside, _FAINT * template.energy * share))
        found[share < MIN_VISIBLE] = -1.0
        return found.astype(np.float32), x[there[1]], y[there[0]]

    def _allowed(self, x: F64, y: F64, reach: Reach | None, without: Place | None) -> Bools:
        allowed = np.ones((len(y), len(x)), bool)
        if reach is not None:
            about = reach.about
            allowed &= np.hypot(x - about.x, (y - about.y)[:, None]) <= reach.px
        if without is not None:
            times = math.exp(without.size) / 2
            beside = np.abs(x - without.x) > times * self._model.wide
            allowed &= beside | (np.abs(y - without.y) > times * self._model.high)[:, None]
        return allowed

    def refined(self, place: Place) -> tuple[Place, float]:
        """The place to the pixel, and the correlation (-1..1) of the fine detail there."""
        fits = [self._fit(place, place.size + step) for step in _FINE]
        best = max(range(len(fits)), key=lambda at: fits[at][0])
        match, x, y = fits[best]
        beside = [fits[at][0] if 0 <= at < len(fits) else -1.0 for at in (best - 1, best + 1)]
        step = (_FINE[1] - _FINE[0]) * _peak(beside[0], match, beside[1])
        return Place(x, y, place.size + _FINE[best] + step, place.likeness), match

    def _fit(self, place: Place, size: float) -> tuple[float, float, float]:
        """The best correlation with the object at one size, near a place, and where: x, y."""
        levels, own = self._levels, self._model.levels_at(size)
        (high, wide), (rows, cols) = own.shape, levels.shape
        left, top = round(place.x - wide / 2), round(place.y - high / 2)
        # What of the object is in the view, wherever it is moved to.
        x0, x1 = max(_MARGIN - left, 0), min(cols - _MARGIN - left, wide)
        y0, y1 = max(_MARGIN - top, 0), min(rows - _MARGIN - top, high)
        if x1 - x0 < CELL or y1 - y0 < CELL:
            return -1.0, place.x, place.y
        near = levels[
            top + y0 - _MARGIN : top + y1 + _MARGIN, left + x0 - _MARGIN : left + x1 + _MARGIN
        ]
        found = cv2.matchTemplate(near, own[y0:y1, x0:x1], cv2.TM_CCOEFF_NORMED)
        _, match, _, (across, down) = cv2.minMaxLoc(found)
        x, y = left + across - _MARGIN + wide / 2, top + down - _MARGIN + high / 2
        return match, x, y


def _peak(before: float, here: float, after: float) -> float:
    """Where a parabola through three values has its top, -0.5 to 0.5 from the middle one."""
    bent = before - 2 * here + after
    if min(before, after) <= -1.0 or bent >= 0:
        return 0.0
    return min(max((before - after) / (2 * bent), -0.5), 0.5)


def _inside(box: Box, scale: float) -> tuple[slice, slice]:
    x, y, wide, high = (scale * side for side in box)
    return slice(round(y), round(y + high)), slice(round(x), round(x + wide))


def _cells(picture: U8, width: int) -> tuple[FramePictures, F32]:
    """Features of a picture's cells: (rows, cols, features)."""
    if width > picture.shape[1]:
        high = round(picture.shape[0] * width / picture.shape[1])
        picture = np.asarray(cv2.resize(picture, (width, high)), np.uint8)
    height = picture.shape[0] * width // picture.shape[1]
    grid = Grid(height // CELL, width // CELL, width)
    pictures = FramePictures(picture, grid)
    found = _EXTRACTOR.describe_pictures(pictures)
    return pictures, found.reshape(grid.rows, grid.cols, -1).astype(np.float32)
