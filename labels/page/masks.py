"""Masks on the page: frames with the masked part covered, and the mask that a person draws."""

from contextlib import suppress

import numpy as np

from tokt.features.common.arrays import U8, Bools
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import Mission
from tokt.features.frames.view_mask import CameraMasks, ViewMask

from .frames import read_frame

_DIGITS = 7


def covered_frame(mission: Mission, masks: CameraMasks, camera: str, frame: int) -> U8:
    """Read a frame with its masked part covered. Raises FrameError."""
    picture, mask = read_frame(mission, camera, frame), masks.of(camera)
    return picture if mask is None else mask.cover(picture)


def frame_size(mission: Mission, camera: str) -> tuple[int, int] | None:
    """Height and width of a camera's first readable frame; None where none can be read."""
    for frame in mission.frames(camera):
        with suppress(ToktError):
            height, width = read_frame(mission, camera, frame).shape[:2]
            return height, width
    return None


def masked_patches(mission: Mission, masks: CameraMasks, grid: Grid, camera: str) -> Bools:
    """The masked patches of a camera's frames, shape (rows, cols), by its first readable frame."""
    size = frame_size(mission, camera) if masks.of(camera) else None
    with suppress(ToktError):  # too small a frame for this grid
        if size is not None:
            return masks.patches(camera, grid, *size)
    return np.zeros((grid.rows, grid.cols), bool)


def drawn_mask(
    before: ViewMask | None, grid: Grid, patches: Bools, size: tuple[int, int]
) -> ViewMask | None:
    """Make the mask of exactly these patches; None where nothing is masked.

    A box of the mask `before` stays as it is unless it touches a patch that is masked no longer.
    What else of such a box is masked becomes whole patches.

    Parameters
    ----------
    before : ViewMask or None
    grid : Grid
    patches : array of bool, shape (rows, cols)
    size : tuple of int
        Height and width of the camera's frames.

    Raises
    ------
    ToktError
        If too little of the view is left.
    """
    height, width = grid.resized(*size)
    old = before or ViewMask(())
    freed = old.patches(grid, height, width) & ~patches

    def touches(mask: ViewMask) -> bool:
        part = grid.cells(mask.pixels(height, width)).any(axis=(1, 2))
        return bool((part & freed.reshape(-1)).any())

    kept = tuple(box for box in old.boxes if not touches(ViewMask((box,))))
    rest = patches & ~ViewMask(kept).patches(grid, height, width)
    pixels = grid.paint(rest.reshape(-1), height, width) > 0
    # A patch at the edge takes the strip that belongs to no patch with it.
    down, right = grid.remainder(height, width)
    inside = pixels[: height - down, : width - right]
    pixels = np.pad(inside, ((0, down), (0, right)), mode="edge")
    drawn = np.array(ViewMask.of_cells(pixels).boxes).reshape(-1, 4)
    # Whole pixels again: one too many is much of a small patch.
    scale = np.array([width, height, width, height])
    exact = ((drawn * scale).round() / scale).round(_DIGITS)
    boxes = (*kept, *map(tuple, exact.tolist()))
    return ViewMask(boxes) if boxes else None
