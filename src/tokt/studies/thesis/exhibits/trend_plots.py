"""Trend and time to contact against depth, drawn for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tokt.inference.policy.temporal_cues import GROWING, SHRINKING, STEADY
from tokt.studies.thesis.frame_drawing import png_of
from tokt.studies.thesis.methods.trend_scores import TrendAgainstDepth

COLORS = {GROWING: "#c0392b", STEADY: "#4a8f4a", SHRINKING: "#2d6cb3", None: "0.75"}
_WORDS = {
    GROWING: "growing: comes nearer",
    STEADY: "steady",
    SHRINKING: "shrinking: goes away",
    None: "none",
}
_MARKS = "osD^v"


def trend_png(held: Mapping[str, Sequence[TrendAgainstDepth]], titles: Mapping[str, str]) -> bytes:
    """Depth above, a row a method below, over the frame numbers."""
    figure = Figure(figsize=(10.5, 2.6 + 1.7 * len(held)), layout="constrained")
    axes = figure.subplots(
        1 + len(held), 1, sharex=True, squeeze=False, height_ratios=[1.4, *[1.0] * len(held)]
    )[:, 0]
    first = next(iter(held.values()))
    depth = [one.depth_m for one in first]
    _dots(axes[0], [one.frame for one in first], depth, [one.true for one in first])
    axes[0].set_ylabel("depth, m")
    axes[0].set_ylim(bottom=0)
    for one, (name, frames) in zip(axes[1:], held.items(), strict=True):
        means = [np.nan if frame.mean is None else frame.mean for frame in frames]
        _dots(one, [f.frame for f in frames], means, [f.said.trend for f in frames])
        one.set_ylabel(f"{titles[name]}\nmean value", fontsize=8)
        one.set_ylim(bottom=0)
    axes[-1].set_xlabel("frame")
    handles = [
        Line2D([], [], marker="o", ls="", color=COLORS[key], label=_WORDS[key]) for key in COLORS
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return png_of(figure)


def _dots(
    axes: Any, frames: Sequence[int], values: Sequence[float], trends: Sequence[str | None]
) -> None:
    axes.plot(frames, values, color="0.8", lw=0.8, zorder=1)
    colors = [COLORS[trend] for trend in trends]
    axes.scatter(frames, values, c=colors, s=14, linewidths=0, zorder=2)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def confusion_png(tables: Mapping[str, pd.DataFrame]) -> bytes:
    """A square of counts for each method; a row's colours are shares of the row."""
    figure = Figure(figsize=(3.0 * len(tables) + 1.0, 3.0), layout="constrained")
    axes = figure.subplots(1, len(tables), squeeze=False, sharey=True)[0]
    for one, (title, table) in zip(axes, tables.items(), strict=True):
        counts = table.to_numpy()
        share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
        one.imshow(share, cmap="Blues", vmin=0, vmax=1, aspect="auto")
        for (row, column), value in np.ndenumerate(counts):
            color = "white" if share[row, column] > 0.5 else "black"
            one.text(column, row, str(value), ha="center", va="center", color=color)
        one.set_xticks(range(len(table.columns)), table.columns, rotation=30, ha="right")
        one.set_yticks(range(len(table.index)), table.index)
        one.set_title(title, fontsize=10)
        one.set_xlabel("said")
    axes[0].set_ylabel("by depth")
    return png_of(figure)


def contact_png(
    held: Mapping[str, Sequence[TrendAgainstDepth]], titles: Mapping[str, str]
) -> bytes:
    """Both times to contact against each other, in seconds."""
    figure = Figure(figsize=(9.6, 5.4), layout="constrained")
    axes = figure.subplots()
    known: list[float] = []
    for place, (name, frames) in enumerate(held.items()):
        color, mark = f"C{place}", _MARKS[place % len(_MARKS)]
        for filled in (False, True):
            points = [
                (one.true_contact_s, said)
                for one in frames
                for said in [one.said.contact_s if filled else one.unchecked_contact_s]
                if said is not None and one.true_contact_s is not None
            ]
            x, y = np.array(points).reshape(-1, 2).T
            known += [*x, *y]
            face = color if filled else "none"
            words = f"{titles[name]}, {'said' if filled else 'edge ignored'}: {len(points)}"
            axes.plot(x, y, mark, mfc=face, mec=color, ms=5, label=words)
    ends = (min([1.0, *known]) * 0.8, max([10.0, *known]) * 1.25)
    axes.plot(ends, ends, color="0.5", lw=0.8)
    axes.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
    axes.set(xlabel="time to contact by stereo depth, s", ylabel="time to contact by expansion, s")
    axes.grid(alpha=0.25, which="both")
    figure.legend(fontsize=8, loc="outside right upper", frameon=False)
    return png_of(figure)
