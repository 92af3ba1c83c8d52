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

    `about` holds ``machine``, ``mission`` and ``browser`` as in the bench's JSON.
    """
    parts = [(draw, of) for draw, of in ((_draw_times, times), (_draw_efforts, efforts)) if of]
    heights = [_REST + _ROW * len(of) for _, of in parts]
    figure = Figure(figsize=(_WIDTH, 0.6 + sum(heights)), layout="constrained")
    axes = figure.subplots(len(parts), 1, squeeze=False, height_ratios=heights)[:, 0]
    for (draw, of), panel in zip(parts, axes, strict=True):
        draw(panel, of)
    computer = about["machine"]
    figure.suptitle(
        f"tokt label on mission {about['mission']}\n{about['browser']}; {computer['cpu']}, "
        f"{computer['cores']} core(s)",
        fontsize=10,
    )
    return figure_png(figure, _DPI)


def _draw_times(axes: Any, times: Sequence[Timing]) -> None:
    """A bar from the median to the judged percentile, and a mark for what is asked."""
    ends = []
    for place, time in enumerate(times):
        judged = time.at(time.percentile)
        ends.append(max(judged, time.asked_ms or 0))
        color = _MISSED if time.holds is False else _KEPT
        axes.barh(place, judged, color=color, height=0.6)
        axes.plot(time.at(50), place, "|", color="white", ms=12)
        if time.asked_ms is not None:
            axes.plot(time.asked_ms, place, "D", color=_ASKED, ms=6)
        _write(axes, f"{judged:.3g} ms", ends[-1], place)
    axes.set_xscale("log")
    axes.set_xlim(1, max(ends) * _ROOM)
    axes.set_xlabel("ms (bar: the percentile that is judged; white: median; diamond: asked)")
    _dress(axes, [time.name for time in times], "waiting")


def _draw_efforts(axes: Any, efforts: Sequence[LabellingEffort]) -> None:
    """Two bars a way: actions without suggestions and with."""
    ends = []
    for place, effort in enumerate(efforts):
        without, with_model = sum(effort.without), sum(effort.with_model)
        ends.append(max(without, with_model))
        color = _MISSED if effort.holds is False or effort.wrong else _KEPT
        axes.barh(place - 0.2, without, color=_WITHOUT, height=0.36)
        axes.barh(place + 0.2, with_model, color=color, height=0.36)
        text = f"{effort.ratio:.1f}x fewer" + (", LABELS DIFFER" if effort.wrong else "")
        _write(axes, text, ends[-1], place)
    axes.set_xlim(0, 1.25 * max(ends))
    axes.set_xlabel("keys, clicks and drags (grey: without suggestions; colour: with)")
    _dress(axes, [effort.way.words for effort in efforts], "labelling effort")


def _write(axes: Any, text: str, end: float, place: int) -> None:
    """A figure at the end of a bar."""
    axes.annotate(text, (end, place), (8, 0), textcoords="offset points", va="center")


def _dress(axes: Any, names: Sequence[str], title: str) -> None:
    axes.set_title(title, loc="left", fontsize=10)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(axis="x", alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
