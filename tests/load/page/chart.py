"""The labelling page's bench as one chart: times against what is asked, and actions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from tests.load.effort.effort import LabellingEffort
from tests.load.report import Timing
from tokt.training.evaluation.pictures import figure_png

_KEPT, _MISSED, _WITHOUT, _ASKED = "#3b75af", "#c44e52", "#a0a0a0", "#dd8452"
_DPI = 130
_WIDTH, _ROW, _REST = 10.5, 0.42, 1.6
"""Inches: the chart, a row, and titles and axis of a part."""
_ROOM = 3.0
"""Axis length over the longest bar: room for the figures at its end."""


def label_chart_png(
    times: Sequence[Timing], efforts: Sequence[LabellingEffort], about: Mapping[str, Any]
) -> bytes:
    """Bars of the 95th percentiles with what is asked, and of the actions with and without.

    Parameters
    ----------
    times : sequence of Timing
    efforts : sequence of LabellingEffort
    about : mapping
        ``machine``, ``mission``, ``browser`` as in the bench's JSON.

    Returns
    -------
    bytes
        A PNG file.
    """
    parts = [part for part in (times, efforts) if part]
    heights = [_REST + _ROW * len(part) for part in parts]
    figure = Figure(figsize=(_WIDTH, 0.6 + sum(heights)), layout="constrained")
    axes = figure.subplots(len(parts), 1, squeeze=False, height_ratios=heights)[:, 0]
    for place, part in enumerate(parts):
        if part is times:
            _draw_times(axes[place], times)
        else:
            _draw_efforts(axes[place], efforts)
    computer = about["machine"]
    figure.suptitle(
        f"tokt label on mission {about['mission']}\n{about['browser']}; {computer['cpu']}, "
        f"{computer['cores']} core(s)",
        fontsize=10,
    )
    return figure_png(figure, _DPI)


def _draw_times(axes: Any, times: Sequence[Timing]) -> None:
    """A bar from the median to the judged percentile, and a mark for what is asked."""
    for place, time in enumerate(times):
        judged = time.at(time.percentile)
        color = _MISSED if time.holds is False else _KEPT
        axes.barh(place, judged, color=color, height=0.6)
        axes.plot(time.at(50), place, "|", color="white", ms=12)
        if time.asked_ms is not None:
            axes.plot(time.asked_ms, place, "D", color=_ASKED, ms=6)
        end = max(judged, time.asked_ms or 0)
        text = f"{judged:.3g} ms"
        axes.annotate(text, (end, place), (8, 0), textcoords="offset points", va="center")
    ends = [max(time.at(time.percentile), time.asked_ms or 0) for time in times]
    axes.set_xscale("log")
    axes.set_xlim(1, max(ends) * _ROOM)
    axes.set_xlabel("ms (bar: the percentile that is judged; white: median; diamond: asked)")
    _dress(axes, [time.name for time in times], "waiting")


def _draw_efforts(axes: Any, efforts: Sequence[LabellingEffort]) -> None:
    """Two bars a way: actions without suggestions and with."""
    for place, effort in enumerate(efforts):
        without, with_model = sum(effort.without), sum(effort.with_model)
        color = _MISSED if effort.holds is False or effort.wrong else _KEPT
        axes.barh(place - 0.2, without, color=_WITHOUT, height=0.36)
        axes.barh(place + 0.2, with_model, color=color, height=0.36)
        text = f"{effort.ratio:.1f}x fewer" + (", LABELS DIFFER" if effort.wrong else "")
        axes.annotate(
            text, (max(without, with_model), place), (8, 0), textcoords="offset points", va="center"
        )
    axes.set_xlim(0, 1.25 * max(max(sum(e.without), sum(e.with_model)) for e in efforts))
    axes.set_xlabel("keys, clicks and drags (grey: without suggestions; colour: with)")
    _dress(axes, [effort.way.words for effort in efforts], "labelling effort")


def _dress(axes: Any, names: Sequence[str], title: str) -> None:
    axes.set_title(title, loc="left", fontsize=10)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(axis="x", alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
