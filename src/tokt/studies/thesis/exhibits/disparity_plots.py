"""The thesis's disparity map and point cloud beside ours, drawn for people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from tokt.inference.stereo.matching import Matches
from tokt.studies.baselines.thesis_disparity import cropped
from tokt.studies.baselines.thesis_stereo import CROP_PX
from tokt.studies.thesis.frame_drawing import png_of
from tokt.training.evaluation.pictures import raise_contrast
from tokt.training.rig.depth.picture import DepthPicture

Image = NDArray[np.uint8]
Float = NDArray[np.float64]

_VIEW = (680, 512)
_MAX_POINTS = 20_000
"""Of a cloud, drawn: more of them hide each other."""
_THESIS_MAP = "magma"


@dataclass(frozen=True)
class Panel:
    """One right frame, what the thesis's pipeline makes of the pair, and what ours does.

    Parameters
    ----------
    words : str
    stretched : array of uint8, shape (1024, 1360)
    matches : Matches
    """

    words: str
    stretched: Image
    matches: Matches


def maps_png(
    left: Image, panel: Panel, picture: DepthPicture, ends_m: tuple[float, float]
) -> bytes:
    """The frame, the thesis's map with its margin, the map it judges, and our depth.

    Parameters
    ----------
    left : array of uint8
        As decoded.
    panel : Panel
        With the frame's own right frame.
    picture : DepthPicture
    ends_m : (float, float)
        Metres that its colours go from and to.
    """
    figure = Figure(figsize=(11, 8.6), layout="constrained")
    axes = figure.subplots(2, 2)
    axes[0, 0].imshow(raise_contrast(left, *_VIEW))
    axes[0, 0].set_title("left frame, contrast raised", fontsize=10)
    width = panel.stretched.shape[1]
    _show_map(axes[0, 1], panel.stretched, "thesis: stretched disparities, and the margin")
    for at in (CROP_PX, width - CROP_PX):
        axes[0, 1].axvline(at - 0.5, color="#4da3ff", lw=1.2, ls="--")
    for at in (0, width - CROP_PX):
        axes[0, 1].axvspan(at - 0.5, at + CROP_PX - 0.5, color="#4da3ff", alpha=0.18, lw=0)
    _show_map(axes[1, 0], cropped(panel.stretched), "thesis: without the margin, as it is judged")
    axes[1, 1].imshow(picture.depth_rgb(panel.matches), interpolation="nearest")
    axes[1, 1].set_title(
        f"ours: {panel.matches.valid.mean():.1%} matched; "
        f"red {ends_m[0]:.1f} m to blue {ends_m[1]:.1f} m, logarithmic",
        fontsize=10,
    )
    for one in axes.flat:
        one.set(xticks=[], yticks=[])
    _explain(axes[1, 1])
    return png_of(figure)


def exchanged_png(panels: Sequence[Panel], picture: DepthPicture) -> bytes:
    """A column a right frame: the thesis's map above, ours below."""
    figure = Figure(figsize=(3.9 * len(panels), 6.2), layout="constrained")
    axes = figure.subplots(2, len(panels), squeeze=False)
    for (above, below), panel in zip(axes.T, panels, strict=True):
        seen = (cropped(panel.stretched) > 0).mean()
        _show_map(above, cropped(panel.stretched), f"{panel.words}\nthesis: {seen:.2%} white")
        below.imshow(picture.depth_rgb(panel.matches), interpolation="nearest")
        below.set_title(f"ours: {panel.matches.valid.mean():.2%} matched", fontsize=10)
        below.set(xticks=[], yticks=[])
    return png_of(figure)


def clouds_png(thesis: Float, thesis_said: Float, ours: Float) -> bytes:
    """Both point clouds from the front and from above, coloured by their own depth.

    Parameters
    ----------
    thesis : array of float, shape (n, 3)
        x right, y up, z backwards, without a unit.
    thesis_said : array of float, shape (n,)
        The map's value of each of its points.
    ours : array of float, shape (m, 3)
        Metres: x right, y down, z ahead.
    """
    figure = Figure(figsize=(11, 8.4), layout="constrained")
    axes = figure.subplots(2, 2)
    chosen = _some(len(thesis))
    x, up, back = thesis[chosen].T
    colors = thesis_said[chosen]
    _scatter(axes[0, 0], x, up, colors, "thesis, from the front", ("x, no unit", "y, no unit"))
    _scatter(axes[0, 1], x, -back, colors, "thesis, from above", ("x, no unit", "depth, no unit"))
    chosen = _some(len(ours))
    x, down, ahead = ours[chosen].T
    _scatter(axes[1, 0], x, -down, -ahead, "ours, from the front", ("x, m", "height, m"))
    _scatter(axes[1, 1], x, ahead, -ahead, "ours, from above", ("x, m", "depth, m"))
    for one in axes[1]:
        one.set_aspect("equal", adjustable="datalim")
    for one in axes[0]:
        _without_far_points(one)
    return png_of(figure)


def _some(count: int) -> NDArray[np.int64]:
    """Which points of a cloud are drawn, in a random order that is always the same."""
    order = np.random.default_rng(0).permutation(count)
    return order[:_MAX_POINTS]


def _scatter(
    axes: Any, x: Float, y: Float, colors: Float, title: str, labels: tuple[str, str]
) -> None:
    axes.scatter(x, y, s=1.5, c=colors, cmap="turbo", linewidths=0)
    axes.set_title(f"{title} ({len(x)} points drawn)", fontsize=10)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    axes.grid(alpha=0.25)


def _without_far_points(axes: Any) -> None:
    """Small map values put points very far out: the middle 98 % are shown."""
    points = np.ma.getdata(axes.collections[0].get_offsets())
    if len(points):
        low, high = np.percentile(points, [1, 99], axis=0)
        margin = np.maximum(high - low, 1e-6) * 0.05
        axes.set_xlim(low[0] - margin[0], high[0] + margin[0])
        axes.set_ylim(low[1] - margin[1], high[1] + margin[1])


def _show_map(axes: Any, stretched: Image, title: str) -> None:
    axes.imshow(stretched, cmap=_THESIS_MAP, vmin=0, vmax=255, interpolation="nearest")
    axes.set_title(title, fontsize=10)
    axes.set(xticks=[], yticks=[])


def _explain(axes: Any) -> None:
    axes.legend(
        handles=[Patch(facecolor="#1a1c20", edgecolor="0.5", label="not matched; striped: "
                       "not in the view of both cameras")],
        loc="upper center", bbox_to_anchor=(0.5, 0.0), fontsize=9, frameon=False,
    )  # fmt: skip
