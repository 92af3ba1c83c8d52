"""A detector's answer, and from its mask to a verdict: an obstacle, where, which way to steer.

The centre, the box, the mean value and the status follow L. S. Brusletto (NTNU 2016), with the
corrections: Ypos comes from the centre's y, the box is the union of the
contours' boxes, and contours of zero area have no weight instead of dividing by zero.

::

    0,0 ------------------- width      a mask pixel is 255 where an obstacle was seen
     |        .                        .  frame centre (width // 2, height // 2)
     |      .....  o (cx, cy)          o  centre of what was seen
     |        .                        x = -(cx - width // 2)   negative: steer left,
    height                             y = -(cy - height // 2)  away from the obstacle
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F64, I64, U8
from tokt.features.frames.grid import Grid
from tokt.models import operating_point

from .frame import Frame
from .reason import NO_FAULT, Fault, Reason
from .sight import SightMap

TEXTURE, DISPARITY, PUSHBROOM = "texture", "disparity", "pushbroom"

ClassPatches = Mapping[str, tuple[int, ...]]
"""For each class seen its patches, numbered row by row: obstacles first, then the largest."""


@dataclass(frozen=True)
class Detection:
    """One detector's answer on one frame: a mask, or why there is none."""

    # Of the left frame resized to the grid's width, shape (height, width): 255 where an obstacle
    # was seen. None when the detector could not judge the frame.
    mask: U8 | None
    method: str
    model: str | None = None  # ``name/version`` of the model used, if there is one
    # As in `Verdict`, if the detector measures them.
    distance_m: float | None = None
    closing_m_s: float | None = None
    contact_s: float | None = None
    decision_values: F64 | None = None  # shape (n_patches, n_outputs): less the boundary
    features: F64 | None = None  # shape (n_patches, dim): what the decision values come from
    counts: I64 | None = None  # `bin_counts` of the features, where the model knows its training's
    boundary: float | None = None  # where water ended, where that moves (`tokt.models.water`)
    grid: Grid | None = None  # of the patches that the mask is painted from, where it is
    class_patches: ClassPatches | None = None  # of a model of several classes, this frame's alone
    fault: Fault = NO_FAULT  # why the frame could not be judged; empty when it was
    # Whether the fault is itself a sign that something may be there, such as two views that do not
    # fit together, and not merely the lack of a picture or of a detector. No other detector's
    # *clear* stands against it.
    vetoes_clear: bool = False
    note: str = ""  # what else the pilot should know about a frame that was judged
    sight: SightMap | None = None  # what was seen of the left frame, where it was looked at


class Detector(Protocol):
    """Something that judges frames."""

    @property
    def method(self) -> str:
        """``"texture"``, ``"disparity"`` or ``"pushbroom"``."""

    def detect(self, frame: Frame) -> Detection:
        """Judge one frame; may raise, and is guarded for that by the policy that calls it."""


OBSTACLE, CLEAR, UNKNOWN = operating_point.OBSTACLE, operating_point.CLEAR, operating_point.UNKNOWN
STATUS_WORDS = {OBSTACLE: "obstacle", CLEAR: "clear", UNKNOWN: "unknown"}

STATUS_MEAN_THRESHOLD = 0.345
"""Mean grey level of the 0/255 mask above which the status is 1. Source: the thesis's program;
one patch of a 10x10 grid (mean about 2.5) is far above it."""

HEALTHY = "ok"
WITHOUT = "without "
"""Beginning of what a health text says of a part of the run that is not working."""


def status_table(counts: Counter[tuple[int, int]]) -> dict[str, dict[str, int]]:
    """Frames counted by two statuses: by the first, then by the second, in words."""
    return {
        word: {other: counts[one, two] for two, other in STATUS_WORDS.items()}
        for one, word in STATUS_WORDS.items()
    }


Box = tuple[int, int, int, int]  # x0, y0, width, height


@dataclass(frozen=True)
class Verdict:
    """What the runtime says about one frame; None is what is not known."""

    status: int  # 1 obstacle, 0 clear, or -1 unknown: no detector could judge the frame
    # Direction to steer (not where the obstacle is), in pixels of the mask; 0, 0 when there is
    # nothing to steer from.
    x: int | None
    y: int | None
    box: Box | None  # around everything seen, in pixels of the mask; None when there is nothing
    mean: float | None  # grey level of the 0/255 mask, 0..255
    distance_m: float | None  # in metres to the nearest part, where a detector measures it
    method: str  # ``"texture"``, ``"disparity"``, ``"pushbroom"``, two joined by ``+``, ``"none"``
    model: str | None  # ``name/version`` of the model that judged the frame, if one did
    health: str = HEALTHY  # ``"ok"``, or what is not as it should be, in words
    closing_m_s: float | None = None  # by which the distance falls, negative where it grows
    contact_s: float | None = None  # until the distance is 0 at that speed, if it falls
    # The first thing that is not as it should be: why a verdict is unknown, or what one that stands
    # had to do without.
    reason: Reason = Reason.OK
    mask_size: tuple[int, int] | None = None  # height, width of the mask of `x`, `y` and `box`
    trend: str | None = None  # of the mean over the last seconds: growing, steady or shrinking
    trend_confidence: float | None = None  # how sure that is, 0.5..1
    # By `tokt.inference.policy.temporal_cues`: seconds until what is seen is reached, from how the
    # mean grows, and how far it is from where it is to be held.
    expansion_contact_s: float | None = None
    anchor_x: float | None = None
    anchor_y: float | None = None
    anchor_size: float | None = None
    # By class: x0, y0, width and height in pixels of the mask, and the share of it; None where no
    # model of several classes judged.
    classes: Mapping[str, tuple[float, ...]] | None = None
    moving: float | None = None  # share of the view that moving things cover, 0..1
    # Of an object that somebody named: held, searching or lost (`policy.object_tracker`).
    anchor: str | None = None
    # Of the left view: ``seen``, the part of it, 0..1; ``blind``, the box around the largest group
    # of patches that are not, as parts of its width and height, if there is one; ``masked``, the
    # part of it that is no view, if there is any.
    sight: Mapping[str, tuple[float, ...]] | None = None


def health_of(*words: str) -> str:
    """The health text: what is not as it should be, joined by semicolons; `HEALTHY` if nothing."""
    return "; ".join(part for part in words if part not in ("", HEALTHY)) or HEALTHY


def unknown_verdict(fault: Fault) -> Verdict:
    """The verdict on a frame that nothing could judge, and why."""
    return Verdict(
        UNKNOWN, None, None, None, None, None, "none", None, str(fault), reason=fault.reason
    )


def verdict_from_mask(
    mask: U8,
    method: str,
    model: str | None = None,
    distance_m: float | None = None,
    health: str = HEALTHY,
) -> Verdict:
    """Judge a mask of shape (height, width), 255 where an obstacle was seen and 0 elsewhere.

    Status 1 when the mask's mean exceeds `STATUS_MEAN_THRESHOLD`, otherwise 0. An empty mask has
    no centre, and x = y = 0: nothing asks for steering. (The thesis's program keeps its initial
    centre (0, 0) there, and so sends the way from the frame's corner.) The rest as in `Verdict`.
    """
    height, width = mask.shape
    mean = float(cv2.mean(mask)[0])
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    status = OBSTACLE if mean > STATUS_MEAN_THRESHOLD else CLEAR
    x = y = 0
    box = None
    if contours:
        cx, cy = _centre(contours, mask)
        x, y = -(cx - width // 2), -(cy - height // 2)
        x0, y0, box_width, box_height = cv2.boundingRect(mask)  # of all contours
        box = x0, y0, box_width, box_height
    return Verdict(
        status, x, y, box, mean, distance_m, method, model, health, mask_size=(height, width)
    )


def class_boxes(
    patches: ClassPatches, grid: Grid, height: int, width: int
) -> dict[str, tuple[float, ...]]:
    """For each class the box around its patches in a mask, and their share; as in `Verdict`."""
    boxes = grid.boxes(height, width)
    found: dict[str, tuple[float, ...]] = {}
    for name, cells in patches.items():
        y0, y1, x0, x1 = boxes[list(cells)].T
        share = float(((y1 - y0) * (x1 - x0)).sum()) / (height * width)
        left, top = int(x0.min()), int(y0.min())
        found[name] = (left, top, int(x1.max()) - left, int(y1.max()) - top, round(share, 3))
    return found


def _centre(contours: Sequence[NDArray[Any]], mask: U8) -> tuple[int, int]:
    """Area-weighted mean of the contours' rounded centroids, cut to whole pixels."""
    weighted_x = weighted_y = total = 0.0
    for contour in contours:
        area = cv2.contourArea(contour)
        if area == 0:
            continue
        moments = cv2.moments(contour)
        weighted_x += area * round(moments["m10"] / moments["m00"])
        weighted_y += area * round(moments["m01"] / moments["m00"])
        total += area
    if total == 0:
        # Single pixels and lines one pixel wide enclose no area, yet they are somewhere.
        rows, columns = np.nonzero(mask)
        return int(columns.mean()), int(rows.mean())
    return int(weighted_x / total), int(weighted_y / total)
