"""Maps of flights: one as a picture or an animation, or all of a scene side by side.

North is up, metres both ways. The clearance is measured in space and the map is flat: a track that
passes above a tower's feet may come closer to its outline than it did to the tower.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Wedge

from tokt.features.common.arrays import F64
from tokt.inference.verdict import OBSTACLE, UNKNOWN
from tokt.training.evaluation.pictures import figure_png, new_figure
from tokt_studies.simulation.loop.autopilot import Mode
from tokt_studies.simulation.loop.scenes import LoopScene
from tokt_studies.simulation.loop.track import Track
from tokt_studies.simulation.loop.vehicle import CAMERA_AHEAD_M, HULL_RADIUS_M

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
_SHEET = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)


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
                points = (thing.place(t_s) + solid.hull())[:, _EAST_NORTH].astype(np.float32)
                outlines.append(np.asarray(cv2.convexHull(points)[:, 0], np.float64))
        return cls(outlines, scene.goal, scene.world.current)


def still(track: Track, chart: Chart) -> bytes:
    """One run as a PNG.

    The track is coloured by what the planner was at; a red cross is where a frame was judged to
    show an obstacle, a grey ring where nothing was known; the circle is the hull where it was
    nearest to something solid.
    """
    figure, axes = _sheet(track, chart, _STILL_DPI)
    _draw_way(axes, track.mode, track.position[:, _EAST_NORTH], 1.8)
    _draw_frames(axes, track, UNKNOWN, label="unknown", marker="o", mfc="none", mec="0.5", ms=4)
    _draw_frames(axes, track, OBSTACLE, label="status 1", marker="x", color=_RED, ms=5, mew=1.2)
    color = _RED if track.collided else "black"
    _draw_nearest(axes, track, color, 1.2)
    if math.isfinite(track.least_m):
        axes.plot([], [], "o", mfc="none", mec="black", ms=9, label="hull, nearest")
        place = tuple(track.position[track.nearest][_EAST_NORTH])
        words = f"clearance {track.least_m - HULL_RADIUS_M:.2f} m"
        paper = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1}
        style: Any = {"fontsize": 8, "color": color, "bbox": paper, "zorder": 7}
        axes.annotate(words, place, (10, 14), textcoords="offset points", **style)
    end = "reached the goal," if track.reached else "did not reach the goal,"
    if not math.isnan(track.station[0]):
        end = f"{'kept' if track.reached else 'lost'} its station,"
    end = f"{'collided after' if track.collided else end} {track.t_s[-1]:.0f} s"
    axes.set_title(f"{track.title}\n{track.method}, seed {track.seed}: {end}", fontsize=9)
    axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1), fontsize=8)
    return figure_png(figure)


def animation(track: Track, chart: Chart) -> bytes:
    """One run as an animated WebP: the vehicle, what it sees, and its track as it grows.

    Of a quarter of a GIF's size, and in true colours.
    """
    figure, axes = _sheet(track, chart, _FILM_DPI)
    canvas = FigureCanvasAgg(figure)
    axes.set_title(f"{track.title}, {track.method}, seed {track.seed}", fontsize=8)
    canvas.draw()  # type: ignore[no-untyped-call]
    empty = canvas.copy_from_bbox(figure.bbox)  # type: ignore[no-untyped-call]
    frames = min(_MAX_FRAMES, max(2, round(float(track.t_s[-1]))))
    steps = np.unique(np.linspace(0, len(track.t_s) - 1, frames).round().astype(int))
    film = cv2.Animation()
    pictures = []
    for step in steps.tolist():
        canvas.restore_region(empty)  # type: ignore[no-untyped-call]
        for artist in _moment(axes, track, step):
            axes.draw_artist(artist)
            artist.remove()
        rgba = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        pictures.append(cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGR))
    film.frames = pictures
    # The last one stays, before it begins again.
    film.durations = [*[_FRAME_MS] * (len(pictures) - 1), 10 * _FRAME_MS]
    done, data = cv2.imencodeanimation(".webp", film, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    if not done:
        raise RuntimeError("OpenCV wrote no WebP")
    return bytes(data)


def _moment(axes: Axes, track: Track, step: int) -> list[Artist]:
    """What moves in an animation, from the lowest to the uppermost."""
    t_s, mode = float(track.t_s[step]), Mode(track.mode[step])
    place, heading = track.position[step, _EAST_NORTH], float(track.heading[step])
    camera = place + CAMERA_AHEAD_M * np.array([math.sin(heading), math.cos(heading)])
    angles = (90.0 - math.degrees(heading) + off for off in (-_HALF_VIEW_DEG, _HALF_VIEW_DEG))
    view = Wedge(tuple(camera), _VIEW_M, *angles, color="#f3d36b", alpha=0.35)
    edge = _RED if track.clearance_m[step] < HULL_RADIUS_M else "black"
    words = f"{t_s:5.1f} s  {mode.value}"
    at: Any = {"transform": axes.transAxes, "va": "top", "fontsize": 8}
    return [
        axes.add_patch(view),
        *_draw_way(axes, track.mode, track.position[: step + 1, _EAST_NORTH], 1.6),
        *_draw_frames(axes, track, OBSTACLE, until_s=t_s, marker="x", color=_RED, ms=4),
        axes.add_patch(Circle(tuple(place), HULL_RADIUS_M, fill=False, ec=edge, lw=1.4)),
        axes.text(0.02, 0.99, words, color=_COLORS[mode], **at),
    ]


def overview(tracks: Sequence[Track], charts: Sequence[Chart]) -> bytes:
    """All runs of a scene and a method, one small map each, by seed; red where it collided."""
    low, high = _extent(tracks, charts)
    wide, tall = high - low + _GAP_M
    columns = min(_COLUMNS, len(tracks))
    rows = math.ceil(len(tracks) / columns)
    across = min(_WIDE_IN, columns * _WIDEST_MAP_IN)
    height = across * rows * tall / (columns * wide)
    figure, axes = new_figure(max(across, 5.0), height + 0.6, dpi=_STILL_DPI)
    for number, (track, chart) in enumerate(zip(tracks, charts, strict=True)):
        row, column = divmod(number, columns)
        corner = np.array([column * wide, -row * tall])
        _draw_small(axes, track, chart, corner - low, corner + _SHEET * (high - low))
    axes.set(xlim=(-_GAP_M, columns * wide), ylim=(-(rows - 1) * tall - _GAP_M, tall))
    axes.set_aspect("equal")
    axes.set_axis_off()
    hits = sum(track.collided for track in tracks)
    axes.set_title(
        f"{tracks[0].title}: {tracks[0].method}, {len(tracks)} runs, {hits} collisions", fontsize=10
    )
    return figure_png(figure)


def _draw_small(axes: Axes, track: Track, chart: Chart, shift: F64, sheet: F64) -> None:
    """Draw one run of many, moved by `shift`, on a sheet with these corners."""
    paper, edge = ("#fdecea", _RED) if track.collided else ("#f7f9fa", "0.3")
    axes.add_patch(Polygon(sheet, fc=paper, ec="0.85", lw=0.5))
    _draw_solid(axes, [outline + shift for outline in chart.outlines])
    _draw_way(axes, track.mode, track.position[:, _EAST_NORTH] + shift, 0.9)
    _draw_frames(axes, track, OBSTACLE, shift, marker="x", color=_RED, ms=1.6, mew=0.5)
    _draw_nearest(axes, track, edge, 0.6, shift)
    left, top = sheet[3]
    axes.text(left + 0.3, top - 0.3, str(track.seed), fontsize=5, va="top", color="0.4")


def _draw_way(axes: Axes, modes: Any, places: F64, width: float) -> list[Artist]:
    """Draw the way from each of places (n, 2) to the next, coloured by the mode there."""
    pieces, modes = np.stack([places[:-1], places[1:]], axis=1), modes[1 : len(places)]
    style: Any = {"lw": width, "capstyle": "round"}
    return [
        axes.add_collection(
            LineCollection(list(pieces[modes == mode]), colors=color, label=mode.value, **style)
        )
        for mode, color in _COLORS.items()
        if mode in modes
    ]


def _draw_frames(
    axes: Axes, track: Track, status: int, shift: Any = 0.0, until_s: float = math.inf, **style: Any
) -> Sequence[Artist]:
    """Draw where the frames of a status were taken, if there are any."""
    places = track.places(status, until_s)[:, _EAST_NORTH] + shift
    return axes.plot(*places.T, ls="", zorder=4, **style) if len(places) else ()


def _draw_nearest(axes: Axes, track: Track, color: str, width: float, shift: Any = 0.0) -> None:
    """Draw the hull where it was nearest to something solid."""
    if math.isfinite(track.least_m):
        east, north = track.position[track.nearest][_EAST_NORTH] + shift
        circle = Circle((east, north), HULL_RADIUS_M, fill=False, ec=color, lw=width, zorder=6)
        axes.add_patch(circle)


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
    figure, axes = new_figure(wide, _TALL_IN, dpi=dpi)
    axes.set(xlim=(middle - half, middle + half), ylim=(low[1], high[1]))
    axes.set(xlabel="east, m", ylabel="north, m")
    axes.set_aspect("equal")
    axes.grid(alpha=0.25)
    _draw_solid(axes, chart.outlines)
    start, goal = track.position[0][_EAST_NORTH], chart.goal[_EAST_NORTH]
    axes.plot(*start, "^", color="black", ms=7, zorder=4, label="start")
    axes.plot(*goal, "*", color=_GREEN, ms=12, zorder=4, label="goal")
    _draw_current(axes, chart)
    return figure, axes


def _draw_solid(axes: Axes, outlines: Sequence[F64]) -> None:
    for outline in outlines:
        axes.add_patch(Polygon(outline, closed=True, fc=_SOLID, ec=_SOLID_EDGE, lw=0.8, zorder=2))


def _draw_current(axes: Axes, chart: Chart) -> None:
    water = np.array(chart.current_m_s)[_EAST_NORTH]
    speed = math.hypot(*water)
    if speed > 0:
        east, north = axes.get_xlim()[1] - 1.8, axes.get_ylim()[0] + 1.6
        two_metres: Any = {"angles": "xy", "scale_units": "xy", "scale": speed / 2, "pivot": "mid"}
        axes.quiver(east, north, *water, color=_WATER, width=0.008, zorder=6, **two_metres)
        words = f"current\n{speed:.2f} m/s"
        axes.text(east, north - 0.7, words, ha="center", va="top", fontsize=7, color=_WATER)
