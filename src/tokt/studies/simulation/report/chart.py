"""The chart that flights are drawn on: axes in metres, what is solid, start, goal and current."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from tokt.studies.simulation.loop.autopilot import Mode
from tokt.studies.simulation.loop.track import Track
from tokt.studies.simulation.loop.vehicle import HULL_RADIUS_M, Float
from tokt.training.evaluation.pictures import figure_png

COLORS = {
    Mode.TRANSIT: "#2f6db3",
    Mode.AVOID: "#e08a1e",
    Mode.BACK_OFF: "#8e44ad",
    Mode.HOLD: "#7f8c8d",
}
RED, GREEN = "#cc1f2f", "#1c8a4a"
_SOLID, _SOLID_EDGE, _WATER = "#c9d1d6", "#5d6b76", "#1f7a8c"
MARGIN_M = 1.0
EAST_NORTH = [0, 2]
_TALL_IN, _BESIDE_IN = 8.0, 2.6


@dataclass(frozen=True)
class Chart:
    """All that a map shows besides the track.

    Parameters
    ----------
    outlines : sequence of (n, 2) float64
        Of what is solid, seen from above: east and north, metres.
    goal : (3,) float64
        World, metres.
    current_m_s : (3,) floats
        Velocity of the water: east, down, north.
    """

    outlines: Sequence[Float]
    goal: Float
    current_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def goal_place(self) -> Float:
        """(2,) East and north of the goal."""
        return np.asarray(self.goal[EAST_NORTH], np.float64)


def pieces(places: Float) -> list[Float]:
    """(2, 2) each: the lines from each of (n, 2) places to the next."""
    return list(np.stack([places[:-1], places[1:]], axis=1))


def collided(track: Track) -> bool:
    """Whether the hull touched something solid."""
    return bool(track.clearance_m.min() < HULL_RADIUS_M)


def extent(tracks: Sequence[Track], charts: Sequence[Chart]) -> tuple[Float, Float]:
    """(east, north) of the least and the greatest place on a map that shows them all."""
    places = [track.position[:, EAST_NORTH] for track in tracks]
    places += [chart.goal_place[None] for chart in charts]
    places += [outline for chart in charts for outline in chart.outlines]
    everything = np.concatenate(places)
    return everything.min(axis=0) - MARGIN_M, everything.max(axis=0) + MARGIN_M


def sheet(track: Track, chart: Chart, dpi: int) -> tuple[Figure, Axes]:
    """Axes that show a run, with what does not move drawn on them."""
    low, high = extent([track], [chart])
    middle = (low[0] + high[0]) / 2
    half = max((high[0] - low[0]) / 2, 0.2 * (high[1] - low[1]))
    wide = _TALL_IN * 2 * half / (high[1] - low[1]) + _BESIDE_IN
    figure = Figure(figsize=(wide, _TALL_IN), dpi=dpi, layout="constrained")
    axes = figure.subplots()
    axes.set(xlim=(middle - half, middle + half), ylim=(low[1], high[1]))
    axes.set(xlabel="east, m", ylabel="north, m")
    axes.set_aspect("equal")
    axes.grid(alpha=0.25)
    draw_solid(axes, chart.outlines)
    east, north = track.position[0][EAST_NORTH]
    axes.plot(east, north, "^", color="black", ms=7, zorder=4)
    axes.plot(*chart.goal_place, "*", color=GREEN, ms=12, zorder=4)
    _draw_current(axes, chart)
    return figure, axes


def draw_solid(axes: Axes, outlines: Sequence[Float]) -> None:
    """Draw what is solid."""
    for outline in outlines:
        axes.add_patch(Polygon(outline, closed=True, fc=_SOLID, ec=_SOLID_EDGE, lw=0.8, zorder=2))


def png(figure: Figure) -> bytes:
    """A figure as a PNG."""
    return figure_png(figure)


def _draw_current(axes: Axes, chart: Chart) -> None:
    water = np.array([chart.current_m_s[0], chart.current_m_s[2]])
    speed = math.hypot(*water)
    if speed == 0:
        return
    right, low = axes.get_xlim()[1], axes.get_ylim()[0]
    foot = np.array([right - 1.8, low + 1.6])
    way = water / speed
    arrow: Any = {"arrowstyle": "-|>", "color": _WATER, "lw": 1.8}
    axes.annotate("", tuple(foot + way), tuple(foot - way), arrowprops=arrow, zorder=6)
    east, north = foot
    words = f"current\n{speed:.2f} m/s"
    axes.text(east, north - 0.7, words, ha="center", va="top", fontsize=7, color=_WATER)
