"""The worst errors as images: a patch in its surroundings, contrast raised."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.frames.grid import Grid
from tokt.labels.page.state.enhance import enhanced
from tokt.training.evaluation.pictures import jpeg_uri

from .predictions import ComparedModels

_AROUND = 1.5  # patches on each side
_WIDTH = 260  # pixels of a picture
_OUTLINE_BGR = (40, 200, 255)


def _surroundings(image: NDArray[np.uint8], grid: Grid, row: int, col: int) -> NDArray[np.uint8]:
    """A patch with what is around it, outlined."""
    height, width = image.shape[:2]
    resized = grid.resized(height, width)
    box = grid.boxes(*resized)[row * grid.cols + col].astype(float)
    y0, y1 = box[:2] * height / resized[0]
    x0, x1 = box[2:] * width / resized[1]
    dy, dx = _AROUND * (y1 - y0), _AROUND * (x1 - x0)
    # A patch at the edge keeps as much around it, on its other side.
    top = round(min(max(0.0, y0 - dy), max(0.0, height - (y1 - y0) - 2 * dy)))
    left = round(min(max(0.0, x0 - dx), max(0.0, width - (x1 - x0) - 2 * dx)))
    cut = image[top : round(top + (y1 - y0) + 2 * dy), left : round(left + (x1 - x0) + 2 * dx)]
    scale = _WIDTH / cut.shape[1]
    size = (_WIDTH, max(1, round(cut.shape[0] * scale)))
    view = cv2.resize(cut, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    if view.ndim == 2:
        view = cv2.cvtColor(view, cv2.COLOR_GRAY2BGR)
    corners = [(x - left, y - top) for x, y in ((x0, y0), (x1, y1))]
    first, last = ((round(x * scale), round(y * scale)) for x, y in corners)
    cv2.rectangle(view, first, last, _OUTLINE_BGR, 2)
    return np.asarray(view, np.uint8)


def pictures(compared: ComparedModels, errors: Sequence[dict[str, Any]]) -> list[str | None]:
    """A JPEG data URI for each error; None where the frame is not at hand."""
    if compared.read_frame is None:
        return [None] * len(errors)
    grid = compared.models[0].bundle.grid
    found: dict[tuple[str, str, int], NDArray[np.uint8]] = {}
    uris: list[str | None] = []
    for error in errors:
        key = error["mission"], error["camera"], error["frame"]
        if not compared.has_frames:  # a patch has no surroundings, and no dark water to see through
            uris.append(jpeg_uri(compared.read_frame(*key)))
            continue
        if key not in found:
            found = {key: enhanced(compared.read_frame(*key))}
        uris.append(jpeg_uri(_surroundings(found[key], grid, error["row"], error["col"]), 80))
    return uris
