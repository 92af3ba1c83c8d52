"""The grid of patches over a frame: sizes, boxes and cells, for any frame size."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import I64, U8
from tokt.features.common.errors import ToktError

_TEXT = re.compile(r"(\d{1,9})x(\d{1,9})(?:@(\d{1,9}|native))?")
_WIDEST = 10_000  # pixels; no camera here gives more, and a resize to more only fills memory
MAX_PICTURE = 100_000_000  # pixels; a thinner strip than any camera's would become more


@dataclass(frozen=True)
class Grid:
    """Rows x columns of equal patches over a frame resized to `width`.

    All patches have the same size, ``frame // cells`` in each direction, as in the thesis: a
    1360x1024 frame becomes 360x271 and its 10x10 patches are 36x27. Where the division leaves a
    remainder, here one row of pixels, that strip at the right or bottom edge belongs to no patch.
    It is always narrower than the number of patches.

    Parameters
    ----------
    rows, cols : int
        Number of patches down and across.
    width : int or None
        Width in pixels that frames are resized to. ``None`` leaves a frame as it is: ready-cut
        patches are frames of a 1x1 grid.
    """

    rows: int = 10
    cols: int = 10
    width: int | None = 360

    def __post_init__(self) -> None:
        if self.rows < 1 or self.cols < 1:
            raise ToktError(f"a grid needs at least one row and one column, not {self}")
        if self.width is not None and self.width < 3 * self.cols:
            raise ToktError(f"grid {self} has patches under 3 pixels wide")
        if self.width is not None and self.width > _WIDEST:
            raise ToktError(f"grid {self} is wider than {_WIDEST} pixels")

    @classmethod
    def parse(cls, text: str) -> Grid:
        """Read ``"10x10@360"``, ``"10x10"`` (width 360) or ``"1x1@native"``."""
        match = _TEXT.fullmatch(text.strip())
        if match is None:
            raise ToktError(f"not a grid: {text!r} (write ROWSxCOLS@WIDTH, for example 10x10@360)")
        width = match[3] or "360"
        return cls(int(match[1]), int(match[2]), None if width == "native" else int(width))

    def __str__(self) -> str:
        return f"{self.rows}x{self.cols}@{'native' if self.width is None else self.width}"

    @classmethod
    def from_json(cls, value: Any) -> Grid:
        """Read what `to_json` wrote.

        Raises
        ------
        ToktError
            If it is anything else.
        """
        if not isinstance(value, dict) or set(value) != {"rows", "cols", "width"}:
            raise ToktError("a grid is an object of rows, cols and width")
        if any(
            type(size) is not int for key, size in value.items() if (key, size) != ("width", None)
        ):
            raise ToktError("a grid's rows, cols and width are whole numbers")
        return cls(**value)

    def to_json(self) -> dict[str, int | None]:
        """Plain JSON form."""
        return {"rows": self.rows, "cols": self.cols, "width": self.width}

    @property
    def n_patches(self) -> int:
        """Number of patches in one frame."""
        return self.rows * self.cols

    def resized(self, frame_height: int, frame_width: int) -> tuple[int, int]:
        """Height and width in pixels of a frame after the resize (height rounded down)."""
        if self.width is None:
            return frame_height, frame_width
        return frame_height * self.width // frame_width, self.width

    def patch_size(self, height: int, width: int) -> tuple[int, int]:
        """Patch height and width in pixels in a *resized* frame of `height` x `width`.

        Raises
        ------
        ToktError
            If a patch would be smaller than 3x3 pixels, or the frame larger than any camera's.
        """
        if height * width > MAX_PICTURE:
            raise ToktError(f"a frame becomes {width}x{height} pixels in grid {self}: too many")
        size = height // self.rows, width // self.cols
        if min(size) < 3:
            raise ToktError(
                f"grid {self} on a {width}x{height} frame has {size[1]}x{size[0]} patches; "
                "the least is 3x3"
            )
        return size

    def boxes(self, height: int, width: int) -> I64:
        """Patches of a *resized* frame as ``(y0, y1, x0, x1)`` rows, row by row.

        Returns
        -------
        numpy.ndarray
            Shape (rows * cols, 4), half-open ranges in pixels.
        """
        patch_height, patch_width = self.patch_size(height, width)
        row, col = np.divmod(np.arange(self.n_patches), self.cols)
        y0, x0 = row * patch_height, col * patch_width
        return np.stack([y0, y0 + patch_height, x0, x0 + patch_width], axis=1)

    def remainder(self, height: int, width: int) -> tuple[int, int]:
        """Pixel rows and columns at the bottom and right edge that belong to no patch."""
        patch_height, patch_width = self.patch_size(height, width)
        return height - patch_height * self.rows, width - patch_width * self.cols

    def cells(self, image: NDArray[Any]) -> NDArray[Any]:
        """A resized gray frame as its patches: view of shape (rows * cols, height, width)."""
        patch_height, patch_width = self.patch_size(*image.shape[:2])
        covered = image[: patch_height * self.rows, : patch_width * self.cols]
        split = covered.reshape(self.rows, patch_height, self.cols, patch_width)
        return split.swapaxes(1, 2).reshape(self.n_patches, patch_height, patch_width)

    def contains(self, row: int, col: int) -> bool:
        """Whether (row, col) is a cell of this grid."""
        return 0 <= row < self.rows and 0 <= col < self.cols

    def paint(self, values: NDArray[Any], height: int, width: int) -> U8:
        """Mask of a resized frame, 255 where a patch's value is true.

        Parameters
        ----------
        values : array of bool, shape (rows * cols,)
        height, width : int
            Size of the resized frame in pixels.
        """
        patch_height, patch_width = self.patch_size(height, width)
        mask = np.zeros((height, width), np.uint8)
        blocks = np.asarray(values, bool).reshape(self.rows, self.cols).astype(np.uint8) * 255
        mask[: patch_height * self.rows, : patch_width * self.cols] = blocks.repeat(
            patch_height, 0
        ).repeat(patch_width, 1)
        return mask


DEFAULT_GRID = Grid()
