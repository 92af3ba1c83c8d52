"""A soak as a picture: latency and memory over the frames, the latency's tail, and the faults."""

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tokt.training.evaluation.pictures import figure_png

from .run import Run
from .verdict import MAX_TAIL, Soak, growth_words

_DPI = 110
_BLOCKS = 200
_LINES = {50.0: "median", 99.0: "p99", 99.9: "p99.9", 100.0: "longest"}
_GOES_ON, _RESTARTS, _WRONG, _BLUE = "#55a868", "#dd8452", "#c44e52", "#3b75af"


def chart_png(found: Soak) -> bytes:
    figure = Figure(figsize=(19.0, 11.0), layout="constrained")
    places = [["latency", "faults"], ["memory", "faults"], ["tail", "faults"]]
    axes = figure.subplot_mosaic(places, width_ratios=[1.25, 1.0])
    _draw_latency(axes["latency"], found)
    _draw_memory(axes["memory"], found)
    _draw_tail(axes["tail"], found)
    _draw_faults(axes["faults"], found)
    frames, injections = found.whole.extent.frames, found.around.injections
    figure.suptitle(
        f"tokt: {frames} frames in {found.whole.seconds / 60:.1f} minutes, {len(injections)} "
        f"faults, {found.around.restarts} restarts; {found.about['machine']['cpu']}"
    )
    return figure_png(figure, _DPI)


def _draw_latency(axes: Any, found: Soak) -> None:
    numbers = np.flatnonzero(found.whole.age_s)
    parts = np.array_split(numbers, min(_BLOCKS, len(numbers)))
    places = [part[-1] for part in parts]
    for percentile, name in _LINES.items():
        values = [np.percentile(found.whole.age_s[part] * 1000, percentile) for part in parts]
        axes.plot(places, values, lw=1.0, label=name)
    for restarts, color, words in (
        (False, _GOES_ON, "a fault"),
        (True, _RESTARTS, "a fault, and a restart"),
    ):
        made = [each.number for each in found.around.injections if each.restarts is restarts]
        whole = axes.get_xaxis_transform()
        if made:
            axes.vlines(made, 0, 1, color, ":", label=words, transform=whole, lw=0.7)
    axes.set(xlabel="frame", ylabel="arrival to report, ms", yscale="log")
    _dress(axes, ncols=6, loc="upper right")


def _draw_memory(axes: Any, found: Soak) -> None:
    seen = found.around.attendant
    given, lives = seen.column("given"), seen.column("life")
    ends = [0, *(np.flatnonzero(np.diff(lives)) + 1), len(given)]
    words = f"runtimes: {growth_words(found.growth)}" if found.growth else "runtimes"
    for name, color, label in (
        ("resident", _BLUE, words),
        ("watchdog_resident", "0.4", "their watchdog"),
    ):
        for start, end in pairwise(ends):
            part = slice(start, end)
            axes.plot(given[part], seen.column(name)[part] / 1e6, color, lw=0.8, label=label)
            label = ""
    axes.set(xlabel="frame", ylabel="memory, MB", ylim=(0, None))
    _dress(axes)


def _draw_tail(axes: Any, found: Soak) -> None:
    runs: tuple[tuple[Run, str], ...] = (
        (found.whole, "everything around it, faults too"),
        (found.bare, "the bare loop"),
    )
    for run, name in runs:
        axes.ecdf(run.age_s[run.age_s > 0] * 1000, complementary=True, lw=1.2, label=name)
    median = found.latency["age"]["median_ms"]
    words = f"{MAX_TAIL:g} x the median"
    axes.axvline(MAX_TAIL * median, color="0.3", lw=0.9, ls=":", label=words)
    axes.axhline(1e-3, color="0.3", lw=0.9, ls=":")
    axes.set(xlabel="arrival to report, ms", ylabel="part of frames that took longer")
    axes.set(xscale="log", yscale="log", xlim=(median / 3, None))
    _dress(axes)


def _draw_faults(axes: Any, found: Soak) -> None:
    """Draw for each row the longest silence and its bound; what holds is green."""
    results = found.faults[::-1]
    places = np.arange(len(results))
    bounds, longest = (
        np.array([getattr(each, name) for each in results], float)
        for name in ("bound_s", "longest_s")
    )
    held = [each.is_heard and not each.missing for each in results]
    colors = [_GOES_ON if each else _WRONG for each in held]
    axes.barh(places, longest, color=colors, height=0.6, label="longest silence of v2")
    axes.plot(bounds, places, "|", color="black", ms=9, label="its bound")
    words = [f"{each.words} ({each.times})" for each in results]
    axes.set_yticks(places, words, fontsize=7)
    axes.set(xlabel="s", xlim=(0, None), ylim=(-1, len(results)))
    axes.set_title("faults injected, and how often; red: too long, or not reported", fontsize=9)
    _dress(axes, loc="lower right")


def _dress(axes: Any, **legend: Any) -> None:
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, frameon=False, **legend)
