"""The map of one run as an animation: the vehicle, what it sees, and its track as it grows."""

from __future__ import annotations

import math

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Wedge

from tokt.studies.simulation.loop.autopilot import Mode
from tokt.studies.simulation.loop.track import Track
from tokt.studies.simulation.loop.vehicle import CAMERA_AHEAD_M, HULL_RADIUS_M

from .chart import COLORS, EAST_NORTH, RED, Chart, pieces, sheet

_HALF_VIEW_DEG, _VIEW_M = 17.0, 8.0
_FRAME_MS = 120
_MAX_FRAMES = 70
_DPI = 75
_QUALITY = 75


def animation(track: Track, chart: Chart) -> bytes:
    """One run as an animated WebP: the vehicle, what it sees, and its track as it grows.

    Of a quarter of a GIF's size, and in true colours.
    """
    figure, axes = sheet(track, chart, _DPI)
    canvas = FigureCanvasAgg(figure)
    axes.set_title(f"{track.title}, {track.method}, seed {track.seed}", fontsize=8)
    moving = _Moving(axes, track)
    canvas.draw()  # type: ignore[no-untyped-call]
    empty = canvas.copy_from_bbox(figure.bbox)  # type: ignore[no-untyped-call]
    steps = np.unique(np.linspace(0, len(track.t_s) - 1, _frames(track)).round().astype(int))
    film = cv2.Animation()
    pictures = []
    for step in steps:
        canvas.restore_region(empty)  # type: ignore[no-untyped-call]
        moving.show(int(step))
        rgba = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        pictures.append(cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGR))
    film.frames = pictures
    # The last one stays, before it begins again.
    film.durations = [*[_FRAME_MS] * (len(pictures) - 1), 10 * _FRAME_MS]
    done, data = cv2.imencodeanimation(".webp", film, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    if not done:
        raise RuntimeError("OpenCV wrote no WebP")
    return bytes(data)


class _Moving:
    """The moving parts of an animation."""

    def __init__(self, axes: Axes, track: Track) -> None:
        self._axes, self._track = axes, track
        self._track_line = LineCollection([], linewidths=1.6, animated=True, zorder=3)
        self._view = Wedge((0, 0), _VIEW_M, 0, 1, color="#f3d36b", alpha=0.35, animated=True)
        self._hull = Circle((0, 0), HULL_RADIUS_M, fill=False, lw=1.4, animated=True, zorder=5)
        self._crosses = Line2D([], [], ls="", marker="x", ms=4, color=RED, animated=True, zorder=4)
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
        places = track.position[: step + 1, EAST_NORTH]
        mode = Mode(track.mode[step])
        self._track_line.set_segments(pieces(places))
        self._track_line.set_color([COLORS[Mode(name)] for name in track.mode[1 : step + 1]])
        east, north = places[-1]
        heading = float(track.heading[step])
        ahead = np.array([math.sin(heading), math.cos(heading)])
        self._hull.set(center=(east, north), edgecolor=RED if self._touches(step) else "black")
        straight = 90.0 - math.degrees(heading)
        self._view.set(
            center=tuple(places[-1] + CAMERA_AHEAD_M * ahead),
            theta1=straight - _HALF_VIEW_DEG,
            theta2=straight + _HALF_VIEW_DEG,
        )
        seen = int((track.frame_t_s[track.frame_status == 1] <= t_s).sum())
        self._crosses.set_data(track.obstacle_places[:seen, EAST_NORTH].T)
        self._words.set_text(f"{t_s:5.1f} s  {mode.value}")
        self._words.set_color(COLORS[mode])
        for artist in (self._view, self._track_line, self._crosses, self._hull, self._words):
            self._axes.draw_artist(artist)

    def _touches(self, step: int) -> bool:
        return bool(self._track.clearance_m[step] < HULL_RADIUS_M)


def _frames(track: Track) -> int:
    return min(_MAX_FRAMES, max(2, round(float(track.t_s[-1]))))
