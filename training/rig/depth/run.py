"""Depth of a whole mission: every pair judged, then the table, the plot, pictures and a cloud."""

import json
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tokt.features.common import atomic
from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError, ToktError, os_errors_as
from tokt.features.common.extras import needed_by
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import LEFT, RIGHT, Mission, format_frames
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.replay.replay import odometry_of
from tokt.inference.sources.files import MissionSource
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.matching import DenseMatcher, Matches
from tokt.inference.stereo.odometry import Odometry, Pose, load_odometry
from tokt.inference.verdict import OBSTACLE
from tokt.training.evaluation.pictures import CONTRAST_METHOD
from tokt.training.rig.calibrate.frame_selection import evenly_spaced

from .cloud import FARTHEST_M, PointCloud, cloud_of, cloud_of_points, ply_bytes
from .curve import curve_csv, curve_png
from .export import COLMAP, PROGRAMS, Export, Places, logged_places
from .fuse import AGREEING, PosedView, fused, fused_block_px
from .pair_depths import DepthRow, Place, measure_depths, summary
from .picture import DepthPicture
from .poses import estimated_poses

SPREAD_PICTURES = 12
"""So many frames are drawn when none was chosen."""
PICTURES_FOLDER = "frames"
MAX_FUSED = 100
"""So many frames are joined at most: time grows with their square."""
Progress = Callable[..., Any]
_COLOR_ENDS_M = (1.0, 10.0)  # of the colour bar where nothing was matched
_MIN_RATIO = 2.0  # far end of the colour bar over its near end: below, it would show the noise


@dataclass(frozen=True)
class DepthRequest:
    """Options of a depth measurement."""

    frames: Sequence[int] | None = None  # frames to look at; None for all
    # Which of them to draw. None: all of `frames` where they were chosen, otherwise
    # `SPREAD_PICTURES` spread over those with an obstacle, and the nearest.
    pictures: Sequence[int] | None = None
    rate: float | None = None  # frame numbers per second, for the closing speed
    matcher: str = "bm"  # or "sgbm"
    scale: float = 0.5  # of the matched views
    ply: Path | None = None  # where the point cloud goes
    ply_frame: int | None = None  # its frame; None for the one of the least distance
    farthest_m: float = FARTHEST_M  # of the cloud
    fused: bool = False  # whether the cloud is of all frames with an obstacle
    odometry: Path | None = None  # the frames' poses; None for the log's, or to estimate them
    log: Path | None = None  # of the run that saw the frames
    export: str | None = None  # the program that the frames are handed over to


def run_depth(
    mission: Mission,
    calibration: StereoCalibration,
    out: Path,
    request: DepthRequest,
    progress: Progress,
) -> dict[str, Any]:
    """Write ``depth.csv``, ``depth.png``, ``depth.json`` and ``frames/`` into `out`.

    Files of these names in the folder are replaced; it is made where it is missing. Returns the
    JSON object of ``tokt depth --json``: `summary`, and what was written.

    Raises ToktError if the mission has one camera only, a frame that was asked for is not in it, or
    there is nothing to make a cloud of. A pair that cannot be judged is a row that says why.
    """
    source = _source(mission, out, request)
    given = _given(mission, request)
    ply, farthest_m = request.ply, request.farthest_m
    settings = (calibration, DEFAULT_GRID, request.matcher, request.scale)
    detector = DisparityDetector(*settings)
    frames = progress(source, len(source.numbers), "depth")
    measured = list(measure_depths(detector, frames, request.rate))
    rows = {row.frame: row for row in measured}
    found = summary(measured, mission.place)
    atomic.write_text(out / "depth.csv", curve_csv(measured))
    atomic.write_bytes(out / "depth.png", curve_png(measured, found, mission.name, _axis(mission)))
    # The rows are what a run would say; what is looked at has every pixel matched.
    views = PairRematcher(mission, DisparityDetector(*settings, step=1))
    drawn = [rows[number] for number in _to_draw(measured, found, request)]
    chosen = request.ply_frame
    if chosen is None and found["nearest"]:
        chosen = found["nearest"]["frame"]
    cloud = handed = None
    if request.fused or request.export is not None:
        cloud, handed, nothing = views.write_several(measured, out, request, given, progress)
    if ply is not None and not request.fused:
        where = "any frame" if chosen is None else f"frame {chosen}"
        nothing = f"nothing in {where} was matched within {farthest_m:g} m"
        cloud = None if chosen is None else views.write_cloud(ply, rows[chosen], farthest_m)
    about = {
        "mission": mission.name,
        "matcher": request.matcher,
        "scale": request.scale,
        "rate": request.rate,
        **found,
        "pictures": views.draw(out / PICTURES_FOLDER, drawn, progress) if drawn else [],
        "ply": cloud,
        "export": handed,
        "rows": [asdict(row) for row in measured],
    }
    text = json.dumps(about, indent=2, ensure_ascii=False, allow_nan=False)
    atomic.write_text(out / "depth.json", text + "\n")
    if cloud is None and (request.fused or ply is not None):
        raise ToktError(f"no point cloud: {nothing}")
    return about


def _deep(rows: Sequence[DepthRow]) -> list[DepthRow]:
    return [row for row in rows if row.status == OBSTACLE and row.median_m]


def _given(mission: Mission, request: DepthRequest) -> tuple[Places, Odometry | None]:
    """Where the log says the vehicle was, and the poses given, or else the log's."""
    places, start = ({}, None) if request.log is None else logged_places(request.log, mission)
    if request.odometry is not None:
        return places, load_odometry(request.odometry)
    return places, None if start is None else odometry_of(start)


def _source(mission: Mission, out: Path, request: DepthRequest) -> MissionSource:
    """The frames to look at, after refusing what cannot be done, before hours of work."""
    if RIGHT not in mission.cameras:
        raise ToktError(f"mission {mission.name} has no right camera: depth needs both")
    if request.ply is not None and request.ply.is_dir():
        raise ToktError(f"{request.ply} is a folder; --ply names a file")
    _refuse_unwritable(out, "--out")
    if request.ply is not None:
        _refuse_unwritable(request.ply.parent, "--ply")
    _refuse_together(out, request)
    if request.rate is not None and not 0 < request.rate < float("inf"):
        raise ToktError(f"a rate is a positive number of frames per second, not {request.rate}")
    source = MissionSource(mission, SYSTEM_CLOCK, request.frames)
    asked = {*(request.pictures or ()), *([] if request.ply_frame is None else [request.ply_frame])}
    missing = asked - set(source.numbers)
    if missing:
        looked_at = format_frames(source.numbers)
        raise ToktError(
            f"frames {format_frames(missing)} are not among those looked at: {looked_at}"
        )
    return source


def _refuse_together(out: Path, request: DepthRequest) -> None:
    """Options that do not go with each other, and a program that cannot be handed to."""
    if request.ply_frame is not None and (request.ply is None or request.fused):
        raise ToktError("--ply-frame goes together with --ply, and without --fused")
    if request.farthest_m != FARTHEST_M and request.ply is None and not request.fused:
        raise ToktError("--ply-farthest goes together with --ply or --fused")
    several = request.fused or request.export is not None
    if not several and (request.odometry, request.log) != (None, None):
        raise ToktError("--odometry and --log go together with --fused or --export")
    if request.export is not None and request.export not in PROGRAMS:
        raise ToktError(f"--export is one of {', '.join(PROGRAMS)}, not {request.export!r}")
    if request.export is not None and (out / request.export).exists():
        raise ToktError(f"{out / request.export} exists already; choose another --out")
    if request.export == COLMAP:
        with needed_by("--export colmap"):
            import pycolmap  # noqa: F401 - whether it is there


def _refuse_unwritable(folder: Path, option: str) -> None:
    """A folder that exists and cannot be written to, or cannot be made where it would be."""
    there = next(at for at in (folder.absolute(), *folder.absolute().parents) if at.exists())
    if not there.is_dir():
        raise ToktError(f"{there} is not a folder; choose another with {option}")
    with os_errors_as(f"{option}: cannot write in {there}"):
        tempfile.TemporaryFile(dir=there).close()


def _axis(mission: Mission) -> Place:
    """Frames' numbers where these count the dive's frames, else their places from 1."""
    first = mission.frames(LEFT)[0]
    counted_by = all(n - mission.place(n) == first for n in mission.frames(LEFT))
    offset = first if counted_by else 1
    return lambda number: mission.place(number) + offset


def _to_draw(
    rows: Sequence[DepthRow], found: dict[str, Any], request: DepthRequest
) -> Sequence[int]:
    if request.pictures is not None:
        return sorted(set(request.pictures))
    if request.frames is not None:
        return [row.frame for row in rows]
    deep = [row.frame for row in _deep(rows)]
    every = max(1, -(-len(deep) // (SPREAD_PICTURES - 1)))
    nearest = {found["nearest"]["frame"]} if found["nearest"] else set()
    return sorted({*deep[::every], *nearest})


@dataclass(frozen=True)
class PairRematcher:
    """Matches some pairs again: those of a whole mission do not fit into memory."""

    mission: Mission
    detector: DisparityDetector

    def again(self, row: DepthRow) -> tuple[U8 | None, Matches | None]:
        """The left frame of a row, and its matches as they were; None for what there was not."""
        try:
            left = self.mission.read(row.frame, LEFT)
        except FrameError:
            return None, None
        if row.valid_fraction is None:
            return left, None
        right = self.mission.read(row.frame, RIGHT)
        return left, self.detector.match(left, right, row_shift_px=row.row_trim_px)

    def draw(
        self, folder: Path, rows: Sequence[DepthRow], progress: Callable[..., Iterable[DepthRow]]
    ) -> list[str]:
        """Write a picture ``depth_N.png`` of each row that has a left frame; return their names."""
        artist = DepthPicture(self.detector.rectifier, *_color_ends(rows))
        names = []
        for row in progress(rows, len(rows), "pictures"):
            left, matches = self.again(row)
            if left is not None:
                names.append(f"depth_{row.frame}.png")
                atomic.write_bytes(folder / names[-1], artist.png(row, left, matches))
        return names

    def write_cloud(self, file: Path, row: DepthRow, farthest_m: float) -> dict[str, Any] | None:
        """Write the point cloud of a row; what it holds, or None if no point is left for one."""
        left, matches = self.again(row)
        if left is None or matches is None:
            return None
        cloud = cloud_of(self.detector.rectifier, matches, left, farthest_m)
        axes = "the left camera's axes: x right, y down, z forward"
        return self._written(file, [cloud], {"frame": row.frame, "axes": axes})

    def write_several(
        self,
        rows: Sequence[DepthRow],
        out: Path,
        request: DepthRequest,
        given: tuple[Places, Odometry | None],
        progress: Progress,
    ) -> tuple[dict[str, Any] | None, dict[str, Any] | None, str]:
        """Join frames and hand them over, as asked: what was written of either, or why no cloud."""
        (places, odometry), axes, cloud, handed = given, "the odometry's axes", None, None
        deep, calibration = evenly_spaced(_deep(rows), MAX_FUSED), self.detector.calibration
        if odometry is None:
            trims = {row.frame: row.row_trim_px for row in deep}
            odometry, axes = estimated_poses(self.mission, calibration, trims, progress)
        if request.fused:
            posed = [(row, odometry[row.frame]) for row in deep if row.frame in odometry]
            clouds = self._joined(posed, request.farthest_m, progress)
            about = {"frames": format_frames(row.frame for row, _ in posed), "axes": axes}
            cloud = self._written(request.ply or out / "fused.ply", clouds, about)
        if request.export is not None and (cloud or not request.fused):
            pairs = [row.frame for row in rows if row.valid_fraction is not None]
            export = Export(self.mission, calibration, pairs, odometry, places)
            handed = export.write(request.export, out / request.export, progress)
            handed["axes"] = axes
        agree = f"no {AGREEING} frames with a pose agree within {request.farthest_m:g} m"
        return cloud, handed, agree if odometry else axes

    def _joined(
        self, posed: Sequence[tuple[DepthRow, Pose]], farthest_m: float, progress: Progress
    ) -> Iterator[PointCloud]:
        """What several frames agree on, in the poses' fixed axes."""
        rectifier, views = self.detector.rectifier, []
        block_px = fused_block_px(len(posed))
        matcher = DenseMatcher(rectifier, self.detector.matcher, step=1, block_px=block_px)
        for row, pose in progress(posed, len(posed), "match"):
            left, right = (self.mission.read(row.frame, side) for side in (LEFT, RIGHT))
            found = matcher.match(rectifier.left(left), rectifier.right(right, row.row_trim_px))
            disparity_px = np.where(found.valid, found.disparity_px, np.float32(np.nan))
            views.append(PosedView(row.frame, disparity_px, pose))
        for view, points, pixels in progress(fused(rectifier, views), len(views), "join"):
            left = self.mission.read(view.frame, LEFT)
            cloud = cloud_of_points(rectifier, points, pixels, left, farthest_m)
            placed = cloud.points_m @ view.pose.rotation.T + view.pose.position_m
            yield cloud._replace(points_m=placed)

    def _written(
        self, file: Path, parts: Iterable[PointCloud], about: dict[str, Any]
    ) -> dict[str, Any] | None:
        """Write some clouds as one; what it holds, or None if there is no point."""
        columns = [list(column) for column in zip(*parts, strict=True)]
        if not columns or not sum(map(len, columns[0])):
            return None
        (what, frames), (_, axes) = about.items()
        comments = [
            f"mission {self.mission.name}, {what} {frames}",
            f"metres in {axes}",
            f"colours: left frame, {CONTRAST_METHOD}",
        ]
        points, colors = map(np.concatenate, columns[:2])
        atomic.write_bytes(file, ply_bytes(points, colors, comments))
        counts = dict(zip(PointCloud._fields[2:], map(sum, columns[2:]), strict=True))
        return {"file": str(file), **about, "points": len(points), **counts}


def _color_ends(rows: Sequence[DepthRow]) -> tuple[float, float]:
    """The depths of all that is drawn: one scale for all pictures, so that they compare."""
    near = [row.distance_m for row in rows if row.distance_m is not None]
    far = [row.far_m for row in rows if row.far_m is not None]
    if not near or not far:
        return _COLOR_ENDS_M
    return min(near), max(max(far), _MIN_RATIO * min(near))
