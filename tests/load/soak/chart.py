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
        numbers = [number for name, number in run.happened if name == event]
        whole = axes.get_xaxis_transform()
        if numbers:
            axes.vlines(numbers, 0, 1, color, ":", words, transform=whole, lw=0.7)
    axes.set(xlabel="frame", ylabel="arrival to report, ms", yscale="log")
    _dress(axes, ncols=6, loc="upper right")


def _draw_memory(axes: Any, found: Soak) -> None:
    seen = found.whole.attendant
    frames, resident = seen.column("frames"), seen.column("resident")
    axes.plot(frames, resident / 1e6, lw=0.8, color="#3b75af")
    if grown := found.growth:
        middle = frames[-1] * 0.6, (grown["first_bytes"] + grown["last_bytes"]) / 2e6
        slope = grown["bytes_per_frame"] / 1e6
        axes.axline(middle, slope=slope, color="black", lw=1.0, label=growth_words(grown))
    axes.set(xlabel="frame", ylabel="memory, MB", ylim=(0, None))
    _dress(axes)


def _draw_tail(axes: Any, found: Soak) -> None:
    for run, name in ((found.whole, "everything around it"), (found.bare, "the bare loop")):
        axes.ecdf(run.age_s[run.age_s > 0] * 1000, complementary=True, lw=1.2, label=name)
    median = found.latency["age"]["median_ms"]
    words = f"{MAX_TAIL:g} x the median"
    axes.axvline(MAX_TAIL * median, color="0.3", lw=0.9, ls=":", label=words)
    axes.axhline(1e-3, color="0.3", lw=0.9, ls=":")
    axes.set(xlabel="arrival to report, ms", ylabel="part of frames that took longer")
    axes.set(xscale="log", yscale="log", xlim=(median / 3, None))
    _dress(axes)


def _dress(axes: Any, **legend: Any) -> None:
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, frameon=False, **legend)
