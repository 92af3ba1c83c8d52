"""Frames, masks and what was said of their patches, drawn for people."""

from typing import Any

import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from tokt.features.common.arrays import U8, Bools
from tokt.inference.verdict import Box
from tokt.training.evaluation.pictures import CONTRAST_METHOD, figure_png, raise_contrast
from tokt.training.evaluation.pictures import new_figure as new_figure
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.thesis.patch_scores import Truth

SHOWN = (
    "Frames are nearly black: what is shown, not what is judged, has its contrast raised "
    f"({CONTRAST_METHOD})."
)
"""Belongs in every caption of a picture with a frame in it."""

OTHER_COLOR, OCEAN_COLOR, LABEL_COLOR = "#ff4d3d", "#4da3ff", "#62e06a"
THESIS_COLOR, CORRECTED_COLOR = "#ff9f1c", "#28d7c4"
_DPI = 110


def png_of(figure: Figure) -> bytes:
    """A figure as a PNG file."""
    return figure_png(figure, _DPI)


def show_frame(axes: Any, frame: U8) -> tuple[int, int]:
    """Draw a decoded frame at the grid's width, contrast raised; return its height and width."""
    height, width = GRID.resized(*frame.shape[:2])
    # Twice the size: what the eye sees of the tower is finer than the grid's pixels.
    twice = raise_contrast(frame, 2 * width, 2 * height)
    axes.imshow(twice, extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    axes.set(xticks=[], yticks=[], xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    return height, width


def show_mask(axes: Any, mask: U8) -> None:
    """Draw a 0/255 mask."""
    axes.imshow(mask, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    axes.set(xticks=[], yticks=[])


def draw_grid(axes: Any, height: int, width: int) -> None:
    """Thin lines between the patches of a resized frame."""
    patch_height, patch_width = GRID.patch_size(height, width)
    right, bottom = GRID.cols * patch_width - 0.5, GRID.rows * patch_height - 0.5
    style = {"colors": "#ffffff50", "linewidths": 0.5}
    axes.hlines(np.arange(GRID.rows + 1) * patch_height - 0.5, -0.5, right, **style)
    axes.vlines(np.arange(GRID.cols + 1) * patch_width - 0.5, -0.5, bottom, **style)


def draw_dots(axes: Any, said: Bools, height: int, width: int) -> None:
    """A dot in the middle of each patch: red for *other*, blue for *ocean*."""
    boxes = GRID.boxes(height, width)
    x, y = boxes[:, 2:].mean(axis=1) - 0.5, boxes[:, :2].mean(axis=1) - 0.5
    for chosen, color, size in ((~said, OCEAN_COLOR, 9), (said, OTHER_COLOR, 22)):
        axes.scatter(x[chosen], y[chosen], s=size, c=color, linewidths=0)


def draw_truth(axes: Any, truth: Truth, height: int, width: int) -> None:
    """Green outlines around the patches that are an obstacle, dotted where nobody is sure."""
    boxes = GRID.boxes(height, width)
    for chosen, color, style in ((truth == 1, LABEL_COLOR, "-"), (truth < 0, "#c8c8c8", ":")):
        outlines = [
            Rectangle((x0 + 0.5, y0 + 0.5), x1 - x0 - 2, y1 - y0 - 2)
            for y0, y1, x0, x1 in boxes[chosen]
        ]
        axes.add_collection(
            PatchCollection(outlines, facecolor="none", edgecolor=color, linestyle=style, lw=1.0)
        )


def draw_box(axes: Any, box: Box | None, color: str, style: str = "-") -> None:
    """A box; where it leaves the frame, the panel grows with it."""
    if box is None:
        return
    x0, y0, w, h = box
    axes.add_patch(Rectangle((x0 - 0.5, y0 - 0.5), w, h, fill=False, ec=color, lw=2, ls=style))
    right, bottom = max(axes.get_xlim()[1], x0 + w + 2), max(axes.get_ylim()[0], y0 + h + 2)
    axes.set(xlim=(-0.5, right), ylim=(bottom, -0.5))


def explain_dots(axes: Any, labelled: bool, ncols: int = 2) -> None:
    """What the dots and outlines are, under a panel."""
    handles: list[Any] = [
        Line2D([], [], marker="o", ls="", color=OTHER_COLOR, label="other (obstacle)"),
        Line2D([], [], marker="o", ls="", ms=4, color=OCEAN_COLOR, label="ocean"),
    ]
    if labelled:
        handles += [
            Rectangle((0, 0), 1, 1, fill=False, ec=LABEL_COLOR, label="labelled obstacle"),
            Rectangle((0, 0), 1, 1, fill=False, ec="#909090", ls=":", label="unsure, not scored"),
        ]
    below: Any = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.01)}
    axes.legend(handles=handles, ncols=ncols, fontsize=8, frameon=False, **below)
