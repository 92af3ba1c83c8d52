"""The report of a self-calibration: one HTML file that needs no other."""

from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure

from tokt import __version__
from tokt.features.common import atomic
from tokt.features.frames.mission import LEFT, RIGHT, Mission
from tokt.inference.stereo.rectify import Rectifier
from tokt.training.evaluation.pictures import new_figure
from tokt.training.evaluation.plots import data_uri
from tokt.training.evaluation.report import report_page

from .matching import FrameMatches, even_contrast_gaussian, view_scale
from .self_calibration import SelfCalibration
from .vertical_error import vertical_error

_LINES = 14
_WIDEST_PX = 4.0


def write_report(target: Path, found: SelfCalibration, mission: Mission) -> None:
    """Write the report, whole or not at all."""
    clearest = max(found.test_matches, key=len)
    figures = {
        "histogram": _error_histogram(found),
        "over_frame": _error_over_frame(found),
        "path": _path_and_depth(found),
        "pair": _rectified_pair(found, mission, clearest),
    }
    page = report_page(
        __package__,
        found=found,
        version=__version__,
        before=found.before.by_region(),
        after=found.after.by_region(),
        figures={name: data_uri(figure) for name, figure in figures.items()},
    )
    atomic.write_text(target, page)


def _error_histogram(found: SelfCalibration) -> Figure:
    """How the vertical errors of the test frames are spread, before and after."""
    figure, (before, after) = new_figure(10.5, 3.0, 1, 2)
    before.hist(found.before.row_px, bins=80, color="#a3151f")
    before.set(title="before", xlabel="left row - right row, px", ylabel="matches")
    inside = np.clip(found.after.row_px, -_WIDEST_PX, _WIDEST_PX)
    after.hist(inside, bins=80, color="#2f7d4f")
    after.set(title="after (beyond 4 px at the ends)", xlabel="left row - right row, px")
    return figure


def _error_over_frame(found: SelfCalibration) -> Figure:
    """Where in the left frame rows still differ: a pattern would be a lens that is not right."""
    figure, (axes, by_frame) = new_figure(10.5, 4.4, 1, 2, width_ratios=(1.15, 1))
    at, error = found.after.at, found.after.row_px
    width, height = found.after.frame_size
    dots = axes.scatter(at[:, 0], at[:, 1], c=error, s=4, cmap="coolwarm", vmin=-1.5, vmax=1.5)
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal", title="after, by place, px")
    for part in (1 / 3, 2 / 3):
        axes.axhline(height * part, color="0.7", lw=0.6)
        axes.axvline(width * part, color="0.7", lw=0.6)
    figure.colorbar(dots, ax=axes, shrink=0.7)
    rig = found.fit_part.rig.calibration()
    frames = [one.frame for one in found.test_matches]
    errors = [np.abs(vertical_error(rig, [one]).row_px) for one in found.test_matches]
    by_frame.plot(frames, [np.median(one) for one in errors], ".-", label="median")
    by_frame.plot(frames, [np.percentile(one, 90) for one in errors], ".-", label="p90")
    by_frame.set(
        xlabel="frame", ylabel="vertical error, px", ylim=(0, None), title="after, by frame"
    )
    by_frame.legend()
    by_frame.grid(alpha=0.3)
    return figure


def _path_and_depth(found: SelfCalibration) -> Figure:
    """The vehicle's path and the points it saw, from above, and the depth frame by frame."""
    figure, (above, depth) = new_figure(10.5, 4.0, 1, 2)
    path, tracks = found.fit.path, found.fit.tracks
    followed = path.points_m[tracks.lengths() > 1]
    near = np.abs(followed - np.median(followed, axis=0)).max(axis=1) < 15
    above.plot(followed[near, 0], followed[near, 2], ".", ms=2, color="0.55", label="points")
    rotations = np.array([cv2.Rodrigues(vector)[0] for vector in path.rotation_vectors])
    places = -np.einsum("nji,nj->ni", rotations, path.shifts_m)
    above.plot(places[:, 0], places[:, 2], ".-", color="#3b75af", label="left camera")
    above.set(xlabel="right, m", ylabel="forward, m", title="from above")
    above.set_aspect("equal", adjustable="datalim")
    above.legend()
    turned = np.einsum("nij,nj->ni", rotations[tracks.frame], path.points_m[tracks.point])
    forward = turned[:, 2] + path.shifts_m[tracks.frame, 2]
    median = [np.median(forward[tracks.frame == i]) for i in range(len(tracks.frames))]
    depth.plot(tracks.frames, median, ".-")
    depth.set(xlabel="frame", ylabel="median depth of its points, m", ylim=(0, None))
    depth.grid(alpha=0.3)
    return figure


def _rectified_pair(found: SelfCalibration, mission: Mission, one: FrameMatches) -> Figure:
    """Both pictures of a frame, rectified: what is in one row on the left is so on the right."""
    rectifier = Rectifier(found.calibration, view_scale(found.calibration.frame_size[0]))
    views = (
        (LEFT, rectifier.left(mission.read(one.frame, LEFT))),
        (RIGHT, rectifier.right(mission.read(one.frame, RIGHT))),
    )
    figure, panels = new_figure(10.5, 4.2, 1, 2)
    for axes, (camera, gray) in zip(panels, views, strict=True):
        view = even_contrast_gaussian(gray)
        axes.imshow(view, cmap="gray", vmin=0, vmax=255)
        for row in np.linspace(0, rectifier.size[1], _LINES + 2)[1:-1]:
            axes.axhline(row, color="#e0a500", lw=0.5)
        axes.set(xticks=[], yticks=[], title=f"{camera}, frame {one.frame}")
    return figure
