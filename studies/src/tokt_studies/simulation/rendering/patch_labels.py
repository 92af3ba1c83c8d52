"""The label of each patch of a synthetic frame, from the geometry and the contrast; its file."""

from collections.abc import Iterable, Sequence

import cv2
import numpy as np
import pandas as pd

from tokt.features.common.arrays import F32, F64, Bools
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.features.frames.mission import LEFT

OCEAN, UNSURE, TOWER = "ocean", "unsure", "subsea_installation"
MIN_COVERAGE = 0.10
"""Share of a patch from which the tower counts, as on the real mission."""
MIN_CONTRAST = 0.8
"""Mean absolute difference in grey levels that a person can make out with enhancement."""


def coverage(mask: Bools, grid: Grid) -> F64:
    """Share of each patch that the tower covers: float64, (patches,), 0..1.

    It is exactly 0 where no tower pixel reaches the patch. The mask (height, width) is true on the
    tower in a frame as the camera gave it, and is resized as the frame would be.
    """
    covered = _resized(mask.astype(np.float32), grid)
    return np.asarray(grid.cells(covered).mean(axis=(1, 2), dtype=np.float64))


def _resized(image: F32, grid: Grid) -> F32:
    size = grid.resized(*image.shape[:2])[::-1]
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def contrast(with_tower: F32, without: F32, mask: Bools, grid: Grid) -> F64:
    """Mean absolute change in grey levels that the tower makes where it covers each patch; or 0.

    Of the frame without snow and noise, (height, width, 3) BGR, with the tower and without it.
    """
    gray = [
        cv2.cvtColor(_resized(np.minimum(image, 255), grid), cv2.COLOR_BGR2GRAY)
        for image in (with_tower, without)
    ]
    covered = _resized(mask.astype(np.float32), grid)
    change = grid.cells(np.abs(gray[0] - gray[1]) * covered).sum(axis=(1, 2), dtype=np.float64)
    weight = grid.cells(covered).sum(axis=(1, 2), dtype=np.float64)
    share = np.divide(change, weight, out=np.zeros_like(change), where=weight > 0)
    return np.asarray(share, np.float64)


def patch_labels(covered: F64, seen: F64) -> list[str]:
    """`subsea_installation`, `unsure` or `ocean` for each patch, row by row.

    A patch is the tower's when it covers `MIN_COVERAGE` of it and differs from open water by
    `MIN_CONTRAST`; a smaller or fainter part of the tower is `unsure`.
    """
    certain = (covered >= MIN_COVERAGE) & (seen >= MIN_CONTRAST)
    return list(np.where(certain, TOWER, np.where(covered > 0, UNSURE, OCEAN)))


def labels_csv(mission: str, frames: Iterable[tuple[int, Sequence[str]]]) -> bytes:
    """The label file of a mission's left frames: a row a patch of numbered frames with labels."""
    rows = [
        (mission, LEFT, number, *divmod(cell, DEFAULT_GRID.cols), label)
        for number, labels in frames
        for cell, label in enumerate(labels)
    ]
    table = pd.DataFrame(rows, columns=["mission", "camera", "frame", "row", "col", "label"])
    text: str = table.to_csv(index=False, lineterminator="\n")
    return text.encode("utf-8")
