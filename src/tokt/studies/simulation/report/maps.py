"""Maps of flights: one as a picture or an animation, or all of a scene side by side.

North is up, metres both ways. The clearance is measured in space and the map is flat: a track that
passes above a tower's feet may come closer to its outline than it did to the tower.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon, Wedge

from tokt.features.common.arrays import F64
from tokt.studies.simulation.loop.autopilot import Mode
from tokt.studies.simulation.loop.scenes import LoopScene
from tokt.studies.simulation.loop.track import Track
from tokt.studies.simulation.loop.vehicle import CAMERA_AHEAD_M, HULL_RADIUS_M
from tokt.studies.simulation.scene.tower import Cuboid, Frustum
from tokt.training.evaluation.pictures import figure_png

_COLORS = {
    Mode.TRANSIT: "#2f6db3",
    Mode.AVOID: "#e08a1e",
    Mode.BACK_OFF: "#8e44ad",
    Mode.HOLD: "#7f8c8d",
    Mode.PILOT: "#16a085",
}
_RED, _GREEN = "#cc1f2f", "#1c8a4a"
_SOLID, _SOLID_EDGE, _WATER = "#c9d1d6", "#5d6b76", "#1f7a8c"
_MARGIN_M = 1.0
_EAST_NORTH = [0, 2]
_TALL_IN, _BESIDE_IN = 8.0, 2.6
_STILL_DPI, _FILM_DPI = 110, 75

_HALF_VIEW_DEG, _VIEW_M = 17.0, 8.0
_FRAME_MS = 120
_MAX_FRAMES = 70
_QUALITY = 75

_WIDE_IN, _WIDEST_MAP_IN = 13.0, 1.3
_GAP_M = 0.8
_COLUMNS = 17
"""Small maps side by side."""
_EVERY = 10
"""Steps from one point of a small track to the next: half a second."""
_SHEET = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)

_RIM_POINTS = 24
_CORNERS = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], np.float64)


@dataclass(frozen=True)
class Chart:
    """All that a map shows besides the track."""

    outlines: Sequence[F64]  # (n, 2) of what is solid, from above: east and north, m
    goal: F64  # (3,), world, m
    current_m_s: tuple[float, float, float]  # the water's velocity: east, down, north

    @classmethod
    def of(cls, scene: LoopScene, t_s: float) -> Chart:
        """A scene's at a time: the outline of each solid is its convex hull from above."""
        outlines = []
        for thing in scene.world.things:
            for solid in thing.shape.solids:
                points = (thing.place(t_s) + _corners(solid))[:, _EAST_NORTH].astype(np.float32)
                outlines.append(np.asarray(cv2.convexHull(points)[:, 0], np.float64))
        return cls(outlines, scene.goal, scene.world.current)


def _corners(solid: Frustum | Cuboid) -> F64:
    """Points whose convex hull is the solid's, but for the roundness of its rims."""
    if isinstance(solid, Cuboid):
        return np.asarray(solid.centre + (_CORNERS * solid.half) @ solid.axes, np.float64)
    return np.concatenate(solid.rims(_RIM_POINTS))


def still(track: Track, chart: Chart) -> bytes:
    """One run as a PNG.

    The track is coloured by what the planner was at; a red cross is where a frame was judged to
    show an obstacle, a grey ring where nothing was known; the circle is the hull where it was
    nearest to something solid.
    """
    figure, axes = _sheet(track, chart, _STILL_DPI)
    pieces, colors = _pieces(track)
    axes.add_collection(LineCollection(pieces, colors=colors, linewidths=1.8, zorder=3))
    unknown = track.at(track.frame_t_s[track.frame_status == -1])
    axes.plot(*unknown[:, _EAST_NORTH].T, "o", mfc="none", mec="0.5", ms=4, zorder=4)
    seen = track.obstacle_places
    axes.plot(*seen[:, _EAST_NORTH].T, "x", color=_RED, ms=5, mew=1.2, zorder=5)
    _draw_nearest(axes, track)
    axes.set_title(f"{track.title}\n{track.method}, seed {track.seed}: {_words(track)}", fontsize=9)
    axes.legend(handles=_legend(track), loc="upper left", bbox_to_anchor=(1.02, 1), fontsize=8)
    return figure_png(figure)


def animation(track: Track, chart: Chart) -> bytes:
    """One run as an animated WebP: the vehicle, what it sees, and its track as it grows.

    Of a quarter of a GIF's size, and in true colours.
    """
    figure, axes = _sheet(track, chart, _FILM_DPI)
    canvas = FigureCanvasAgg(figure)
    axes.set_title(f"{track.title}, {track.method}, seed {track.seed}", fontsize=8)
    moving = _Moving(axes, track)
    canvas.draw()  # type: ignore[no-untyped-call]
    empty = canvas.copy_from_bbox(figure.bbox)  # type: ignore[no-untyped-call]
    frames = min(_MAX_FRAMES, max(2, round(float(track.t_s[-1]))))
    steps = np.unique(np.linspace(0, len(track.t_s) - 1, frames).round().astype(int))
    film = cv2.Animation()
    pictures = []
    for step in steps.tolist():
        canvas.restore_region(empty)  # type: ignore[no-untyped-call]
        moving.show(step)
        rgba = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        pictures.append(cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGR))
    film.frames = pictures
    # The last one stays, before it begins again.
    film.durations = [*[_FRAME_MS] * (len(pictures) - 1), 10 * _FRAME_MS]
    done, data = cv2.imencodeanimation(".webp", film, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    if not done:
        raise RuntimeError("OpenCV wrote no WebP")
    return bytes(data)


def overview(tracks: Sequence[Track], charts: Sequence[Chart]) -> bytes:
    """All runs of a scene and a method, one small map each, by seed; red where it collided."""
    low, high = _extent(tracks, charts)
    wide, tall = high - low + _GAP_M
    columns = min(_COLUMNS, len(tracks))
    rows = math.ceil(len(tracks) / columns)
    across = min(_WIDE_IN, columns * _WIDEST_MAP_IN)
    height = across * rows * tall / (columns * wide)
    size = (max(across, 5.0), height + 0.6)
    figure = Figure(figsize=size, dpi=_STILL_DPI, layout="constrained")
    axes = figure.subplots()
    for number, (track, chart) in enumerate(zip(tracks, charts, strict=True)):
        row, column = divmod(number, columns)
        corner = np.array([column * wide, -row * tall])
        _draw_small(axes, track, chart, corner - low, corner + _SHEET * (high - low))
    axes.set(xlim=(-_GAP_M, columns * wide), ylim=(-(rows - 1) * tall - _GAP_M, tall))
    axes.set_aspect("equal")
    axes.set_axis_off()
    hits = sum(_collided(track) for track in tracks)
    axes.set_title(
        f"{tracks[0].title}: {tracks[0].method}, {len(tracks)} runs, {hits} collisions", fontsize=10
    )
    return figure_png(figure)


def _pieces(track: Track) -> tuple[list[F64], list[str]]:
    """The lines (2, 2) from each place of a track to the next, and their colours."""
    places = track.position[:, _EAST_NORTH]
    pieces = list(np.stack([places[:-1], places[1:]], axis=1))
    return pieces, [_COLORS[Mode(mode)] for mode in track.mode[1:]]


def _collided(track: Track) -> bool:
    """Whether the hull touched something solid."""
    return bool(track.clearance_m.min() < HULL_RADIUS_M)


def _extent(tracks: Sequence[Track], charts: Sequence[Chart]) -> tuple[F64, F64]:
    """(east, north) of the least and the greatest place on a map that shows them all."""
    places = [track.position[:, _EAST_NORTH] for track in tracks]
    places += [chart.goal[None, _EAST_NORTH] for chart in charts]
    places += [outline for chart in charts for outline in chart.outlines]
    everything = np.concatenate(places)
    return everything.min(axis=0) - _MARGIN_M, everything.max(axis=0) + _MARGIN_M


def _sheet(track: Track, chart: Chart, dpi: int) -> tuple[Figure, Axes]:
    """Axes that show a run, with what does not move drawn on them."""
    low, high = _extent([track], [chart])
    middle = (low[0] + high[0]) / 2
    half = max((high[0] - low[0]) / 2, 0.2 * (high[1] - low[1]))
    wide = _TALL_IN * 2 * half / (high[1] - low[1]) + _BESIDE_IN
    figure = Figure(figsize=(wide, _TALL_IN), dpi=dpi, layout="constrained")
    axes = figure.subplots()
    axes.set(xlim=(middle - half, middle + half), ylim=(low[1], high[1]))
    axes.set(xlabel="east, m", ylabel="north, m")
    axes.set_aspect("equal")
    axes.grid(alpha=0.25)
    _draw_solid(axes, chart.outlines)
    axes.plot(*track.position[0][_EAST_NORTH], "^", color="black", ms=7, zorder=4)
    axes.plot(*chart.goal[_EAST_NORTH], "*", color=_GREEN, ms=12, zorder=4)
    _draw_current(axes, chart)
    return figure, axes


def _draw_solid(axes: Axes, outlines: Sequence[F64]) -> None:
    for outline in outlines:
        axes.add_patch(Polygon(outline, closed=True, fc=_SOLID, ec=_SOLID_EDGE, lw=0.8, zorder=2))


def _draw_current(axes: Axes, chart: Chart) -> None:
    water = np.array(chart.current_m_s)[_EAST_NORTH]
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


def _words(track: Track) -> str:
    if _collided(track):
        return f"collided after {track.t_s[-1]:.0f} s"
    end = "reached the goal" if track.reached else "did not reach the goal"
    return f"{end}, {track.t_s[-1]:.0f} s"


def _draw_nearest(axes: Axes, track: Track) -> None:
    clearance = float(track.clearance_m.min())
    if not math.isfinite(clearance):
        return
    color = _RED if clearance < HULL_RADIUS_M else "black"
    place = tuple(track.position[track.nearest][_EAST_NORTH])
    axes.add_patch(Circle(place, HULL_RADIUS_M, fill=False, ec=color, lw=1.2, zorder=6))
    words = f"clearance {clearance - HULL_RADIUS_M:.2f} m"
    paper = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1}
    style: Any = {"fontsize": 8, "color": color, "bbox": paper, "zorder": 7}
    axes.annotate(words, place, (10, 14), textcoords="offset points", **style)


def _legend(track: Track) -> list[Line2D]:
    """Only what occurs."""
    lines = [
        Line2D([], [], color=_COLORS[mode], lw=2, label=mode.value)
        for mode in Mode
        if mode in track.mode
    ]

    def mark(marker: str, label: str, **style: object) -> Line2D:
        return Line2D([], [], ls="", marker=marker, label=label, **style)  # type: ignore[arg-type]

    if (track.frame_status == 1).any():
        lines.append(mark("x", "status 1", color=_RED))
    if (track.frame_status == -1).any():
        lines.append(mark("o", "unknown", mfc="none", mec="0.5"))
    if math.isfinite(track.clearance_m.min()):
        lines.append(mark("o", "hull, nearest", mfc="none", mec="black", ms=9))
    return [*lines, mark("^", "start", color="black"), mark("*", "goal", color=_GREEN, ms=10)]


class _Moving:
    """The moving parts of an animation."""

    def __init__(self, axes: Axes, track: Track) -> None:
        self._axes, self._track = axes, track
        self._pieces, self._colors = _pieces(track)
        self._track_line = LineCollection([], linewidths=1.6, animated=True, zorder=3)
        self._view = Wedge((0, 0), _VIEW_M, 0, 1, color="#f3d36b", alpha=0.35, animated=True)
        self._hull = Circle((0, 0), HULL_RADIUS_M, fill=False, lw=1.4, animated=True, zorder=5)
        self._crosses = Line2D([], [], ls="", marker="x", ms=4, color=_RED, animated=True, zorder=4)
        self._words = axes.text(
            0.02, 0.99, "", transform=axes.transAxes, va="top", fontsize=8, animated=True
        )
        axes.add_collection(self._track_line)
        axes.add_patch(self._view)
        axes.add_patch(self._hull)
        axes.add_line(self._crosses)

    def show(self, step: int) -> None:
        """Draw the moment of a step."""
        track, t_s = self._track, float(self._track.t_s[step])
        mode, place = Mode(track.mode[step]), track.position[step, _EAST_NORTH]
        self._track_line.set_segments(self._pieces[:step])
        self._track_line.set_color(self._colors[:step])
        touches = track.clearance_m[step] < HULL_RADIUS_M
        self._hull.set(center=tuple(place), edgecolor=_RED if touches else "black")
        heading = float(track.heading[step])
        ahead = np.array([math.sin(heading), math.cos(heading)])
        straight = 90.0 - math.degrees(heading)
        self._view.set(
            center=tuple(place + CAMERA_AHEAD_M * ahead),
            theta1=straight - _HALF_VIEW_DEG,
            theta2=straight + _HALF_VIEW_DEG,
        )
        seen = int((track.frame_t_s[track.frame_status == 1] <= t_s).sum())
        self._crosses.set_data(track.obstacle_places[:seen, _EAST_NORTH].T)
        self._words.set_text(f"{t_s:5.1f} s  {mode.value}")
        self._words.set_color(_COLORS[mode])
        for artist in (self._view, self._track_line, self._crosses, self._hull, self._words):
            self._axes.draw_artist(artist)


def _draw_small(axes: Axes, track: Track, chart: Chart, shift: F64, sheet: F64) -> None:
    """Draw one run of many, moved by `shift`, on a sheet with these corners."""
    hit = _collided(track)
    axes.add_patch(Polygon(sheet, fc="#fdecea" if hit else "#f7f9fa", ec="0.85", lw=0.5))
    _draw_solid(axes, [outline + shift for outline in chart.outlines])
    places = track.position[:, _EAST_NORTH] + shift
    changes = np.flatnonzero(track.mode[1:] != track.mode[:-1]) + 1
    for begin, end in pairwise([0, *changes.tolist(), len(track.mode) - 1]):
        way = places[begin : end + 1]
        # The first and the last of a stretch of one mode, and some between.
        kept = np.unique([*range(0, len(way), _EVERY), len(way) - 1])
        axes.plot(*way[kept].T, color=_COLORS[Mode(track.mode[begin])], lw=0.9, zorder=3)
    seen = track.obstacle_places[:, _EAST_NORTH] + shift
    axes.plot(*seen.T, "x", color=_RED, ms=1.6, mew=0.5, zorder=4)
    if math.isfinite(track.clearance_m.min()):
        edge = _RED if hit else "0.3"
        place = places[track.nearest]
        axes.add_patch(Circle(place, HULL_RADIUS_M, fill=False, ec=edge, lw=0.6, zorder=5))
    left, top = sheet[3]
    axes.text(left + 0.3, top - 0.3, str(track.seed), fontsize=5, va="top", color="0.4")
