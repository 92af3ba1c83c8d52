"""The comparison's figures."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from .errors import FALSE_ALARM, MISS
from .predictions import ComparedModels

_STATUS_COLORS = ("#b9c0c7", "#e8eef3", "#d1495b")  # unknown, clear, obstacle
_KIND_COLORS = ("#ffffff", "#9ecae1", "#2f5d50")  # neither, ocean, obstacle
_MISS_COLOR, _ALARM_COLOR = "#2c6fbb", "#e07b39"


def statuses_along(compared: ComparedModels) -> Figure:
    """What each frame is labelled, and each model's status of it, in the order of the dive."""
    rows = [compared.series.table.kind.map({"neither": 0, "ocean": 1, "obstacle": 2}).to_numpy()]
    names = ["labels"]
    for predictions in compared.models:
        rows.append(compared.status(predictions) + 1)
        names.append(predictions.label)
    figure = Figure(figsize=(10.5, 0.7 + 0.42 * len(rows)), layout="constrained")
    for index, axes in enumerate(figure.subplots(len(rows), 1, sharex=True)):
        colors = _STATUS_COLORS if index else _KIND_COLORS
        axes.imshow(
            rows[index][None],
            aspect="auto",
            cmap=ListedColormap(colors),
            vmin=0,
            vmax=2,
            interpolation="nearest",
        )
        axes.set_yticks([0], [names[index]])
        for gap in np.flatnonzero(compared.series.gaps):
            axes.axvline(gap - 0.5, color="k", lw=0.8, ls=":")
        for start in compared.series.starts[1:]:
            axes.axvline(start - 0.5, color="k", lw=1.2)
    frames = compared.series.table.frame.to_numpy()
    ticks = np.unique(np.linspace(0, len(frames) - 1, min(len(frames), 14)).astype(int))
    axes.set_xticks(ticks, [str(frames[tick]) for tick in ticks])
    axes.set_xlabel("frame (dotted: a gap in the frame numbers)")
    return figure


def errors_along(result: dict[str, Any]) -> Figure:
    """Misses and false alarms of each model by stretch of the dive."""
    rows, labels = result["stretches"], [model["model"] for model in result["models"]]
    figure = Figure(figsize=(10.5, 3.4), layout="constrained")
    axes = figure.subplots()
    width = 0.8 / len(labels)
    for number, label in enumerate(labels):
        place = np.arange(len(rows)) - 0.4 + width * (number + 0.5)
        misses = np.array([row["models"][label][MISS] for row in rows])
        alarms = np.array([row["models"][label][FALSE_ALARM] for row in rows])
        shade = 1 - 0.6 * number / len(labels)
        axes.bar(place, misses, width * 0.92, color=_MISS_COLOR, alpha=shade)
        axes.bar(place, -alarms, width * 0.92, color=_ALARM_COLOR, alpha=shade)
    axes.axhline(0, color="k", lw=0.8)
    names = [row["frames"] if len(row["frames"]) < 12 else f"{row['frames'][:10]}…" for row in rows]
    axes.set_xticks(range(len(rows)), names, rotation=40, ha="right", fontsize=8)
    axes.set_ylabel("false alarms | missed patches")
    axes.set_title(
        f"bars of a stretch from left to right: {', '.join(labels)}", fontsize=9, loc="left"
    )
    axes.yaxis.set_major_formatter(lambda value, _: f"{abs(value):g}")
    return figure


def learning_curve(curve: dict[str, Any]) -> Figure:
    """The figure against the share of training blocks; bars from the least to the most."""
    points = curve["points"]
    blocks = [point["blocks"] for point in points]
    mean = np.array([point["mean"] for point in points])
    reach = [
        mean - [point["least"] for point in points],
        np.array([point["most"] for point in points]) - mean,
    ]
    figure = Figure(figsize=(5.2, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.errorbar(blocks, mean, yerr=reach, marker="o", capsize=4, color=_MISS_COLOR)
    axes.set(xlabel="training blocks (mean over folds)", ylabel=curve["measure_title"])
    axes.set_xlim(0, None)
    axes.grid(alpha=0.3)
    return figure
