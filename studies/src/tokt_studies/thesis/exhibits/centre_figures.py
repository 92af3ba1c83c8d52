"""Figures 3.22 to 3.24: contours, centre and box of a mask, the thesis's beside the corrected."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.inference.verdict import OBSTACLE, Box, Verdict, verdict_from_mask
from tokt_studies.baselines import thesis_centre as centres
from tokt_studies.baselines.thesis_stereo import LEFT_CAMERA, cropped, undistorted
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.simulation.rendering.patch_labels import coverage
from tokt_studies.simulation.scene.rig import FULL_WIDTH
from tokt_studies.thesis.light_scene import BLUE, LitScene
from tokt_studies.thesis.methods.curves import THESIS

from . import frame_drawing as drawing
from .disparity_figures import at_thesis_size, thesis_map
from .dot_figures import by_thesis
from .exhibit import Claim, ClaimAgreement, Exhibit, Plot, StudyContext

SCENES = (1, 2, 3)  # seeds of the rendered pairs
_SOME, _MOSTLY = 0.1, 0.5
"""Parts of the masks, and of a patch."""


@dataclass(frozen=True)
class BothWays:
    """One 0/255 mask of a method (`title`) and frame by the thesis's way and by the corrected."""

    title: str
    number: int
    mask: U8
    thesis: centres.ThesisCentre
    corrected: Verdict

    @property
    def boxes(self) -> tuple[Box, Box]:
        """The thesis's and the corrected one, without an extent where nothing is seen."""
        return self.thesis.box or (0, 0, 0, 0), self.corrected.box or (0, 0, 0, 0)

    @property
    def thesis_leaves(self) -> bool:
        """Whether the thesis's box reaches beyond the frame."""
        return centres.leaves_frame(self.boxes[0], *self.mask.shape)

    @property
    def thesis_misses(self) -> bool:
        """Whether a part of what was seen is outside of the thesis's box."""
        (left, top, width, height), (x0, y0, w, h) = self.boxes
        return left > x0 or top > y0 or left + width < x0 + w or top + height < y0 + h

    @property
    def box_ratio(self) -> float:
        """Area of the thesis's box over that of the corrected one."""
        mine, right = self.boxes
        return mine[2] * mine[3] / (right[2] * right[3])


def both_ways(mask: U8, title: str = "", number: int = 0) -> BothWays:
    """A mask of uint8 0/255, shape (height, width), by the thesis's way and by the corrected."""
    return BothWays(
        title, number, mask, centres.thesis_centre(mask), verdict_from_mask(mask, "mask")
    )


def centre_and_box(context: StudyContext) -> Exhibit:
    """Contours, centre and box of masks, with the thesis's faults beside (figures 3.22 to 3.24)."""
    number = context.structure_frame
    frame = context.picture(number)
    shown = [
        both_ways(one.mask, one.title, number)
        for one in by_thesis(context, frame)
        if one.mask is not None and one.mask.any()
    ]
    if not shown:
        raise ToktError(
            f"no method sees anything in frame {number}, which should show the structure"
        )
    mission = _mission(context)
    caption = (
        f"Frame {number}: the mask with its contours (3.22), the two centres and where each says "
        "to steer (3.23), and the two boxes (3.24). Where the thesis's box leaves the frame, the "
        "panel grows with it. Last: of frames with several contours the one whose box is largest "
        f"beside the union. {drawing.SHOWN}"
    )
    return Exhibit(
        (
            "The thesis's way is that of its published program, which looks for outer contours "
            "after a dilation by 5x5 pixels. Corrected, as tokt sends it: no dilation, Ypos from "
            "the centre's y, the box is the union of the contours' boxes. The thesis divides by "
            "each contour's area, and prints no guard against one of none.",
            f"The mission's figures are of the {len(mission)} frames and methods in which the "
            "thesis's method says obstacle. None is of an image it learnt from.",
        ),
        (box_claim(mission), fineness_claim(fitting_the_exact_mask())),
        plots=(
            Plot("contours-centre-box", caption, drawing.png_of(_figure(context, shown, mission))),
        ),
    )


def _mission(context: StudyContext) -> list[BothWays]:
    """Every frame with status 1 of the thesis's grid methods, by both ways."""
    curves = context.curves
    size = GRID.resized(*context.picture(context.structure_frame).shape[:2])
    every = [
        both_ways(GRID.paint(patches, *size), context.thesis[name].title, number)
        for name in curves.named(THESIS)
        for number, patches in curves.patches.get(name, {}).items()
    ]
    return [one for one in every if one.corrected.status == OBSTACLE]


def box_claim(every: Sequence[BothWays]) -> Claim:
    """Whether the thesis's box, whose sizes are sums, is around what was seen."""
    claim = Claim.about(
        "the box is around the obstacle",
        "figure 3.24: its size is the sum of the contours' widths, and of their heights",
    )
    if not every:
        return claim("not measured", "the thesis's methods see nothing")
    leaves = sum(one.thesis_leaves for one in every)
    misses = sum(one.thesis_misses for one in every)
    ratios = [one.box_ratio for one in every]
    few = max(leaves, misses) <= _SOME * len(every)
    return claim(
        f"area over the boxes' union: {np.median(ratios):.1f} (median), {max(ratios):.1f} at "
        f"most. Of {len(every)} boxes {leaves} leave the frame, {misses} miss a part",
        f"to agree: none does; in part: {_SOME:.0%} at most",
        agreement=ClaimAgreement.of(leaves == misses == 0, few),
    )


def fitting_the_exact_mask() -> list[list[float]]:
    """Overlap with what is there, of the thesis's disparity mask and of blocks, a rendered pair.

    The blocks are those covered by half: no method's, but the best that blocks can do.
    """
    found = []
    for seed in SCENES:
        pair = LitScene(FULL_WIDTH, seed).at(BLUE)
        left, right, exact = (np.asarray(one) for one in (pair.left, pair.right, pair.mask))
        blocks = GRID.paint(coverage(exact >= 128, GRID) >= _MOSTLY, *exact.shape)
        there, covered = (
            cropped(undistorted(at_thesis_size(one), LEFT_CAMERA)) >= 128 for one in (exact, blocks)
        )
        mask = centres.dilated(centres.dilated(cropped(thesis_map(left, right)))) > 0
        found.append([(one & there).sum() / (one | there).sum() for one in (mask, covered)])
    return found


def fineness_claim(fitting: Sequence[Sequence[float]]) -> Claim:
    """Whether the thesis's disparity mask is finer than a mask of blocks can be."""
    claim = Claim.about("the disparity mask is finer than the block mask", "figures 3.21 to 3.24")
    finer = [mask > blocks for mask, blocks in fitting]
    mask, blocks = np.mean(fitting, axis=0)
    return claim(
        f"overlap with the exact mask in {len(fitting)} rendered pairs, white in both of that in "
        f"either: {mask:.0%}; of the best blocks {blocks:.0%}",
        "to agree: more than the blocks in all; in part: in some. Labels by patch cannot tell",
        agreement=ClaimAgreement.of(all(finer), any(finer)),
    )


def _figure(
    context: StudyContext, shown: Sequence[BothWays], mission: Sequence[BothWays]
) -> Figure:
    """A row a mask; last the mission's whose box by the thesis's way is farthest out."""
    panels = {one.title: one for one in shown}
    several = [one for one in mission if one.thesis.contours > 1]
    if several:
        worst = max(several, key=lambda one: one.box_ratio)
        panels[f"{worst.title}, frame {worst.number}"] = worst
    figure, rows = drawing.new_figure(11.5, 3.0 * len(panels) + 0.4, len(panels), 3, squeeze=False)
    for (outlines, centre, boxes), (title, one) in zip(rows, panels.items(), strict=True):
        _draw_contours(outlines, one.mask)
        outlines.set_ylabel(title, fontsize=9)
        frame = context.picture(one.number)
        drawing.show_frame(centre, frame)
        _draw_centres(centre, one)
        drawing.show_frame(boxes, frame)
        drawing.draw_box(boxes, one.thesis.box, drawing.THESIS_COLOR, "--")
        drawing.draw_box(boxes, one.corrected.box, drawing.CORRECTED_COLOR)
    for axes, title in zip(rows[0], ("contours", "centre, way to steer", "box"), strict=True):
        axes.set_title(title, fontsize=10)
    handles = [
        Line2D([], [], color=drawing.THESIS_COLOR, marker="o", ls="--", label="thesis's program"),
        Line2D([], [], color=drawing.CORRECTED_COLOR, marker="o", label="corrected"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    return figure


def _draw_contours(axes: Any, mask: U8) -> None:
    drawing.show_mask(axes, np.asarray(mask // 2, np.uint8))
    for drawn, color, style in (
        (centres.dilated(mask), drawing.THESIS_COLOR, "--"),
        (mask, drawing.CORRECTED_COLOR, "-"),
    ):
        for contour in centres.outer_contours(drawn):
            closed = np.vstack([contour[:, 0], contour[:1, 0]])
            axes.plot(closed[:, 0], closed[:, 1], color=color, ls=style, lw=1.2)


def _draw_centres(axes: Any, both: BothWays) -> None:
    """Each centre, and an arrow from the frame's middle along (Xpos, Ypos)."""
    y0, x0 = (size // 2 for size in both.mask.shape)
    axes.plot(x0, y0, "+", color="white", ms=10)
    corrected = both.corrected
    x, y = int(corrected.x or 0), int(corrected.y or 0)
    for cx, cy, dx, dy, color, size in (
        (both.thesis.cx, both.thesis.cy, both.thesis.x, both.thesis.y, drawing.THESIS_COLOR, 11),
        (x0 - x, y0 - y, x, y, drawing.CORRECTED_COLOR, 6),
    ):
        axes.plot(cx, cy, "o", color=color, ms=size)
        axes.annotate(
            "", (x0 + dx, y0 + dy), (x0, y0), annotation_clip=False,
            arrowprops={"arrowstyle": "->", "color": color, "lw": 2},
        )  # fmt: skip
