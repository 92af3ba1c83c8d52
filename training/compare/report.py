"""The comparison as one HTML file that needs no other, and as a run of MLflow."""

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import mlflow
import numpy as np
import pandas as pd
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from mlflow.entities import Metric

from tokt.features.common.arrays import U8
from tokt.features.frames.grid import Grid
from tokt.labels.page.state.enhance import enhanced
from tokt.models.bundle.bundle import Bundle
from tokt.models.registry.registry import Registry, local_uri, tracking_uri
from tokt.training.evaluation.pictures import jpeg_uri, new_figure
from tokt.training.evaluation.plots import confusion, data_uri, precision_recall
from tokt.training.evaluation.report import report_page
from tokt.training.fitting.tracking import log_dataset

from .errors import FALSE_ALARM, MISS
from .predictions import ComparedModels

_STATUS_COLORS = ("#b9c0c7", "#e8eef3", "#d1495b")  # unknown, clear, obstacle
_KIND_COLORS = ("#ffffff", "#9ecae1", "#2f5d50")  # neither, ocean, obstacle
_MISS_COLOR, _ALARM_COLOR = "#2c6fbb", "#e07b39"
_AROUND = 1.5  # patches on each side of a pictured one
_WIDTH = 260  # pixels of a picture
_OUTLINE_BGR = (40, 200, 255)
_MAX_NAME = 500  # characters that MLflow keeps of a dataset's
RUN_NAME = "compare"
FOLDER = "compare"


def report_html(compared: ComparedModels, result: dict[str, Any]) -> str:
    """The page, in which `result`, of `compare_models`, is embedded as it is."""
    sizes: dict[str, int] = {}
    for model in result["models"]:
        for name, row in model["patch"]["per_class"].items():
            sizes.setdefault(name, row["n"])
    return report_page(
        __package__,
        r=result,
        plots=_plots(compared, result),
        pictures=_pictures(compared, result["errors"]),
        two_sided=compared.two_sided,
        class_sizes=sizes,
    )


def _plots(compared: ComparedModels, result: dict[str, Any]) -> dict[str, Any]:
    """The figures as the page embeds them."""
    tables = {model["model"]: model["patch"]["confusion"] for model in result["models"]}
    return {
        **{name: data_uri(figure) for name, figure in _figures(compared, result).items()},
        "confusion": [
            (label, data_uri(confusion(table)))
            for label, table in tables.items()
            if len(table["classes"]) > 2
        ],
    }


def _figures(compared: ComparedModels, result: dict[str, Any]) -> dict[str, Figure]:
    """The figures that there is something to draw in."""
    curve, truth = result["learning_curve"], compared.truth
    figures: dict[str, Figure] = {}
    if compared.has_frames:
        figures["statuses"] = _statuses_along(compared)
    if result["stretches"]:
        figures["errors"] = _errors_along(result)
    if compared.two_sided and truth.any() and not truth.all():
        curves = {item.label: (truth, item.score) for item in compared.models}
        figures["precision_recall"] = precision_recall(curves)
    if "missing" not in curve:
        figures["learning"] = _learning_curve(curve)
    return figures


def _statuses_along(compared: ComparedModels) -> Figure:
    """What each frame is labelled, and each model's status of it, in the order of the dive."""
    rows = [compared.series.table.kind.map({"neither": 0, "ocean": 1, "obstacle": 2}).to_numpy()]
    names = ["labels"]
    for predictions in compared.models:
        rows.append(compared.status(predictions) + 1)
        names.append(predictions.label)
    figure, panels = new_figure(10.5, 0.7 + 0.42 * len(rows), len(rows), 1, sharex=True)
    look: Any = {"aspect": "auto", "vmin": 0, "vmax": 2, "interpolation": "nearest"}
    for index, axes in enumerate(panels):
        colors = _STATUS_COLORS if index else _KIND_COLORS
        axes.imshow(rows[index][None], cmap=ListedColormap(colors), **look)
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


def _errors_along(result: dict[str, Any]) -> Figure:
    """Misses and false alarms of each model by stretch of the dive."""
    rows, labels = result["stretches"], [model["model"] for model in result["models"]]
    figure, axes = new_figure(10.5, 3.4)
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


def _learning_curve(curve: dict[str, Any]) -> Figure:
    """The figure against the share of training blocks; bars from the least to the most."""
    points = curve["points"]
    blocks = [point["blocks"] for point in points]
    mean = np.array([point["mean"] for point in points])
    reach = [
        mean - [point["least"] for point in points],
        np.array([point["most"] for point in points]) - mean,
    ]
    figure, axes = new_figure(5.2, 3.6)
    axes.errorbar(blocks, mean, yerr=reach, marker="o", capsize=4, color=_MISS_COLOR)
    axes.set(xlabel="training blocks (mean over folds)", ylabel=curve["measure_title"])
    axes.set_xlim(0, None)
    axes.grid(alpha=0.3)
    return figure


def _surroundings(image: U8, grid: Grid, row: int, col: int) -> U8:
    """A patch with what is around it, outlined."""
    height, width = image.shape[:2]
    resized = grid.resized(height, width)
    box = grid.boxes(*resized)[row * grid.cols + col].astype(float)
    y0, y1 = box[:2] * height / resized[0]
    x0, x1 = box[2:] * width / resized[1]
    dy, dx = _AROUND * (y1 - y0), _AROUND * (x1 - x0)
    # A patch at the edge keeps as much around it, on its other side.
    top = round(min(max(0.0, y0 - dy), max(0.0, height - (y1 - y0) - 2 * dy)))
    left = round(min(max(0.0, x0 - dx), max(0.0, width - (x1 - x0) - 2 * dx)))
    bottom, right = round(top + (y1 - y0) + 2 * dy), round(left + (x1 - x0) + 2 * dx)
    cut = image[top : max(bottom, top + 1), left : max(right, left + 1)]  # a pixel at least
    scale = _WIDTH / cut.shape[1]
    size = (_WIDTH, max(1, round(cut.shape[0] * scale)))
    view = cv2.resize(cut, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    if view.ndim == 2:
        view = cv2.cvtColor(view, cv2.COLOR_GRAY2BGR)
    corners = [(x - left, y - top) for x, y in ((x0, y0), (x1, y1))]
    first, last = ((round(x * scale), round(y * scale)) for x, y in corners)
    cv2.rectangle(view, first, last, _OUTLINE_BGR, 2)
    return np.asarray(view, np.uint8)


def _pictures(compared: ComparedModels, errors: Sequence[dict[str, Any]]) -> list[str | None]:
    """A JPEG data URI for each error; None where the frame is not at hand."""
    if compared.read_frame is None:
        return [None] * len(errors)
    grid = compared.models[0].bundle.grid
    found: dict[tuple[str, str, int], U8] = {}
    uris: list[str | None] = []
    for error in errors:
        key = error["mission"], error["camera"], error["frame"]
        if not compared.has_frames:  # a patch has no surroundings, and no dark water to see through
            picture = compared.read_frame(*key)
            uris.append(None if picture is None else jpeg_uri(picture))
            continue
        if key not in found:
            picture = compared.read_frame(*key)
            if picture is None:
                uris.append(None)
                continue
            found = {key: enhanced(picture)}
        uris.append(jpeg_uri(_surroundings(found[key], grid, error["row"], error["col"]), 80))
    return uris


def _rows(result: dict[str, Any]) -> dict[str, dict[str, float]]:
    """The headline figures of each model, by the model's name."""
    found: dict[str, dict[str, float]] = {}
    for model in result["models"]:
        figures = {
            **{name: model["patch"][name] for name in ("f1", "precision", "recall", "macro_f1")},
            "average_precision": model["patch"]["average_precision"],
            "time_ms": model["time"]["median_ms"],
            "bundle_bytes": model["bundle_bytes"],
        }
        for name in ("false_status", "detected") if model["frames"] else ():
            figures[name] = model["frames"][name]
        known = {name: float(value) for name, value in figures.items() if value is not None}
        found[model["model"]] = known
    return found


def _model_id(bundle: Bundle, registry: Registry) -> str | None:
    """MLflow's id of a model that is registered here, which then shows the figures too."""
    origin = bundle.provenance
    here = {(one.label, one.run_id) for one in registry.versions(bundle.name)}
    registered = (bundle.label, origin.get("mlflow_run_id")) in here
    return origin.get("mlflow_model_id") if registered else None


def log_comparison(
    compared: ComparedModels, result: dict[str, Any], html: str, registry: Registry
) -> str:
    """Log figures, the patches compared on, report and JSON; return the run's id.

    The figures are the compared models' too, and MLflow shows them on the models' own pages.

    Raises ToktError if the registry cannot be reached or written.
    """
    labels = [model["model"] for model in result["models"]]
    ids = {item.label: _model_id(item.bundle, registry) for item in compared.models}
    experiment = registry.experiment_id()
    with (
        registry.reported(),
        mlflow.start_run(experiment_id=experiment, run_name=RUN_NAME, nested=True) as run,
    ):
        mlflow.set_tags(
            {
                "kind": "compare",
                "models": ", ".join(labels),
                **{f"model_{number}": label for number, label in enumerate(labels, 1)},
                "mode": result["mode"],
                "compared_on": result["what"],
            }
        )
        log_dataset(compared.patches, "evaluation", compared.dataset, compared.what[:_MAX_NAME])
        rows, now = _rows(result), int(time.time() * 1000)
        metrics = [
            Metric(f"{label}/{name}", value, now, 0, ids[label])
            for label, row in rows.items()
            for name, value in row.items()
        ]
        registry.client.log_batch(run.info.run_id, metrics=metrics)
        table = pd.DataFrame([{"model": label, **row} for label, row in rows.items()])
        mlflow.log_table(table, f"{FOLDER}/models.json")
        for name, figure in _figures(compared, result).items():
            mlflow.log_figure(figure, f"{FOLDER}/{name}.png")
        mlflow.log_text(html, f"{FOLDER}/report.html")
        mlflow.log_text(json.dumps(result, allow_nan=False), f"{FOLDER}/comparison.json")
        return str(run.info.run_id)


def has_registry(workspace: Path) -> bool:
    """Whether there is somewhere to log to that a comparison need not make first."""
    return tracking_uri(workspace) != local_uri(workspace) or (workspace / "mlflow.db").is_file()
