"""A soak as a picture: latency over the frames, memory over the frames, and the latency's tail."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tokt.training.evaluation.pictures import figure_png

from .attend import REFUSED, SWITCHED
from .run import Run
from .verdict import MAX_TAIL, Soak, growth_words

_DPI = 130
_BLOCKS = 200
_LINES = {50.0: "median", 99.0: "p99", 99.9: "p99.9", 100.0: "longest"}
_MARKS = {SWITCHED: ("#55a868", "another model"), REFUSED: ("#c44e52", "a model refused")}


def chart_png(found: Soak) -> bytes:
    figure = Figure(figsize=(10.5, 9.0), layout="constrained")
    over_time, memory, tail = figure.subplots(3, 1)
    _draw_latency(over_time, found.whole)
    _draw_memory(memory, found)
    _draw_tail(tail, found)
    extent = found.whole.extent
    figure.suptitle(
        f"tokt: {extent.frames} frames in {found.whole.seconds / 60:.1f} minutes, "
        f"{found.whole.attendant.asked[SWITCHED]} hot reloads; {found.about['machine']['cpu']}"
    )
    return figure_png(figure, _DPI)


def _draw_latency(axes: Any, run: Run) -> None:
    times = run.age_s[run.age_s > 0] * 1000
    parts = np.array_split(times, min(_BLOCKS, len(times)))
    places = np.cumsum([len(part) for part in parts])
    for percentile, name in _LINES.items():
        values = [np.percentile(part, percentile) for part in parts]
        axes.plot(places, values, lw=1.0, label=name)
    for event, (color, words) in _MARKS.items():
        label: str | None = words
        for name, number in run.happened:
            if name == event:
                axes.axvline(number, color=color, lw=0.7, ls=":", label=label)
                label = None
    axes.set_yscale("log")
    _dress(axes, "frame", "arrival to report, ms", ncols=6, loc="upper right")


def _draw_memory(axes: Any, found: Soak) -> None:
    seen = found.whole.attendant
    frames, resident = seen.column("frames"), seen.column("resident")
    axes.plot(frames, resident / 1e6, lw=0.8, color="#3b75af")
    grown = found.growth
    if grown is not None:
        ends = frames[-1] * (1 - np.linspace(0.8, 0, 2))
        middle = (grown["first_bytes"] + grown["last_bytes"]) / 2 / 1e6
        rise = grown["bytes_per_frame"] * (ends - ends.mean()) / 1e6
        axes.plot(ends, middle + rise, color="black", lw=1.0, label=growth_words(grown))
    axes.set_ylim(bottom=0)
    _dress(axes, "frame", "memory, MB")


def _draw_tail(axes: Any, found: Soak) -> None:
    for run, name in ((found.whole, "everything around it"), (found.bare, "the bare loop")):
        axes.ecdf(run.age_s[run.age_s > 0] * 1000, complementary=True, lw=1.2, label=name)
    median = found.latency["age"]["median_ms"]
    words = f"{MAX_TAIL:g} x the median"
    axes.axvline(MAX_TAIL * median, color="0.3", lw=0.9, ls=":", label=words)
    axes.axhline(1e-3, color="0.3", lw=0.9, ls=":")
    axes.set_xscale("log")
    axes.set_xlim(left=median / 3)
    axes.set_yscale("log")
    _dress(axes, "arrival to report, ms", "part of frames that took longer")


def _dress(axes: Any, x: str, y: str, **legend: Any) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, frameon=False, **legend)
