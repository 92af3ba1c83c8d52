"""The pictures of figures 5.3 to 5.5: mean value by frame, as it is, normalised, and zoomed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tokt.inference.verdict import STATUS_MEAN_THRESHOLD
from tokt.studies.thesis.methods.curves import COMPARED, OURS, THESIS, Curves

_KINDS = (THESIS, COMPARED, OURS)
_ZOOM_TOP = 12.0
"""Mean at the top of the zoomed figure: five patches of a 10x10 grid."""
_ZOOM_BEFORE, _ZOOM_AFTER = 15, 12


def _panels(curves: Curves) -> list[str]:
    return [kind for kind in _KINDS if curves.named(kind)]


def _draw(axes: Any, values: pd.Series, sampled: bool, label: str, color: str) -> None:
    """A line that breaks where frames are missing; points for a sample."""
    if sampled:
        there = values.dropna()
        axes.plot(there.index, there, "o", ms=4, color=color, label=f"{label} (sample)")
        return
    numbers = np.arange(values.index.min(), values.index.max() + 1)
    axes.plot(numbers, values.reindex(numbers), lw=1.3, color=color, label=label)


def _finish(axes: Any, kind: str, curves: Curves, labels: Mapping[int, int]) -> None:
    """Whose curves these are, where the labels have an obstacle, and which curve is which."""
    axes.set_title(kind, loc="left", fontsize=9)
    _shade(axes, [n for n, count in labels.items() if count], list(labels), curves.mean.index)
    axes.legend(loc="upper left", fontsize=7)


def _shade(axes: Any, obstacle: Sequence[int], labelled: Sequence[int], every: pd.Index) -> None:
    """Gray where an obstacle is labelled, hatched where nothing is."""
    top = axes.get_ylim()[1]
    numbers = every.to_numpy()
    if labelled:
        seen = np.isin(numbers, list(obstacle))
        axes.fill_between(numbers, 0, top, where=seen, color="0.9", step="mid", zorder=0)
        unknown = ~np.isin(numbers, list(labelled))
        axes.fill_between(
            numbers, 0, top, where=unknown, facecolor="none", edgecolor="0.85", hatch="///",
            step="mid", zorder=0, lw=0,
        )  # fmt: skip
    axes.set_ylim(0, top)


def sequence(curves: Curves, labels: Mapping[int, int], firsts: Mapping[str, int | None]) -> Figure:
    """Figure 5.3: the mean value of every method by frame.

    Parameters
    ----------
    curves : Curves
    labels : mapping of int to int
        Obstacle patches of each labelled frame.
    firsts : mapping of str to int or None
        First detections, marked below the curves.
    """
    kinds = _panels(curves)
    figure = Figure(figsize=(10.5, 1.0 + 2.5 * len(kinds)), layout="constrained")
    all_axes = figure.subplots(len(kinds), 1, sharex=True, squeeze=False)[:, 0]
    for axes, kind in zip(all_axes, kinds, strict=True):
        for place, name in enumerate(curves.named(kind)):
            method = curves.methods[name]
            _draw(axes, curves.mean[name], method.sampled, method.title, f"C{place}")
            first = firsts.get(name)
            if first is not None:
                axes.axvline(first, color=f"C{place}", lw=0.8, ls=":")
        axes.set_yscale("symlog", linthresh=1.0)
        axes.axhline(STATUS_MEAN_THRESHOLD, color="crimson", lw=0.8)
        axes.set_ylim(0, 255)
        axes.set_ylabel("mean of the mask")
        _finish(axes, kind, curves, labels)
    all_axes[-1].set_xlabel("frame (dotted: first detection; red: status threshold 0.345)")
    return figure


def normalised(curves: Curves, labels: Mapping[int, int]) -> Figure:
    """Figure 5.4: each curve as a share of its largest, beside how near the object is."""
    kinds = _panels(curves)
    figure = Figure(figsize=(10.5, 1.0 + 2.2 * len(kinds)), layout="constrained")
    all_axes = figure.subplots(len(kinds), 1, sharex=True, squeeze=False)[:, 0]
    shares = curves.shares()
    near = 1.0 / curves.distance_m
    for axes, kind in zip(all_axes, kinds, strict=True):
        for place, name in enumerate(curves.named(kind)):
            method = curves.methods[name]
            _draw(axes, shares[name], method.sampled, method.title, f"C{place}")
        if near.notna().any():
            _draw(axes, near / near.max(), False, "1 / distance (stereo)", "black")
        axes.set_ylim(0, 1.05)
        axes.set_ylabel("share of the largest")
        _finish(axes, kind, curves, labels)
    all_axes[-1].set_xlabel("frame")
    return figure


def zoomed(
    curves: Curves, labels: Mapping[int, int], firsts: Mapping[str, int | None]
) -> Figure | None:
    """Figure 5.5: small means around the first detections; None where nothing was detected."""
    found = [first for name, first in firsts.items() if first is not None]
    if not found:
        return None
    begin, end = min(found) - _ZOOM_BEFORE, max(found) + _ZOOM_AFTER
    kinds = _panels(curves)
    figure = Figure(figsize=(10.5, 1.0 + 2.2 * len(kinds)), layout="constrained")
    all_axes = figure.subplots(len(kinds), 1, sharex=True, squeeze=False)[:, 0]
    for axes, kind in zip(all_axes, kinds, strict=True):
        for place, name in enumerate(curves.named(kind)):
            method, first = curves.methods[name], firsts.get(name)
            told = method.title if first is None else f"{method.title}: {first}"
            _draw(axes, curves.mean[name].loc[begin:end], method.sampled, told, f"C{place}")
            if first is not None:
                axes.axvline(first, color=f"C{place}", lw=1, ls=":")
        axes.axhline(STATUS_MEAN_THRESHOLD, color="crimson", lw=0.8)
        axes.set_ylim(0, _ZOOM_TOP)
        axes.set_xlim(max(begin, curves.mean.index.min()), min(end, curves.mean.index.max()))
        axes.set_ylabel("mean of the mask")
        _finish(axes, kind, curves, labels)
    all_axes[-1].set_xlabel("frame (dotted, and in the legend: first detection)")
    return figure


def correlation_picture(table: pd.DataFrame, titles: Sequence[str]) -> Figure:
    """Rank correlations as a coloured table."""
    count = len(table)
    figure = Figure(figsize=(2.6 + 0.75 * count, 1.6 + 0.5 * count), layout="constrained")
    axes = figure.subplots()
    values = table.to_numpy(float)
    axes.imshow(values, cmap="RdBu", vmin=-1, vmax=1, aspect="auto")
    for (row, col), value in np.ndenumerate(values):
        if np.isfinite(value):
            dark = abs(value) > 0.6
            color = "white" if dark else "black"
            axes.text(col, row, f"{value:.2f}", ha="center", va="center", fontsize=8, color=color)
    axes.set_xticks(range(count), titles, rotation=35, ha="right", fontsize=8)
    axes.set_yticks(range(count), titles, fontsize=8)
    return figure
