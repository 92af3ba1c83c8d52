"""The figures that runs and reports show."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from sklearn.metrics import average_precision_score, precision_recall_curve

Curve = tuple[NDArray[np.bool_], NDArray[np.float64]]


def precision_recall(curves: Mapping[str, Curve]) -> Figure:
    """Precision against recall, a line for each name; the dot is the model's own threshold.

    Parameters
    ----------
    curves : mapping of name to (truth, score)
        truth bool, score float64 and above 0 where the model says obstacle, each (n_patches,).
    """
    figure = Figure(figsize=(5.2, 4.2), layout="constrained")
    axes = figure.subplots()
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
    """A confusion matrix; a row for each true class.

    Parameters
    ----------
    table : mapping
        ``classes`` and ``counts`` as `class_metrics` gives them.
    """
    counts = np.asarray(table["counts"])
    names = table["classes"]
    figure = Figure(figsize=(1.6 + 1.1 * len(names), 1.2 + 0.9 * len(names)), layout="constrained")
    axes = figure.subplots()
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
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
