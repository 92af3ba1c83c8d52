"""A model that says which picture it saw: its obstacle is the cell that tells the number."""

from dataclasses import dataclass

import numpy as np

from tests.inference.sources.video.encoding import decoded, encode
from tests.inference.sources.video.pictures import CELLS, PLACES, bgr, number_at, place_of
from tests.load.bundles import content_of, learnt
from tokt.features.extractors.extractor import Lbp
from tokt.features.frames.grid import Grid
from tokt.models.bundle.bundle import bundle_bytes

_EXTRACTOR, _GRID = Lbp(10, 5, "frame"), Grid(CELLS, CELLS)
_PICTURES = 60
_FILM = 600  # after which the background comes again
_MAX_PATCHES = 1.6


def telling_bundle(size: tuple[int, int], bitrate: int) -> bytes:
    """A bundle learnt from pictures as an encoder leaves them."""
    units = encode("h264", _PICTURES, size, bitrate=bitrate)
    shown = dict(decoded(units, "h264", "bgr24"))
    shown |= {number: bgr(number, size) for number in range(_PICTURES, _FILM, _FILM // _PICTURES)}
    rows = np.vstack([_EXTRACTOR.describe(picture, _GRID) for picture in shown.values()])
    rough = np.zeros((len(shown), CELLS, CELLS), np.int64)
    for at, number in enumerate(shown):
        rough[(at, *place_of(number))] = 1
    model = learnt(rows, rough.ravel())
    return bundle_bytes(content_of("telling", _EXTRACTOR, _GRID, model, [shown[0], shown[1]]))


@dataclass(frozen=True)
class Told:
    size: tuple[int, int]

    def number(self, box: list[int] | None, newest: int) -> int | None:
        """The newest number up to `newest` whose cell that is; None where the box is no cell."""
        height, width = _GRID.resized(self.size[1], self.size[0])
        if box is None:
            return None
        x, y, wide, tall = box
        if wide > _MAX_PATCHES * width / CELLS or tall > _MAX_PATCHES * height / CELLS:
            return None
        row = int((y + tall / 2) * CELLS / height)
        col = int((x + wide / 2) * CELLS / width)
        return newest - (newest - number_at(row, col)) % PLACES if row else None
