"""A frame beside its depth, as a picture for people.

::

    +----------------------+----------------------+---+
    | left frame, contrast | colour: depth        | m |   both panels are the left frame's own
    | raised; a scale      | dark: not matched    |   |   pixels; hatched is where the right
    |                      | hatched: blind       |   |   camera does not see what this one sees
    +----------------------+----------------------+---+
"""

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, NullLocator

from tokt.features.common.arrays import U8
from tokt.inference.stereo.matching import Matches
from tokt.inference.stereo.rectify import Rectifier
from tokt.inference.verdict import HEALTHY, STATUS_WORDS
from tokt.training.evaluation.pictures import figure_png, new_figure, raise_contrast

from .pair_depths import DepthRow

_WIDTH = 680
_DPI = 100
_OUTSIDE, _BLIND, _UNMATCHED, _FIRST_DEPTH = 0, 1, 2, 3
_N_DEPTHS = 256 - _FIRST_DEPTH
_DARK, _STRIPE = (26, 28, 32), (78, 84, 94)
_STRIPE_PX = 7
_MAP = ListedColormap(mpl.colormaps["turbo"](np.linspace(0.95, 0.08, _N_DEPTHS)))
_TICKS_M = (0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10, 15, 20, 30)
_BARS_M = (5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05)
_MAX_BAR = 0.35  # of the frame's width


def title(row: DepthRow) -> str:
    """Depths and verdict of a pair, in one line."""
    words = [f"frame {row.frame}: {STATUS_WORDS[row.status]}"]
    if row.distance_m is not None:
        words.append(f"near end {row.distance_m:.2f} m")
    if row.median_m is not None:
        words.append(f"median {row.median_m:.2f} m")
    if row.valid_fraction is not None:
        words.append(f"{row.valid_fraction:.1%} matched")
    if row.contact_s is not None:
        words.append(f"contact in {row.contact_s:.0f} s")
    return ", ".join(words)


class DepthPicture:
    """Draws one frame after another, all with one scale of colours.

    The rectifier is that whose views were matched. The colour bar ends at `nearest_m` and
    `farthest_m`; what lies beyond has the colour of the end.
    """

    def __init__(self, rectifier: Rectifier, nearest_m: float, farthest_m: float) -> None:
        width, height = rectifier.calibration.frame_size
        self._rectifier = rectifier
        self._width, self._height = _WIDTH, round(_WIDTH * height / width)
        self._ends = (nearest_m, farthest_m)
        self._norm = LogNorm(nearest_m, farthest_m, clip=True)
        depths = (np.asarray(_MAP.colors)[:, :3] * 255).round().astype(np.uint8)
        self._colors = np.vstack([np.full((_FIRST_DEPTH, 3), _DARK, np.uint8), depths])

    def png(self, row: DepthRow, left: U8, matches: Matches | None) -> bytes:
        """One picture, of the left frame as decoded; without matches where none were looked for."""
        figure, (frame, depth) = new_figure(14.4, 5.9, 1, 2, dpi=_DPI)
        frame.imshow(raise_contrast(left, self._width, self._height))
        frame.set_title("left camera, contrast raised", fontsize=10)
        depth.imshow(self.depth_rgb(matches), interpolation="nearest")
        depth.set_title("depth, in the left camera's pixels", fontsize=10)
        for axes in (frame, depth):
            axes.set(xticks=[], yticks=[])
        self._draw_scale(frame, row)
        self._draw_color_bar(figure, depth)
        _explain(depth)
        figure.suptitle(title(row), fontsize=13)
        if row.health != HEALTHY:
            figure.supxlabel(row.health, fontsize=9, color="#b03030", wrap=True)
        return figure_png(figure)

    def depth_rgb(self, matches: Matches | None) -> U8:
        """The right panel: uint8, shape (height, width, 3), as large as the left one."""
        if matches is None:
            return np.full((self._height, self._width, 3), _DARK, np.uint8)
        code = np.where(matches.searched, _UNMATCHED, _BLIND).astype(np.uint8)
        disparity = matches.disparity_px[matches.valid].astype(np.float64)
        place = self._norm(self._rectifier.focal_baseline_px_m / disparity)
        code[matches.valid] = _FIRST_DEPTH + np.rint(place * (_N_DEPTHS - 1)).astype(np.uint8)
        seen = self._rectifier.to_left(code, self._height, self._width)
        picture = self._colors[seen]
        row, column = np.indices(seen.shape)
        stripes = (row + column) // _STRIPE_PX % 2 == 0
        picture[stripes & (seen <= _BLIND)] = _STRIPE
        return picture

    def _draw_color_bar(self, figure: Figure, axes: Any) -> None:
        place = axes.inset_axes((1.02, 0.0, 0.035, 1.0))
        bar = figure.colorbar(ScalarMappable(self._norm, _MAP), cax=place)
        place.invert_yaxis()
        bar.set_label("metres from the camera (logarithmic)")
        ticks = [tick for tick in _TICKS_M if self._ends[0] <= tick <= self._ends[1]]
        place.yaxis.set_major_locator(FixedLocator(ticks))
        place.yaxis.set_minor_locator(NullLocator())
        place.yaxis.set_major_formatter(lambda value, _: f"{value:g}")

    def _draw_scale(self, axes: Any, row: DepthRow) -> None:
        """How long something at the median depth looks."""
        if row.median_m is None:
            return
        known = self._rectifier.calibration
        px_per_m = known.K1[0, 0] / known.frame_size[0] * self._width / row.median_m
        length = next((m for m in _BARS_M if m * px_per_m <= _MAX_BAR * self._width), None)
        if length is None:
            return
        x, y = 0.04 * self._width, 0.94 * self._height
        for color, thickness in (("black", 5), ("white", 2.5)):
            axes.plot([x, x + length * px_per_m], [y, y], color=color, lw=thickness)
        axes.text(
            x,
            y - 0.02 * self._height,
            f"{length:g} m at {row.median_m:.1f} m",
            color="white",
            fontsize=10,
            bbox={"facecolor": "black", "alpha": 0.55, "pad": 2, "edgecolor": "none"},
        )


def _explain(axes: Any) -> None:
    """What is not coloured."""
    dark, stripe = ("#{:02x}{:02x}{:02x}".format(*color) for color in (_DARK, _STRIPE))
    handles = [
        Patch(facecolor=dark, edgecolor="0.5", label="not matched"),
        Patch(
            facecolor=dark, edgecolor=stripe, hatch="////", label="not in the view of both cameras"
        ),
    ]
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        ncols=2,
        fontsize=9,
        frameon=False,
    )
