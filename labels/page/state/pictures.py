"""Frames and patches as the page shows them."""

import threading
from collections import OrderedDict
from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError, ToktError
from tokt.features.frames.grid import Grid
from tokt.features.frames.image_file import decode_image, is_shown_alike
from tokt.features.frames.mission import Mission
from tokt.labels.page.frames import encoded_frame, read_frame

from .enhance import enhanced, enhanced_small, working_width

SPRITE_COLUMNS = 10
JPEG_QUALITY = 88

_JPEG = "image/jpeg"
_SHOWN_BY_BROWSERS = {".jpg": _JPEG, ".jpeg": _JPEG, ".png": "image/png"}
_KEPT_BYTES = 64 * 1024 * 1024
_FAULT_BGR = (70, 70, 70), (150, 150, 150)


def frame_picture(
    mission: Mission, camera: str, frame: int, enhance: int, width: int | None = None
) -> tuple[bytes, str]:
    """One frame as a file that browsers show, and its media type.

    With 0 for `enhance` it is the camera's own file where browsers show its very pixels and
    otherwise a PNG of them; up to 100 (see `enhanced`), or made `width` pixels wide (a narrower
    frame stays as it is), a JPEG.

    Raises FrameError if the frame is not there, damaged or truncated; nothing is shown in its
    place.
    """
    if width is None and enhance == 0:
        return _own_file(mission, camera, frame)
    if width is None:
        return _jpeg(enhanced(read_frame(mission, camera, frame), enhance)), _JPEG
    picture = _enhanced_at(read_frame(mission, camera, frame), enhance, width)
    if picture.shape[1] > width:
        height = max(1, round(picture.shape[0] * width / picture.shape[1]))
        picture = _resized(picture, width, height)
    return _jpeg(picture), _JPEG


class PatchPictures:
    """Sprites of patches: many patches in one picture. For any number of threads."""

    def __init__(self, mission: Mission, grid: Grid) -> None:
        self._mission = mission
        self._grid = grid
        self._kept: OrderedDict[tuple[str, int, int, int], U8] = OrderedDict()
        self._lock = threading.Lock()

    def sprite(
        self,
        cells: Sequence[tuple[str, int, int]],
        size: int = 72,
        margin: float = 0.25,
        enhance: int = 60,
    ) -> tuple[bytes, str]:
        """Patches in rows of 10, in the order given, as one JPEG and its media type.

        The last row is filled up with black. A frame that cannot be read gives crossed-out tiles.
        Tiles are `size` pixels wide and high; patches keep their shape, in the middle, with
        `margin` of a patch (0 to 1) around each one.

        Raises ToktError if a cell is outside the grid.
        """
        last = self._grid.n_patches - 1
        for _, _, cell in cells:
            if not 0 <= cell <= last:
                raise ToktError(f"cell is 0 to {last}, not {cell}")
        rows = -(-len(cells) // SPRITE_COLUMNS)
        sheet = np.zeros((rows * size, SPRITE_COLUMNS * size, 3), np.uint8)
        # One frame after the other: each is decoded once, however few are kept.
        for index in sorted(range(len(cells)), key=lambda index: cells[index][:2]):
            y, x = (part * size for part in divmod(index, SPRITE_COLUMNS))
            sheet[y : y + size, x : x + size] = self._tile(*cells[index], size, margin, enhance)
        return _jpeg(sheet), _JPEG

    def _tile(
        self, camera: str, frame: int, cell: int, size: int, margin: float, enhance: int
    ) -> U8:
        try:
            # A little enlarged is enough to tell what is in a patch, and much sooner there.
            width = size * self._grid.cols * 2 // 3
            picture = self._picture(camera, frame, enhance, width)
            patch = self._cut(picture, cell, margin)
        except ToktError:  # an unreadable frame, or too small a one for this grid
            return _crossed_out(size)
        height, width = patch.shape[:2]
        scale = size / max(height, width)
        patch = _resized(patch, max(1, round(width * scale)), max(1, round(height * scale)))
        tile = np.zeros((size, size, 3), np.uint8)
        y, x = (size - patch.shape[0]) // 2, (size - patch.shape[1]) // 2
        tile[y : y + patch.shape[0], x : x + patch.shape[1]] = (
            patch if patch.ndim == 3 else patch[..., None]
        )
        return tile

    def _cut(self, picture: U8, cell: int, margin: float) -> U8:
        """A patch and its surroundings, as far as the picture goes."""
        height, width = picture.shape[:2]
        patch_height, patch_width = height / self._grid.rows, width / self._grid.cols
        row, col = divmod(cell, self._grid.cols)
        y0, y1 = (patch_height * (row + part) for part in (-margin, 1 + margin))
        x0, x1 = (patch_width * (col + part) for part in (-margin, 1 + margin))
        y, x = max(0, round(y0)), max(0, round(x0))
        patch = picture[y : max(y + 1, round(y1)), x : max(x + 1, round(x1))]
        if not patch.size:
            raise FrameError("the frame has fewer pixels than the grid has patches")
        return patch

    def _picture(self, camera: str, frame: int, enhance: int, width: int) -> U8:
        key = (camera, frame, enhance, width)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        image = read_frame(self._mission, camera, frame)
        picture = _covered(_enhanced_at(image, enhance, width), image.shape[:2], self._grid)
        with self._lock:
            self._kept[key] = picture
            while len(self._kept) > 1 and sum(p.nbytes for p in self._kept.values()) > _KEPT_BYTES:
                self._kept.popitem(last=False)
        return picture


def _own_file(mission: Mission, camera: str, frame: int) -> tuple[bytes, str]:
    data, suffix = encoded_frame(mission, camera, frame)
    # A browser shows what there is of a truncated file; nobody may label what is not there.
    image = decode_image(data, f"{camera} frame {frame}")
    if suffix in _SHOWN_BY_BROWSERS and is_shown_alike(data):
        return data, _SHOWN_BY_BROWSERS[suffix]
    return cv2.imencode(".png", image)[1].tobytes(), "image/png"


def _enhanced_at(frame: U8, enhance: int, width: int) -> U8:
    """A frame enhanced, at least `width` wide where the frame is."""
    if working_width(frame.shape[1]) >= min(width, frame.shape[1]):
        return enhanced_small(frame, enhance)
    return enhanced(frame, enhance)


def _covered(picture: U8, frame_size: tuple[int, ...], grid: Grid) -> U8:
    """A picture of a frame without the strip that belongs to no patch."""
    height, width = grid.resized(*frame_size)
    patch_height, patch_width = grid.patch_size(height, width)
    rows = round(picture.shape[0] * patch_height * grid.rows / height)
    cols = round(picture.shape[1] * patch_width * grid.cols / width)
    return picture[:rows, :cols]


def _resized(picture: U8, width: int, height: int) -> U8:
    smaller = width < picture.shape[1]
    way = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, (width, height), interpolation=way), np.uint8)


def _jpeg(picture: U8) -> bytes:
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    return cv2.imencode(".jpg", picture, quality)[1].tobytes()


@lru_cache(maxsize=4)
def _crossed_out(size: int) -> U8:
    ground, line = _FAULT_BGR
    tile = np.full((size, size, 3), ground, np.uint8)
    cv2.line(tile, (0, 0), (size - 1, size - 1), line, 2)
    cv2.line(tile, (0, size - 1), (size - 1, 0), line, 2)
    return tile
