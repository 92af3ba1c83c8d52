"""All runs of a scene and a method side by side, a small map each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from tokt.studies.simulation.loop.autopilot import Mode
from tokt.studies.simulation.loop.track import Track
from tokt.studies.simulation.loop.vehicle import HULL_RADIUS_M, Float

from .chart import COLORS, EAST_NORTH, RED, Chart, collided, draw_solid, extent, png

_WIDE_IN, _WIDEST_MAP_IN = 13.0, 1.3
_GAP_M = 0.8
_EVERY = 10
"""Steps from one point of a small track to the next: half a second."""
_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)


def overview(tracks: Sequence[Track], charts: Sequence[Chart], columns: int = 17) -> bytes:
    """All runs of a scene and a method, one small map each, by seed; red where it collided.

    Parameters
    ----------
    tracks : sequence of Track
    charts : sequence of Chart
        One each.
    columns : int
        Maps side by side.

    Raises
    ------
    ValueError
        If there is no track, or not a chart for each.
    """
    if not tracks or len(tracks) != len(charts):
        raise ValueError(f"{len(tracks)} tracks and {len(charts)} charts")
    low, high = extent(tracks, charts)
    wide, tall = high - low + _GAP_M
    columns = min(columns, len(tracks))
    rows = math.ceil(len(tracks) / columns)
    across = min(_WIDE_IN, columns * _WIDEST_MAP_IN)
    height = across * rows * tall / (columns * wide)
    figure = Figure(figsize=(max(across, 5.0), height + 0.6), dpi=110, layout="constrained")
    axes = figure.subplots()
    for number, (track, chart) in enumerate(zip(tracks, charts, strict=True)):
        row, column = divmod(number, columns)
        corner = np.array([column * wide, -row * tall])
        _draw_one(axes, track, chart, corner - low, corner + _CORNERS * (high - low))
    axes.set(xlim=(-_GAP_M, columns * wide), ylim=(-(rows - 1) * tall - _GAP_M, tall))
    axes.set_aspect("equal")
    axes.set_axis_off()
    hits = sum(collided(track) for track in tracks)
    axes.set_title(
        f"{tracks[0].title}: {tracks[0].method}, {len(tracks)} runs, {hits} collisions", fontsize=10
    )
    return png(figure)


def _draw_one(axes: Axes, track: Track, chart: Chart, shift: Float, sheet: Float) -> None:
    """Draw one run, moved by `shift`, on a sheet with these corners."""
    hit = collided(track)
    axes.add_patch(Polygon(sheet, fc="#fdecea" if hit else "#f7f9fa", ec="0.85", lw=0.5))
    draw_solid(axes, [outline + shift for outline in chart.outlines])
    places = track.position[:, EAST_NORTH] + shift
    for begin, end in _stretches(track):
        way = places[begin : end + 1]
        # The first and the last of a stretch, and some between.
        kept = np.unique([*range(0, len(way), _EVERY), len(way) - 1])
        axes.plot(*way[kept].T, color=COLORS[Mode(track.mode[begin])], lw=0.9, zorder=3)
    seen = track.obstacle_places[:, EAST_NORTH] + shift
    axes.plot(*seen.T, "x", color=RED, ms=1.6, mew=0.5, zorder=4)
    if math.isfinite(track.clearance_m.min()):
        place = places[track.nearest]
        edge = RED if hit else "0.3"
        axes.add_patch(Circle(place, HULL_RADIUS_M, fill=False, ec=edge, lw=0.6, zorder=5))
    left, top = sheet[3]
    axes.text(left + 0.3, top - 0.3, str(track.seed), fontsize=5, va="top", color="0.4")


def _stretches(track: Track) -> list[tuple[int, int]]:
    """Where each run of one mode begins and ends, in steps."""
    changes = np.flatnonzero(track.mode[1:] != track.mode[:-1]) + 1
    marks = [0, *changes.tolist(), len(track.mode) - 1]
    return list(pairwise(marks))
