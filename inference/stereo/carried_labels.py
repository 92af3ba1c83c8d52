"""Labels of the left frame's patches carried to the right frame, where a patch is found again."""

from collections.abc import Collection, Sequence

import cv2
import numpy as np

from tokt.features.common.arrays import F32, F64, I64, U8
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid

from .calibration import StereoCalibration
from .matching import disparity_range
from .rectify import Rectifier, rectified

_BLUR_PX = 1.5  # of the views, against noise, which no two cameras share
_AROUND_PX = 8  # of the views; what stands beside a patch tells it from its like
_MIN_PX = 20
_LIKE = 0.6  # correlation from which a patch is found
_LEAD = 0.05  # over any place further than `_SAME_PX` from it
_SAME_PX = 12
_BACK_PX = 3  # between a patch and where its place in the other view leads back to
_POINTS = 16  # across a patch, and down it, at which it is asked what lies there
_MIN_SHARE = 0.5  # of a right patch, from which it has the label that lies there


class LabelCarrier:
    """Carries a left frame's labels to the right frame of the same moment.

    A patch is looked for in the right view, from `matching.NEAREST_M` on: by normalised
    correlation, and only where the way back leads to it. Clear is not looked for: the right camera
    may see what is hidden from the left one, or beside its view, and open water is like itself.
    `sure_clear` tells which right patches can show nothing but clear ones.

    Raises ToktError if the calibration cannot be used for frames, or the grid for frames of its
    size.
    """

    def __init__(self, calibration: StereoCalibration, grid: Grid) -> None:
        self._views = views = Rectifier(calibration)
        self._reach = sum(disparity_range(views))  # pixels that a thing is further left at most
        width, height = self._frame_size = calibration.frame_size
        high, wide = grid.resized(height, width)
        y0, y1, x0, x1 = grid.boxes(high, wide).T / [[high], [high], [wide], [wide]]
        ends = np.stack([x0, x1]) * width - 0.5, np.stack([y0, y1]) * height - 0.5
        share = (np.arange(_POINTS) + 0.5) / _POINTS
        sides = views.rotations[1], views.projections[1]
        points = rectified(_points(*ends, share), calibration.K2, calibration.D2, *sides)
        self._places: F32 = points.reshape(grid.n_patches, -1, 2).astype(np.float32)
        corners = views.from_frame(_points(*ends, np.array([0.0, 1.0])))
        corners = corners.reshape(grid.n_patches, -1, 2)
        self._boxes = np.hstack([np.floor(corners.min(1)), np.ceil(corners.max(1))]).astype(int)

    def carry(
        self, left: U8, right: U8, labels: Sequence[str | None], clear: Collection[str]
    ) -> list[str | None]:
        """The right frame's labels, patch by patch; None where nothing can be said.

        Parameters
        ----------
        left, right : array of uint8, shape (height, width) or (height, width, 3)
            The frames of one moment.
        labels : sequence of str or None
            Of the left frame's patches.
        clear : collection of str
            The labels that are no obstacle, and are not carried.

        Raises
        ------
        ToktError
            If a frame is of another size than the calibration.
        """
        for frame in (left, right):
            if frame.shape[1::-1] != self._frame_size:
                (width, height), (wide, high) = self._frame_size, frame.shape[1::-1]
                raise ToktError(f"the calibration is for {width}x{height}, not {wide}x{high}")
        views = self._views.left(left), self._views.right(right)
        even = [np.asarray(cv2.GaussianBlur(view, (0, 0), _BLUR_PX), np.float32) for view in views]
        names = [None, *sorted({label for label in labels if label and label not in clear})]
        found = []
        for box, label in zip(self._boxes, labels, strict=True):
            if label in names[1:] and (shift := self._shift(even, box)) is not None:
                found.append((shift, *box.clip(0), names.index(label)))
        painted = np.zeros(views[1].shape, np.int16)
        for shift, x0, y0, x1, y1, code in sorted(found):  # the nearest hides what is behind it
            painted[y0:y1, max(x0 - shift, 0) : max(x1 - shift, 0)] = code
        x, y = self._places[..., 0], self._places[..., 1]
        asked = cv2.remap(painted, x, y, cv2.INTER_NEAREST, borderValue=0)
        shares = np.stack([(asked == code).mean(axis=1) for code in range(len(names))], axis=1)
        shares[:, 0] = _MIN_SHARE
        return [names[int(code)] for code in shares.argmax(axis=1)]

    def sure_clear(self, labels: Sequence[str | None], clear: Collection[str]) -> list[bool]:
        """Which right patches, by labels as in `carry`, can show nothing but clear left ones."""
        start, end = self._places.min(axis=1), self._places.max(axis=1) + np.array([self._reach, 0])
        x, y = np.stack([start, end]).transpose(2, 0, 1).astype(np.float64)
        corners = _points(x, y, np.array([0.0, 1.0]))
        there = self._views.to_frame(corners).reshape(len(start), -1, 2) + 0.5
        inside = ((there >= 0) & (there <= self._frame_size)).all(axis=(1, 2))
        seen = (self._boxes[:, :2] < end[:, None]) & (self._boxes[:, 2:] > start[:, None])
        other = np.array([label not in clear for label in labels])
        return [bool(sure) for sure in inside & ~(seen.all(axis=2) & other).any(axis=1)]

    def _shift(self, views: list[F32], box: I64) -> int | None:
        """How many pixels further left a patch of the left view lies in the right one."""
        around = box + np.array([-_AROUND_PX, -_AROUND_PX, _AROUND_PX, _AROUND_PX])
        shift = self._moved(views[0], views[1], around, to_left=True)
        if shift is None:
            return None
        there = around - np.array([shift, 0, shift, 0])
        back = self._moved(views[1], views[0], there, to_left=False)
        return shift if back is not None and abs(back - shift) <= _BACK_PX else None

    def _moved(self, view: F32, other: F32, box: I64, *, to_left: bool) -> int | None:
        """By how many pixels what is in a box of one view is moved in the other; None if unsure."""
        height, width = view.shape
        x0, y0, x1, y1 = box.clip(0, [width, height, width, height])
        if min(x1 - x0, y1 - y0) < _MIN_PX:
            return None
        start, end = (x0 - self._reach, x1) if to_left else (x0, x1 + self._reach)
        start = max(start, 0)
        strip = other[max(y0 - 1, 0) : y1 + 1, start:end]
        like = cv2.matchTemplate(strip, view[y0:y1, x0:x1], cv2.TM_CCOEFF_NORMED).max(axis=0)
        at = int(like.argmax())
        others = like[np.abs(np.arange(len(like)) - at) > _SAME_PX]
        sure = like[at] >= max(_LIKE, others.max(initial=-1) + _LEAD)  # not where it is no number
        return abs(int(start + at - x0)) if sure and 0 < at < len(like) - 1 else None


def _points(x: F64, y: F64, share: F64) -> F64:
    """Points of patches at these shares of their sides, row by row, shape (n * shares², 2)."""
    across = x[0, :, None, None] + share * (x[1] - x[0])[:, None, None]
    down = y[0, :, None, None] + share[:, None] * (y[1] - y[0])[:, None, None]
    return np.stack(np.broadcast_arrays(across, down), axis=-1).reshape(-1, 2)
