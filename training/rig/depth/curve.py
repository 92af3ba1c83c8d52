"""Depth by frame: a plot and a table."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from tokt.inference.verdict import OBSTACLE, UNKNOWN
from tokt.training.evaluation.pictures import figure_png, new_figure

from .pair_depths import DepthRow, Place, gaps_of, runs_of

_DPI = 110
_DEPTHS = ("distance_m", "median_m", "far_m")
_DEPTH, _SPREAD, _NEAR, _VALID = "#1f4e79", "#9dc3e6", "#d1603d", "#4a8f4a"
_FINE: dict[str, Any] = {"ms": 4, "lw": 1.2}
_PERCENT_TICKS = (0, 0.01, 0.1, 1, 10, 100)
_UNKNOWN_COLOR, _GAP_COLOR = "#e8b339", "#c0392b"


def curve_csv(rows: Sequence[DepthRow]) -> str:
    """A line for each row, with the columns of `DepthRow`; empty where there is no value."""
    return str(pd.DataFrame(rows).to_csv(index=False, lineterminator="\n"))


def _broken(rows: Sequence[DepthRow], place: Place) -> pd.DataFrame:
    """The rows' numbers, with nan where frames are missing, so that no line crosses a gap."""
    table = pd.DataFrame(rows)[["status", *_DEPTHS, "valid_fraction"]].astype(float)
    table.insert(0, "frame", [float(place(row.frame)) for row in rows])
    at = np.flatnonzero(np.diff(table.frame) > 1) + 1
    return pd.DataFrame({name: np.insert(table[name], at, np.nan) for name in table})


def curve_png(
    rows: Sequence[DepthRow], found: Mapping[str, Any], name: str, place: Place = int
) -> bytes:
    """A PNG file: depth above, the matched part of the view below, over the frames.

    With the rows come their `summary` and the mission's name. Frames are where they come in the
    dive, by `place`; lines are broken where frames are missing.
    """
    size, ratios = (11, 6.2), (5, 2)
    figure, (depth, valid) = new_figure(*size, 2, 1, dpi=_DPI, sharex=True, height_ratios=ratios)
    table = _broken(rows, place)
    _draw_depth(depth, table)
    _draw_valid(valid, table)
    _mark(depth, found, place)
    for axes in (depth, valid):
        _shade(axes, rows, found, place)
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    handles, labels = depth.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=9, frameon=False)
    figure.suptitle(f"{name}: depth by frame", fontsize=13)
    return figure_png(figure)


def _draw_depth(axes: Any, table: pd.DataFrame) -> None:
    at, seen = table.frame, table.status == OBSTACLE
    near, middle, far = (table[name].where(seen) for name in _DEPTHS)
    axes.fill_between(at, near, far, color=_SPREAD, alpha=0.5, lw=0, label="near to far end")
    # A single frame between two gaps is no line: it needs its dot.
    axes.plot(at, middle, ".-", color=_DEPTH, label="median depth", **_FINE)
    axes.plot(at, near, ".-", color=_NEAR, label="near end (distance_m)", **_FINE)
    stray = table.median_m.where(~seen)
    if stray.notna().any():
        axes.plot(at, stray, "x", color="0.55", ms=4, label="too few matches for an obstacle")
    axes.set_ylim(bottom=0)
    axes.set_ylabel("depth, m")
    if table.median_m.isna().all():
        axes.text(0.5, 0.5, "nothing was matched", transform=axes.transAxes, ha="center")


def _draw_valid(axes: Any, table: pd.DataFrame) -> None:
    axes.plot(table.frame, table.valid_fraction * 100, ".-", color=_VALID, ms=3, lw=1.2)
    axes.set_yscale("symlog", linthresh=0.01)
    axes.set_yticks(_PERCENT_TICKS, [f"{tick:g}" for tick in _PERCENT_TICKS])
    axes.set_yticks([], minor=True)
    axes.set_ylim(0, 100)
    axes.set(xlabel="frame", ylabel="matched, %\nof the view")


def _mark(axes: Any, found: Mapping[str, Any], place: Place) -> None:
    """First detection and the nearest frame, as lines with words."""
    if found["first_detection"] is not None:
        axes.axvline(place(found["first_detection"]), color="0.35", lw=0.9, ls="--")
        axes.annotate(
            f"first detection: {found['first_detection']}",
            (place(found["first_detection"]), 0),
            (-4, 6),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            rotation=90,
            ha="right",
            va="bottom",
            fontsize=9,
            color="0.25",
        )
    least = found["nearest"]
    if least is not None:
        axes.annotate(
            f"nearest: {least['distance_m']:.2f} m\nframe {least['frame']}",
            (place(least["frame"]), least["distance_m"]),
            (0, -12),
            textcoords="offset points",
            ha="center",
            va="top",
            fontsize=9,
            color=_NEAR,
        )


def _shade(axes: Any, rows: Sequence[DepthRow], found: Mapping[str, Any], place: Place) -> None:
    """Frames that could not be judged, and gaps of depth inside the detected span."""
    gaps = gaps_of(rows, found["detected"], place)
    unknown = [row.frame for row in rows if row.status == UNKNOWN and row.frame not in gaps]
    kinds = {"unknown": unknown, "no depth (gap)": gaps}
    for (label, frames), color in zip(kinds.items(), (_UNKNOWN_COLOR, _GAP_COLOR), strict=True):
        for number, (first, last) in enumerate(runs_of(frames, place)):
            ends = (place(first) - 0.5, place(last) + 0.5)
            once = None if number else label
            axes.axvspan(*ends, color=color, alpha=0.35, lw=0, label=once)
