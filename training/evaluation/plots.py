"""The figures that runs and reports show."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from sklearn.metrics import average_precision_score, precision_recall_curve

from tokt.features.common.arrays import F64, Bools

from .pictures import figure_png, file_uri, new_figure

Curve = tuple[Bools, F64]


def precision_recall(curves: Mapping[str, Curve]) -> Figure:
    """Precision against recall, a line for each name; the dot is the model's own threshold.

    By name truth, and the score above 0 where the model says obstacle, each (n_patches,).
    """
    figure, axes = new_figure(5.2, 4.2)
    for name, (truth, score) in curves.items():
        precision, recall, _ = precision_recall_curve(truth, score)
        area = average_precision_score(truth, score)
        line = axes.plot(recall, precision, label=f"{name} (AP {area:.3f})")[0]
        said = score > 0
        if said.any():
            hit = (said & truth).sum()
            axes.plot(hit / truth.sum(), hit / said.sum(), "o", color=line.get_color())
    axes.set(xlabel="recall", ylabel="precision", xlim=(0, 1.01), ylim=(0, 1.02))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower left")
    return figure


def confusion(table: Mapping[str, Any]) -> Figure:
    """A confusion matrix, as `class_metrics` gives it; a row for each true class."""
    counts, names = np.asarray(table["counts"]), table["classes"]
    figure, axes = new_figure(1.6 + 1.1 * len(names), 1.2 + 0.9 * len(names))
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(share, cmap="Blues", vmin=0, vmax=1)
    for (row, col), value in np.ndenumerate(counts):
        color = "white" if share[row, col] > 0.5 else "black"
        axes.text(col, row, str(value), ha="center", va="center", color=color)
    axes.set_xticks(range(len(names)), names, rotation=30, ha="right")
    axes.set_yticks(range(len(names)), names)
    axes.set(xlabel="predicted", ylabel="labelled")
    return figure


def data_uri(figure: Figure) -> str:
    """A figure as a PNG data URI, for a page that needs no other file."""
    return file_uri("png", figure_png(figure, 110))


def mean_by_frame(
    frames: list[int], means: Mapping[str, list[float]], labelled: list[int], threshold: float
) -> Figure:
    """Mean of the 0/255 mask by frame (thesis figures 5.3 to 5.5), in the order of replay.

    A gap in the frames' numbers breaks the lines; frames are shaded that have labelled obstacle
    patches. Above the threshold the status is 1.
    """
    figure, axes = new_figure(10.5, 3.6)
    place = np.arange(len(frames))
    breaks = [i for i in range(1, len(frames)) if frames[i] != frames[i - 1] + 1]
    for name, values in means.items():
        line = np.insert(np.asarray(values, float), breaks, np.nan)
        axes.plot(np.insert(place.astype(float), breaks, np.nan), line, label=name, lw=1.4)
    top = max(1.0, *(float(np.nanmax([0.0, *values])) for values in means.values()))
    shown = np.asarray(labelled) > 0
    axes.fill_between(
        place, 0, top * 1.05, where=shown, color="0.88", step="mid", label="obstacle labelled"
    )
    for at in breaks:
        axes.axvline(at - 0.5, color="0.5", lw=0.8, ls=":")
    axes.axhline(threshold, color="crimson", lw=0.8, label=f"status threshold {threshold}")
    ticks = place[:: max(1, len(frames) // 14)]
    axes.set_xticks(ticks, [str(frames[i]) for i in ticks])
    axes.set(xlabel="frame (dotted: a gap in the frame numbers)", ylabel="mean of the mask")
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_ylim(0, top * 1.05)
    axes.legend(loc="upper left", fontsize=8)
    return figure


def timings(stages: Mapping[str, float], latency_ms: list[float]) -> Figure:
    """Wall time of each stage, and how long the runtime took over each frame."""
    figure, (bars, spread) = new_figure(10.5, 2.8, 1, 2)
    names = list(stages)
    bars.barh(names, [stages[name] for name in names], color="#3b75af")
    bars.invert_yaxis()
    bars.set_xlabel("seconds")
    spread.hist(latency_ms, bins=30, color="#3b75af")
    spread.set(xlabel="runtime: frame to verdict, ms", ylabel="frames")
    return figure
