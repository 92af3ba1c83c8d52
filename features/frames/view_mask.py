"""The part of a camera's picture that is no view: a burned-in clock, a rim, a tether, a skid.

Such a part is covered before anything looks at a picture: its pixels become a smooth continuation
of what is around it, which shows neither texture nor movement nor anything that two views share.
A patch with more than `MASKED_PART` of its pixels covered is masked: neither obstacle nor clear.

::

    +--------------------+        +--------------------+       boxes are parts of the width and
    |          12:07:31  |        |                    |       height, so that they hold for
    |   |#|              |  --->  |   |#|              |       frames of every size
    |   |#|              |        |   |#|              |
    +--------------------+        +--------------------+

The mask of a dive stands beside its frames, in `MASK_FILE` of a folder, or beside a video.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from tokt.features.common import atomic
from tokt.features.common.arrays import F32, U8, Bools
from tokt.features.common.errors import ToktError, check_format, naming, os_errors_as
from tokt.features.common.held_files import file_bytes, is_held

from .grid import DEFAULT_GRID, Grid
from .image_file import SUFFIXES, read_image
from .mask_file import MASK_FILE, mask_file

FORMAT_VERSION = 1
CAMERAS = ("left", "right")
MASKED_PART = 0.1
"""Part of a patch's pixels. Less, such as the edge of a box beside the patch, leaves enough of it
to be judged by; where more is covered, it has too little noise left to pass for seen."""
MAX_MASKED = 0.8
MAX_MASKED_MIDDLE = 0.5
"""Parts of the patches, and of the middle 6x6 of 10x10, that may be masked. The rim of a fisheye
lens whose circle is as high as a 16:9 picture masks 0.72 and 0.33."""
_WIDEST = 120  # cells; a picture becomes the boxes of its cells in which anything is masked
_FILL_WIDTH = 96  # pixels of the small picture in which what is masked is filled
_NEARNESS = 1.25
"""Exponent of the squared distance by which a filled pixel follows those around the hole. Tried on
a fisheye's rim over frames of the sea trial of 20 April 2016: gradients along the mask's edge are
1.0 times those elsewhere. With 1.5 the noise around the hole shows as streaks in the fill."""
_DIGITS = 5
_NUMBER = r"\s*(\d+(?:\.\d*)?|\.\d+)\s*"
_BOX = re.compile(rf"{_NUMBER},{_NUMBER},{_NUMBER},{_NUMBER}(?:@\s*(\d{{1,6}})x(\d{{1,6}}))?")
_SIDE = re.compile(r"(left|right):(.+)", re.DOTALL)

Box = tuple[float, float, float, float]
"""Left edge, upper edge, width and height, as parts of the picture's width and height."""


@dataclass(frozen=True)
class ViewMask:
    """What is no view in one camera's pictures; ToktError if it leaves too little of one."""

    boxes: tuple[Box, ...]

    def __post_init__(self) -> None:
        for box in self.boxes:
            x, y, width, height = box
            inside = min(box) >= 0 and x + width <= 1 + 1e-4 and y + height <= 1 + 1e-4
            if not inside or min(width, height) == 0:
                raise ToktError(
                    f"a box of a mask is X,Y,WIDTH,HEIGHT as parts of the view, 0 to 1, not "
                    f"{','.join(f'{value:g}' for value in box)}"
                )
        # By patches: a part of one that is masked costs it all.
        masked = _patches(self, DEFAULT_GRID, 270, 360)
        middle = masked[2:8, 2:8].mean()
        if masked.mean() > MAX_MASKED or middle > MAX_MASKED_MIDDLE:
            raise ToktError(
                f"the mask covers {100 * masked.mean():.0f} % of the view and {100 * middle:.0f} % "
                f"of its middle. At most {100 * MAX_MASKED:.0f} % and "
                f"{100 * MAX_MASKED_MIDDLE:.0f} % may be no view; in a picture, white is masked"
            )

    @classmethod
    def of_cells(cls, cells: Bools) -> ViewMask:
        """Mask cells of equal size, shape (rows, cols), that cover the whole picture."""
        return cls(boxes_of(cells))

    @classmethod
    def of_picture(cls, picture: U8) -> ViewMask:
        """Mask what is white, or bright, in a picture of the camera's shape."""
        gray = picture if picture.ndim == 2 else picture.max(axis=2)
        height, width = gray.shape
        cols = min(width, _WIDEST)
        size = cols, max(round(cols * height / width), 1)
        white = (gray > 127).astype(np.float32)
        return cls.of_cells(cv2.resize(white, size, interpolation=cv2.INTER_AREA) > 0)

    def share(self) -> float:
        """Part of the picture that is masked, 0 to 1."""
        return float(_pixels(self, 240, 320).mean())

    def pixels(self, height: int, width: int) -> Bools:
        """The masked pixels of a picture of some size, shape (height, width)."""
        return _pixels(self, height, width)

    def patches(self, grid: Grid, height: int, width: int) -> Bools:
        """The masked patches of a *resized* frame, shape (rows, cols)."""
        return _patches(self, grid, height, width)

    def cover(self, picture: U8) -> U8:
        """Copy a picture with the masked part covered.

        Parameters
        ----------
        picture : array of uint8, shape (height, width) or (height, width, 3)
        """
        covered = picture.copy()
        for each in _parts(self, *picture.shape[:2]):
            there = covered[each.part]
            small = _resized(there, each.inside.shape, cv2.INTER_AREA)
            small[each.inside] = np.tensordot(each.weights, small[each.around], axes=1)
            fill = _resized(small, each.hidden.shape, cv2.INTER_LINEAR)
            cv2.copyTo(cv2.convertScaleAbs(fill), each.hidden, there)
        return covered


def boxes_of(cells: Bools) -> tuple[Box, ...]:
    """Join cells of equal size, shape (rows, cols), that cover the whole picture, to boxes."""
    rows, cols = cells.shape
    boxes: list[Box] = []
    left = np.asarray(cells, bool).copy()
    for row, col in np.argwhere(cells):
        if not left[row, col]:
            continue
        width = int(np.argmin(np.append(left[row, col:], False)))
        below = left[row:, col : col + width].all(axis=1)
        height = int(np.argmin(np.append(below, False)))
        left[row : row + height, col : col + width] = False
        box = int(col) / cols, int(row) / rows, width / cols, height / rows
        boxes.append(tuple(round(value, _DIGITS) for value in box))
    return tuple(boxes)


def mask_options(boxes: Iterable[Box], camera: str) -> str:
    """Write boxes as the options of ``tokt run`` that mask them."""
    return " ".join(f"--mask {camera}:{','.join(f'{at:g}' for at in box)}" for box in boxes)


@lru_cache(maxsize=16)
def _pixels(mask: ViewMask, height: int, width: int) -> Bools:
    pixels = np.zeros((height, width), bool)
    for x, y, wide, high in mask.boxes:
        # A pixel at the least: a part of one beside a patch must not reach into the next patch.
        first, top = round(x * width), round(y * height)
        end, bottom = max(round((x + wide) * width), first + 1), round((y + high) * height)
        pixels[top : max(bottom, top + 1), first:end] = True
    return pixels


@lru_cache(maxsize=16)
def _patches(mask: ViewMask, grid: Grid, height: int, width: int) -> Bools:
    part = grid.cells(_pixels(mask, height, width)).mean(axis=(1, 2))
    return np.asarray((part > MASKED_PART).reshape(grid.rows, grid.cols))


def _resized(picture: U8 | F32, shape: tuple[int, ...], way: int) -> F32:
    resized = cv2.resize(picture, (shape[1], shape[0]), interpolation=way)
    return np.asarray(resized, np.float32)


class _MaskedPart(NamedTuple):
    """The part of a picture around what is masked in it, and a small copy of that part."""

    part: tuple[slice, slice]
    hidden: U8  # its masked pixels, 0 or 1
    inside: Bools  # the small copy's pixels that hold anything of these
    around: Bools  # those beside them
    weights: F32  # (n_inside, n_around): how the former follow from the latter


@lru_cache(maxsize=8)
def _parts(mask: ViewMask, height: int, width: int) -> tuple[_MaskedPart, ...]:
    """Cut out each connected part that is masked, with some of the view around it."""
    pixels = _pixels(mask, height, width).view(np.uint8)
    margin = -(-2 * width // _FILL_WIDTH)
    wide = np.ones((2 * margin + 1,) * 2, np.uint8)
    _, _, boxes, _ = cv2.connectedComponentsWithStats(cv2.dilate(pixels, wide))
    found = []
    for x, y, across, down, _ in boxes[1:].tolist():
        part = slice(y, y + down), slice(x, x + across)
        hidden = np.ascontiguousarray(pixels[part])
        size = [max(round(side * _FILL_WIDTH / width), 1) for side in (down, across)]
        inside = _resized(hidden.astype(np.float32), (*size,), cv2.INTER_AREA) > 0
        beside = cv2.dilate(inside.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
        around = beside & ~inside
        found.append(_MaskedPart(part, hidden, inside, around, _weights(inside, around)))
    return tuple(found)


def _weights(inside: Bools, around: Bools) -> F32:
    """Weigh the pixels around a hole, for each in it, by their distance."""
    here, there = np.argwhere(inside)[:, None], np.argwhere(around)[None]
    near = ((here - there) ** 2).sum(axis=2).astype(np.float32) ** -_NEARNESS
    return np.asarray(near / np.maximum(near.sum(axis=1, keepdims=True), 1e-9), np.float32)


@dataclass(frozen=True)
class CameraMasks:
    """The masks of the left and the right camera; None where all of the picture is view."""

    left: ViewMask | None = None
    right: ViewMask | None = None

    def of(self, camera: str) -> ViewMask | None:
        """The mask of one of `CAMERAS`."""
        return {"left": self.left, "right": self.right}.get(camera)

    def patches(self, camera: str, grid: Grid, height: int, width: int) -> Bools:
        """The masked patches of a camera's frame of this size, shape (rows, cols)."""
        mask = self.of(camera)
        if mask is None:
            return np.zeros((grid.rows, grid.cols), bool)
        return mask.patches(grid, *grid.resized(height, width))

    def __bool__(self) -> bool:
        return self.left is not None or self.right is not None

    def words(self) -> str:
        """What is masked, for people."""
        parts = [
            f"{100 * mask.share():.1f} % of the {camera} view"
            for camera in CAMERAS
            if (mask := self.of(camera)) is not None
        ]
        return f"masked as no view: {' and '.join(parts)}" if parts else "nothing is masked"

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form: each camera's boxes."""
        boxes = {
            camera: [list(box) for box in mask.boxes]
            for camera in CAMERAS
            if (mask := self.of(camera)) is not None
        }
        return {"format": FORMAT_VERSION, **boxes}

    @classmethod
    def from_json(cls, value: Any) -> CameraMasks:
        """Read back what `to_json` gave. Raises ToktError if it is none."""
        try:
            check_format(value["format"], FORMAT_VERSION, "the mask")
            if not set(value) <= {"format", *CAMERAS}:
                raise ValueError("other entries")
            masks = {
                camera: ViewMask(tuple(_box(box) for box in value[camera]))
                for camera in CAMERAS
                if value.get(camera)
            }
        except (KeyError, TypeError, ValueError, AttributeError):
            raise ToktError(
                f'a mask is {{"format": {FORMAT_VERSION}, "left": [[X, Y, WIDTH, HEIGHT]]}}, each '
                "a part of the view, 0 to 1"
            ) from None
        return cls(**masks)


def _box(value: Any) -> Box:
    x, y, width, height = value
    if any(type(number) not in (int, float) for number in (x, y, width, height)):
        raise TypeError("a box is four numbers")
    return float(x), float(y), float(width), float(height)


def joined(masks: Iterable[CameraMasks]) -> CameraMasks:
    """Mask what any of several do; ToktError where that leaves too little of the view."""
    boxes: dict[str, list[Box]] = {camera: [] for camera in CAMERAS}
    for each in masks:
        for camera in CAMERAS:
            mask = each.of(camera)
            boxes[camera] += [] if mask is None else mask.boxes
    found = (tuple(dict.fromkeys(boxes[camera])) for camera in CAMERAS)
    return CameraMasks(*(ViewMask(some) if some else None for some in found))


def parse_masks(texts: Iterable[str], learnt: Sequence[CameraMasks] = ()) -> CameraMasks:
    """Read masks as users write them.

    Parameters
    ----------
    texts : iterable of str
        Each a box ``X,Y,WIDTH,HEIGHT`` in parts of the view, 0 to 1, or in pixels of a frame whose
        size follows, ``X,Y,WIDTH,HEIGHT@WIDTHxHEIGHT``; or a picture, white where there is no view;
        or a file that `write_masks` wrote; ``model`` for all of `learnt`; ``none`` for nothing.
        With ``left:`` or ``right:`` before it, it is that camera's alone.
    learnt : sequence of CameraMasks, optional
        Of the frames that the model learnt from.

    Raises
    ------
    ToktError
        If one is none of these, or what is masked leaves too little of the view.
    """
    found = []
    for text in texts:
        side = _SIDE.fullmatch(text)
        given = _read_one(text if side is None else side[2], learnt)
        found.append(given if side is None else CameraMasks(**{side[1]: given.of(side[1])}))
    return joined(found)


def _read_one(text: str, learnt: Sequence[CameraMasks]) -> CameraMasks:
    if text == "none":
        return CameraMasks()
    if text == "model":
        if not learnt:
            raise ToktError("--mask model: nothing was masked in what the model learnt from")
        return joined(learnt)
    match = _BOX.fullmatch(text)
    if match is not None:
        width, height = float(match[5] or 1), float(match[6] or 1)
        if not width * height:
            raise ToktError(f"a frame has pixels, not {match[5]}x{match[6]}")
        x, y, wide, high = (float(match[at]) for at in range(1, 5))
        both = ViewMask((_box((x / width, y / height, wide / width, high / height)),))
        return CameraMasks(both, both)
    path = Path(text)
    if path.suffix.lower() in SUFFIXES:
        with naming(text):
            both = ViewMask.of_picture(read_image(path))
        return CameraMasks(both, both) if both.boxes else CameraMasks()
    if path.suffix.lower() != ".json":
        raise ToktError(
            f"a mask is a picture, a {MASK_FILE} or a box X,Y,WIDTH,HEIGHT of parts of the view, "
            f"0 to 1, such as 0.7,0,0.3,0.1, not {text!r}"
        )
    return _read_file(path)


def _read_file(path: Path) -> CameraMasks:
    with os_errors_as(f"cannot read {path}"), naming(path):
        try:
            value = json.loads(file_bytes(path).decode("utf-8"))
        except ValueError:
            raise ToktError("it is no JSON") from None
        return CameraMasks.from_json(value)


def read_masks(mission: Path) -> CameraMasks:
    """The masks of a dive; empty where none were made. Raises ToktError if they cannot be read."""
    path = mask_file(mission)
    return _read_file(path) if is_held(path) or path.exists() else CameraMasks()


def write_masks(mission: Path, masks: CameraMasks) -> None:
    """Keep the masks of a dive beside its frames. Raises ToktError where that cannot be written."""
    path = mask_file(mission)
    with os_errors_as(f"cannot write {path}"):
        if masks:
            atomic.write_text(path, json.dumps(masks.to_json(), indent=2) + "\n")
        else:
            path.unlink(missing_ok=True)


def masks_by_mission(value: Any) -> dict[str, CameraMasks]:
    """Read masks by the names of missions, as datasets and models hold them; ToktError if none."""
    if not isinstance(value, Mapping):
        raise ToktError("masks are named by missions")
    return {str(name): CameraMasks.from_json(one) for name, one in value.items()}
