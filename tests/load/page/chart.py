"""The labelling page's bench as one chart: times against what is asked, and actions."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tests.load.effort.effort import LabellingEffort
from tests.load.report import Timing, machine_words
from tokt.training.evaluation.pictures import figure_png

_KEPT, _MISSED, _WITHOUT, _ASKED = "#3b75af", "#c44e52", "#a0a0a0", "#dd8452"
_DPI = 130
_WIDTH, _ROW, _REST = 10.5, 0.42, 1.6  # inches: the chart, a row, and titles and axis of a part
_ROOM = 3.0  # axis length over the longest bar: room for the figures at its end


def label_chart_png(times, efforts, about) -> bytes:
    """Bars of the 95th percentiles with what is asked, and of the actions with and without.

    `about` holds ``machine``, ``mission`` and ``browser`` as in the bench's JSON.
    """
    parts = [(draw, of) for draw, of in ((_draw_times, times), (_draw_efforts, efforts)) if of]
    heights = [_REST + _ROW * len(of) for _, of in parts]
    figure = Figure(figsize=(_WIDTH, 0.6 + sum(heights)), layout="constrained")
    axes = figure.subplots(len(parts), 1, squeeze=False, height_ratios=heights)[:, 0]
    for (draw, of), panel in zip(parts, axes, strict=True):
        draw(panel, of, np.arange(len(of)))
        panel.invert_yaxis()
        panel.grid(axis="x", alpha=0.3)
        panel.spines[["top", "right"]].set_visible(False)
    words = f"tokt label on mission {about['mission']}\n{about['browser']}; {machine_words(about)}"
    figure.suptitle(words, fontsize=10)
    return figure_png(figure, _DPI)


def _draw_times(axes: Any, times: Sequence[Timing], rows: Any) -> None:
    judged = [time.at(time.percentile) for time in times]
    axes.barh(rows, judged, 0.6, color=[_MISSED if t.holds is False else _KEPT for t in times])
    axes.plot([time.at(50) for time in times], rows, "|", color="white", ms=12)
    words = [f"{time_ms:.3g} ms" for time_ms in judged]
    longest = _mark_asked(axes, rows, [time.asked_ms for time in times], judged, words)
    what = "ms (bar: the percentile that is judged; white: median; diamond: asked)"
    axes.set(xscale="log", xlim=(1, longest * _ROOM), xlabel=what)
    axes.set_yticks(rows, [time.name for time in times])
    axes.set_title("waiting", loc="left", fontsize=10)


def _draw_efforts(axes: Any, efforts: Sequence[LabellingEffort], rows: Any) -> None:
    counts = np.array([(each.without, each.with_model) for each in efforts]).T
    colors = [_MISSED if each.holds is False or each.wrong else _KEPT for each in efforts]
    axes.barh(rows - 0.2, counts[0], 0.36, color=_WITHOUT)
    axes.barh(rows + 0.2, counts[1], 0.36, color=colors)
    words = [f"{e.with_model}" + (", LABELS DIFFER" if e.wrong else "") for e in efforts]
    longest = _mark_asked(axes, rows, [e.asked for e in efforts], counts.max(0), words)
    what = "keys, clicks and drags (grey: without suggestions; diamond: asked)"
    axes.set(xlim=(0, 1.25 * longest), xlabel=what)
    axes.set_yticks(rows, [e.stretch + (", unsure too" if e.unsure else "") for e in efforts])
    axes.set_title("labelling effort", loc="left", fontsize=10)


def _mark_asked(axes, rows, asked, ends, words) -> float:
    """Mark what is asked of each row, and write its words behind; the longest row's end."""
    asked = np.array(asked, float)  # nan where nothing is
    axes.plot(asked, rows, "D", color=_ASKED, ms=6)
    ends = np.fmax(ends, asked)
    axes.bar_label(axes.barh(rows, ends, alpha=0), words, padding=8)
    return float(ends.max())
