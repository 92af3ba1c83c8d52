"""The map of one run, as a picture.

North is up, metres both ways. The clearance is measured in space and the map is flat: a track that
passes above a tower's feet may come closer to its outline than it did to the tower.
"""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from tokt.studies.simulation.loop.autopilot import Mode
from tokt.studies.simulation.loop.track import Track
from tokt.studies.simulation.loop.vehicle import HULL_RADIUS_M

from .chart import COLORS, EAST_NORTH, GREEN, RED, Chart, collided, pieces, png, sheet


def still(track: Track, chart: Chart) -> bytes:
    """One run as a PNG.

    The track is coloured by what the planner was at; a red cross is where a frame was judged to
    show an obstacle, a grey ring where nothing was known; the circle is the hull where it was
    nearest to something solid.
    """
    figure, axes = sheet(track, chart, 110)
    places = track.position[:, EAST_NORTH]
    colors = [COLORS[Mode(mode)] for mode in track.mode[1:]]
    axes.add_collection(LineCollection(pieces(places), colors=colors, linewidths=1.8, zorder=3))
    _draw_verdicts(axes, track)
    _draw_nearest(axes, track)
    axes.set_title(f"{track.title}\n{track.method}, seed {track.seed}: {_words(track)}", fontsize=9)
    axes.legend(handles=_legend(track), loc="upper left", bbox_to_anchor=(1.02, 1), fontsize=8)
    return png(figure)


def _words(track: Track) -> str:
    if collided(track):
        return f"collided after {track.t_s[-1]:.0f} s"
    end = "reached the goal" if track.reached else "did not reach the goal"
    return f"{end}, {track.t_s[-1]:.0f} s"


def _draw_verdicts(axes: Axes, track: Track) -> None:
    unknown = track.at(track.frame_t_s[track.frame_status == -1])
    axes.plot(*unknown[:, EAST_NORTH].T, "o", mfc="none", mec="0.5", ms=4, zorder=4)
    seen = track.obstacle_places
    axes.plot(*seen[:, EAST_NORTH].T, "x", color=RED, ms=5, mew=1.2, zorder=5)


def _draw_nearest(axes: Axes, track: Track) -> None:
    clearance = float(track.clearance_m.min())
    if not math.isfinite(clearance):
        return
    color = RED if clearance < HULL_RADIUS_M else "black"
    east, north = track.position[track.nearest][EAST_NORTH]
    axes.add_patch(Circle((east, north), HULL_RADIUS_M, fill=False, ec=color, lw=1.2, zorder=6))
    axes.annotate(
        f"clearance {clearance - HULL_RADIUS_M:.2f} m",
        (east, north),
        xytext=(10, 14),
        textcoords="offset points",
        fontsize=8,
        color=color,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1},
        zorder=7,
    )


def _legend(track: Track) -> list[Line2D]:
    """Only what occurs."""
    lines = [
        Line2D([], [], color=COLORS[mode], lw=2, label=mode.value)
        for mode in Mode
        if mode in track.mode
    ]

    def mark(marker: str, label: str, **style: object) -> Line2D:
        return Line2D([], [], ls="", marker=marker, label=label, **style)  # type: ignore[arg-type]

    if (track.frame_status == 1).any():
        lines.append(mark("x", "status 1", color=RED))
    if (track.frame_status == -1).any():
        lines.append(mark("o", "unknown", mfc="none", mec="0.5"))
    if math.isfinite(track.clearance_m.min()):
        lines.append(mark("o", "hull, nearest", mfc="none", mec="black", ms=9))
    return [*lines, mark("^", "start", color="black"), mark("*", "goal", color=GREEN, ms=10)]
