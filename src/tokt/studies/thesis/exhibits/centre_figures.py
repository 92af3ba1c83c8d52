"""Figures 3.22 to 3.24: contours, centre and box of a mask, the thesis's beside the corrected."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from tokt.inference.verdict import OBSTACLE, Verdict, verdict_from_mask
from tokt.studies.baselines.thesis_centre import (
    ThesisCentre,
    dilated,
    leaves_frame,
    outer_contours,
    thesis_centre,
    without_area,
)
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.context import StudyContext
from tokt.studies.thesis.exhibit import Claim, ClaimAgreement, Exhibit, Plot, Table
from tokt.studies.thesis.frame_drawing import (
    CORRECTED_COLOR,
    SHOWN,
    THESIS_COLOR,
    draw_box,
    png_of,
    show_frame,
    show_mask,
)
from tokt.studies.thesis.methods.curves import THESIS

from .picture_predictions import MethodPrediction, by_held_out, by_stereo, by_thesis

_SOURCE = "the published program"


@dataclass(frozen=True)
class _Both:
    """One mask by both ways."""

    thesis: ThesisCentre
    corrected: Verdict
    height: int
    width: int
    without_area: int

    @property
    def thesis_leaves(self) -> bool:
        """Whether the thesis's box reaches beyond the frame."""
        box = self.thesis.box
        return box is not None and leaves_frame(box, self.height, self.width)

    @property
    def thesis_misses(self) -> bool:
        """Whether a part of what was seen is outside of the thesis's box."""
        mine, right = self.thesis.box, self.corrected.box
        if mine is None or right is None:
            return False
        starts_after = mine[0] > right[0] or mine[1] > right[1]
        ends = [(box[0] + box[2], box[1] + box[3]) for box in (mine, right)]
        return starts_after or ends[0][0] < ends[1][0] or ends[0][1] < ends[1][1]

    @property
    def ypos_off(self) -> int:
        """Ypos of the thesis's program less the corrected one, in pixels."""
        return self.thesis.y - int(self.corrected.y or 0)

    @property
    def ypos_opposite(self) -> bool:
        """Whether the two say up and down."""
        return self.thesis.y * int(self.corrected.y or 0) < 0

    @property
    def box_ratio(self) -> float:
        """Area of the thesis's box over that of the corrected one."""
        mine, right = self.thesis.box, self.corrected.box
        if mine is None or right is None:
            return float("nan")
        return mine[2] * mine[3] / (right[2] * right[3])


def both_ways(mask: NDArray[np.uint8]) -> _Both:
    """A mask of uint8 0/255, shape (height, width), by the thesis's way and by the corrected."""
    corrected = verdict_from_mask(mask, "mask")
    empty = without_area(outer_contours(mask))
    return _Both(thesis_centre(mask), corrected, mask.shape[0], mask.shape[1], empty)


def centre_and_box(context: StudyContext) -> Exhibit:
    """Contours, centre and box of masks, with the thesis's faults beside (figures 3.22 to 3.24).

    Raises
    ------
    ToktError
        If the frame cannot be read.
    """
    number = context.structure_frame
    frame = context.left(number)
    stereo = by_stereo(context.calibration, frame, context.right(number), context.calibration_words)
    masks = [*by_thesis(context, frame), *by_held_out(context, number, frame), stereo]
    shown = [one for one in masks if one.mask is not None and one.mask.any()]
    if not shown:
        return Exhibit(
            "figure-3.22-3.24",
            "Contours, centre and box",
            "thesis chapter 3, figures 3.22 to 3.24",
            missing=f"no method sees anything in frame {number}, which should show the structure",
        )
    ways = {one.name: both_ways(one.mask) for one in shown if one.mask is not None}
    mission = _mission(context)
    return Exhibit(
        "figure-3.22-3.24",
        "Contours, centre and box of a mask: the thesis's, and corrected",
        "thesis chapter 3, figures 3.22 to 3.24",
        (
            "The thesis's way is that of its published program, which looks for outer contours "
            "after a dilation by 5x5 pixels. Corrected, as tokt sends it: no dilation, Ypos from "
            "the centre's y, the box is the union of the contours' boxes.",
            "The mission's figures are of every frame in which the thesis's method says obstacle "
            f"({len(mission)} frames and methods); none is of an image it learnt from.",
        ),
        _claims(mission),
        (
            Table("frame", f"Frame {number}: positions in pixels at the grid's width; Xpos and "
                  "Ypos are the direction to steer, positive right and down.",
                  _frame_table(shown, ways), "This frame"),
            Table("mission", "All frames with status 1, by the thesis's texture methods.",
                  _mission_table(context, mission), "The whole mission"),
        ),
        (
            Plot(
                "contours-centre-box",
                f"Frame {number}: the mask with its contours (3.22), the two centres and where "
                "each says to steer (3.23), and the two boxes (3.24; where the thesis's leaves the "
                "frame the panel grows with it). Last, the mission's frame with several contours "
                f"in which the thesis's box is largest beside the union. {SHOWN}",
                png_of(_figure(_panels(context, shown, ways, mission))),
            ),
        ),
        _numbers(number, mission),
    )  # fmt: skip


@dataclass(frozen=True)
class _Row:
    """One frame by one method."""

    number: int
    method: str
    mask: NDArray[np.uint8]
    both: _Both


@dataclass(frozen=True)
class _Panel:
    """A row of the figure."""

    title: str
    frame: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    both: _Both


def _mission(context: StudyContext) -> list[_Row]:
    """Every frame with status 1 of the thesis's grid methods, by both ways."""
    curves = context.curves
    size = GRID.resized(*context.left(context.structure_frame).shape[:2])
    found = []
    for name in curves.named(THESIS):
        for number, patches in curves.patches.get(name, {}).items():
            mask = GRID.paint(patches, *size)
            both = both_ways(mask)
            if both.corrected.status == OBSTACLE:
                found.append(_Row(number, name, mask, both))
    return found


def _panels(
    context: StudyContext,
    shown: list[MethodPrediction],
    ways: dict[str, _Both],
    mission: list[_Row],
) -> list[_Panel]:
    """The frame's masks, and the mission's frame whose box by the thesis's way is farthest out."""
    frame = context.left(context.structure_frame)
    panels = [
        _Panel(one.title, frame, one.mask, ways[one.name]) for one in shown if one.mask is not None
    ]
    several = [row for row in mission if row.both.thesis.contours > 1]
    if several:
        worst = max(several, key=lambda row: row.both.box_ratio)
        title = f"{context.thesis[worst.method].title}, frame {worst.number}"
        panels.append(_Panel(title, context.left(worst.number), worst.mask, worst.both))
    return panels


def _share(flags: Iterable[bool]) -> str:
    values = list(flags)
    return f"{sum(values)} of {len(values)}"


def _claims(mission: list[_Row]) -> tuple[Claim, ...]:
    every = [row.both for row in mission]
    if not every:
        return ()
    off = [abs(one.ypos_off) for one in every]
    ratio = [one.box_ratio for one in every]
    opposite, leaves = [one.ypos_opposite for one in every], [one.thesis_leaves for one in every]
    misses = [one.thesis_misses for one in every]
    return (
        Claim(
            "Ypos says how far above or below the centre to steer",
            f"Ypos is computed from the centre's x ({_SOURCE})",
            f"off by {np.median(off):.0f} px in the median, {max(off)} px at most; up for down in "
            f"{_share(opposite)} frames with an obstacle",
            ClaimAgreement.NO if any(off) else ClaimAgreement.YES,
            "Held against Ypos from the centre's y of the same masks.",
        ),
        Claim(
            "the box is around the obstacle",
            f"its size is the sum of the contours' widths and of their heights ({_SOURCE})",
            f"{np.median(ratio):.1f} times the area of the union of the boxes in the median, "
            f"{max(ratio):.1f} times at most; leaves the frame in {_share(leaves)}, misses a part "
            f"of what was seen in {_share(misses)}",
            ClaimAgreement.NO if any(leaves) or any(misses) else ClaimAgreement.PARTLY,
            "With one contour the two are the same but for the dilation's two pixels; with "
            "several the sum is larger than what they span, or smaller.",
        ),
        Claim(
            "contours of zero area divide by zero, and no datagram is sent",
            f"divided by each contour's area, in a try with an empty except ({_SOURCE})",
            f"{sum(one.without_area for one in every)} such contours in these masks, and none "
            "after the program's dilation",
            ClaimAgreement.UNCOMPARABLE,
            "Masks of whole patches have no such contours, and the version read dilates first; "
            "disparity maps and other versions of the program may.",
        ),
    )


def _frame_table(shown: list[MethodPrediction], ways: dict[str, _Both]) -> pd.DataFrame:
    rows = []
    for one in shown:
        both = ways[one.name]
        thesis, right = both.thesis, both.corrected
        rows.append(
            {
                "mask of": one.title,
                "contours": thesis.contours,
                "Xpos thesis": thesis.x,
                "Xpos": right.x,
                "Ypos thesis": thesis.y,
                "Ypos": right.y,
                "box thesis (x, y, width, height)": str(thesis.box),
                "box": str(right.box),
                "thesis's box leaves the frame": both.thesis_leaves,
            }
        )
    return pd.DataFrame(rows)


def _mission_table(context: StudyContext, mission: list[_Row]) -> pd.DataFrame:
    rows = []
    for name in dict.fromkeys(row.method for row in mission):
        every = [row.both for row in mission if row.method == name]
        rows.append(
            {
                "method": context.thesis[name].title,
                "frames with status 1": len(every),
                "with several contours": sum(one.thesis.contours > 1 for one in every),
                "Ypos off, median px": float(np.median([abs(one.ypos_off) for one in every])),
                "Ypos up for down": sum(one.ypos_opposite for one in every),
                "box leaves the frame": sum(one.thesis_leaves for one in every),
                "box misses a part": sum(one.thesis_misses for one in every),
                "box area, times the union, median": float(
                    np.median([one.box_ratio for one in every])
                ),
            }
        )
    return pd.DataFrame(rows)


def _numbers(number: int, mission: list[_Row]) -> dict[str, float | int | str | bool]:
    every = [row.both for row in mission]
    numbers: dict[str, float | int | str | bool] = {"frame": number, "masks": len(every)}
    if every:
        numbers |= {
            "ypos_off_median_px": float(np.median([abs(one.ypos_off) for one in every])),
            "ypos_opposite": sum(one.ypos_opposite for one in every),
            "box_leaves_frame": sum(one.thesis_leaves for one in every),
            "box_misses_a_part": sum(one.thesis_misses for one in every),
            "box_area_ratio_median": float(np.median([one.box_ratio for one in every])),
            "contours_without_area": sum(one.without_area for one in every),
        }
    return numbers


def _figure(panels: list[_Panel]) -> Figure:
    figure = Figure(figsize=(11.5, 3.0 * len(panels) + 0.4), layout="constrained")
    rows = figure.subplots(len(panels), 3, squeeze=False)
    for (outlines, centre, boxes), one in zip(rows, panels, strict=True):
        _draw_contours(outlines, one)
        show_frame(centre, one.frame, GRID)
        _draw_centres(centre, one.both)
        show_frame(boxes, one.frame, GRID)
        draw_box(boxes, one.both.thesis.box, THESIS_COLOR, "--")
        draw_box(boxes, one.both.corrected.box, CORRECTED_COLOR)
    for axes, title in zip(rows[0], ("contours", "centre, way to steer", "box"), strict=True):
        axes.set_title(title, fontsize=10)
    handles = [
        Line2D([], [], color=THESIS_COLOR, marker="o", ls="--", label="thesis's program"),
        Line2D([], [], color=CORRECTED_COLOR, marker="o", label="corrected"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    return figure


def _draw_contours(axes: Any, one: _Panel) -> None:
    show_mask(axes, np.asarray(one.mask // 2, np.uint8))
    for mask, color, style in (
        (dilated(one.mask), THESIS_COLOR, "--"),
        (one.mask, CORRECTED_COLOR, "-"),
    ):
        for contour in outer_contours(mask):
            closed = np.vstack([contour[:, 0], contour[:1, 0]])
            axes.plot(closed[:, 0], closed[:, 1], color=color, ls=style, lw=1.2)
    axes.set_ylabel(one.title, fontsize=9)


def _draw_centres(axes: Any, both: _Both) -> None:
    """Each centre, and an arrow from the frame's middle along (Xpos, Ypos)."""
    x0, y0 = both.width // 2, both.height // 2
    axes.plot(x0, y0, "+", color="white", ms=10)
    corrected = both.corrected
    x, y = int(corrected.x or 0), int(corrected.y or 0)
    for cx, cy, dx, dy, color, size in (
        (both.thesis.cx, both.thesis.cy, both.thesis.x, both.thesis.y, THESIS_COLOR, 11),
        (x0 - x, y0 - y, x, y, CORRECTED_COLOR, 6),
    ):
        axes.plot(cx, cy, "o", color=color, ms=size)
        axes.annotate(
            "", (x0 + dx, y0 + dy), (x0, y0), annotation_clip=False,
            arrowprops={"arrowstyle": "->", "color": color, "lw": 2},
        )  # fmt: skip
