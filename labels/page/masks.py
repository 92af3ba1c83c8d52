"""Masks on the page: frames with the masked part covered, and the mask that a person draws."""

from contextlib import suppress

import numpy as np

from tokt.features.common.arrays import U8, Bools
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import Mission, frame_size
from tokt.features.frames.view_mask import CameraMasks, ViewMask, boxes_of

from .frames import read_frame


def covered_frame(mission: Mission, masks: CameraMasks, camera: str, frame: int) -> U8:
    """Read a frame with its masked part covered. Raises FrameError."""
    picture, mask = read_frame(mission, camera, frame), masks.of(camera)
    return picture if mask is None else mask.cover(picture)


def shown_size(mission: Mission, camera: str) -> tuple[int, int]:
    """Width and height of a camera's first readable frame; ToktError where none can be read."""
    return frame_size(mission, camera, lambda frame, side: read_frame(mission, side, frame))


def masked_patches(mission: Mission, masks: CameraMasks, grid: Grid, camera: str) -> Bools:
    """The masked patches of a camera's frames, shape (rows, cols), by its first readable frame."""
    with suppress(ToktError):  # no frame can be read, or it is too small for this grid
        if masks.of(camera) is not None:
            width, height = shown_size(mission, camera)
            return masks.patches(camera, grid, height, width)
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
        Width and height of the camera's frames.

    Raises
    ------
    ToktError
        If too little of the view is left.
    """
    height, width = grid.resized(size[1], size[0])
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
    boxes = (*kept, *boxes_of(pixels))
    return ViewMask(boxes) if boxes else None
