"""Depth of a whole mission: every pair judged, then the table, the plot, pictures and a cloud."""

import json
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tokt.features.common import atomic
from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError, ToktError, os_errors_as
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import LEFT, RIGHT, Mission, format_frames
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.sources.files import MissionSource
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.matching import Matches
from tokt.inference.stereo.odometry import load_odometry
from tokt.inference.verdict import OBSTACLE
from tokt.models.operating_point import frame_step
from tokt.training.evaluation.pictures import CONTRAST_METHOD
from tokt.training.rig.calibrate.frame_selection import evenly_spaced

from .cloud import FARTHEST_M, cloud_of, colors_of, outliers, ply_bytes
from .curve import curve_csv, curve_png
from .export import KINDS, Export, Places, logged_places
from .fuse import AGREEING, Fusion, PosedView, sharpened
from .pair_depths import DepthRow, measure_depths, summary
from .picture import DepthPicture
from .poses import CameraPoses, estimated_poses, poses_by_odometry

SPREAD_PICTURES = 12
"""So many frames are drawn when none was chosen."""
PICTURES_FOLDER = "frames"
FUSED_NAME = "fused.ply"
MAX_FUSED = 100
"""So many frames are joined at most: time grows with their square."""
Progress = Callable[..., Any]
_COLOR_ENDS_M = (1.0, 10.0)
"""Of the colour bar where nothing was matched."""
_MIN_RATIO = 2.0
"""Far end of the colour bar over its near end: below, it would show the noise."""


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
    odometry: Path | None = None  # where the frames' poses stand; None to estimate them
    log: Path | None = None  # of the run that saw the frames: its places, its odometry
    export: str | None = None  # the program that the frames are handed over to


def run_depth(
    mission: Mission,
    calibration: StereoCalibration,
    out: Path,
    request: DepthRequest,
    progress: Progress,
) -> dict[str, Any]:
    """Write ``depth.csv``, ``depth.png``, ``depth.json`` and ``frames/`` into `out`.

    Parameters
    ----------
    out : Path
        Folder; made where it is missing. Files of these names in it are replaced.
    progress : callable
        ``progress(items, total, what)`` passes items on.

    Returns
    -------
    dict
        The JSON object of ``tokt depth --json``: `summary`, and what was written.

    Raises
    ------
    ToktError
        If the mission has one camera only, a frame that was asked for is not in it, or there is
        nothing to make a cloud of. A pair that cannot be judged is a row that says why.
    """
    source = _source(mission, out, request)
    poses, places = _given(request)
    ply, farthest_m = request.ply, request.farthest_m
    settings = (calibration, DEFAULT_GRID, request.matcher, request.scale)
    detector = DisparityDetector(*settings)
    frames = progress(source, len(source.numbers), "depth")
    measured = list(measure_depths(detector, frames, request.rate))
    rows = {row.frame: row for row in measured}
    step = frame_step({*mission.frames(LEFT), *mission.frames(RIGHT)})
    found = summary(measured, step)
    atomic.write_text(out / "depth.csv", curve_csv(measured))
    atomic.write_bytes(out / "depth.png", curve_png(measured, found, mission.name, step))
    # The rows are what a run would say; what is looked at has every pixel matched.
    views = PairRematcher(mission, DisparityDetector(*settings, step=1))
    drawn = [rows[number] for number in _to_draw(measured, found, request)]
    chosen = request.ply_frame
    if chosen is None and found["nearest"]:
        chosen = found["nearest"]["frame"]
    shown, why = _seen(measured), ""
    if poses is None:
        wanted = shown if request.fused or request.export else []
        poses, why = _estimated(mission, calibration, wanted, progress)
    cloud = None
    if request.fused:
        cloud = views.write_fused(ply or out / FUSED_NAME, shown, poses, farthest_m, progress)
    elif ply is not None and chosen is not None:
        cloud = views.write_cloud(ply, rows[chosen], farthest_m)
    about = {
        "mission": mission.name,
        "matcher": request.matcher,
        "scale": request.scale,
        "rate": request.rate,
        **found,
        "pictures": views.draw(out / PICTURES_FOLDER, drawn, progress) if drawn else [],
        "ply": cloud,
        "export": None,
        "rows": [asdict(row) for row in measured],
    }
    if request.export is not None:
        pairs = [row.frame for row in measured if row.valid_fraction is not None]
        export = Export(mission, calibration, pairs, poses.by_frame, places)
        about["export"] = export.write(request.export, out / request.export, progress)
    text = json.dumps(about, indent=2, ensure_ascii=False, allow_nan=False)
    atomic.write_text(out / "depth.json", text + "\n")
    if cloud is None and request.fused:
        agree = f"no {AGREEING} frames with a pose agree on anything"
        raise ToktError(why or f"no point cloud: {agree} within {farthest_m:g} m")
    if cloud is None and ply is not None:
        where = "any frame" if chosen is None else f"frame {chosen}"
        raise ToktError(f"no point cloud: nothing in {where} was matched within {farthest_m:g} m")
    return about


def _seen(rows: Sequence[DepthRow]) -> list[DepthRow]:
    """The rows that show something, or at most `MAX_FUSED` of them, evenly spaced."""
    seen = [row for row in rows if row.status == OBSTACLE and row.median_m is not None]
    return evenly_spaced(seen, MAX_FUSED)


def _given(request: DepthRequest) -> tuple[CameraPoses | None, Places]:
    """Poses by the odometry given, or the log's; and where the log says the vehicle was."""
    places, used = ({}, None) if request.log is None else logged_places(request.log)
    odometry = request.odometry or used
    return None if odometry is None else poses_by_odometry(load_odometry(odometry)), places


def _estimated(
    mission: Mission, calibration: StereoCalibration, rows: Sequence[DepthRow], progress: Progress
) -> tuple[CameraPoses, str]:
    """Poses by the frames of some rows, or none and why."""
    if not rows:
        return CameraPoses({}, ""), "no poses: no frame shows anything"
    trims = {row.frame: row.row_trim_px for row in rows}
    try:
        return estimated_poses(mission, calibration, trims, progress), ""
    except ToktError as error:
        return CameraPoses({}, ""), str(error)


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
    """Options that do not go with each other."""
    single = request.ply is not None and not request.fused
    if request.ply_frame is not None and not single:
        raise ToktError("--ply-frame goes together with --ply, and without --fused")
    if request.farthest_m != FARTHEST_M and not (single or request.fused):
        raise ToktError("--ply-farthest goes together with --ply or --fused")
    several = request.fused or request.export is not None
    if not several and (request.odometry is not None or request.log is not None):
        raise ToktError("--odometry and --log go together with --fused or --export")
    if request.export is not None:
        if request.export not in KINDS:
            raise ToktError(f"--export is one of {', '.join(KINDS)}, not {request.export!r}")
        if (out / request.export).exists():
            raise ToktError(f"{out / request.export} exists already; choose another --out")


def _refuse_unwritable(folder: Path, option: str) -> None:
    """A folder that exists and cannot be written to, or cannot be made where it would be."""
    there = next(at for at in (folder.absolute(), *folder.absolute().parents) if at.exists())
    if not there.is_dir():
        raise ToktError(f"{there} is not a folder; choose another with {option}")
    with os_errors_as(f"{option}: cannot write in {there}"):
        tempfile.TemporaryFile(dir=there).close()


def _to_draw(
    rows: Sequence[DepthRow], found: dict[str, Any], request: DepthRequest
) -> Sequence[int]:
    if request.pictures is not None:
        return sorted(set(request.pictures))
    if request.frames is not None:
        return [row.frame for row in rows]
    deep = [row.frame for row in rows if row.status == OBSTACLE and row.median_m]
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
        if not len(cloud.points_m):
            return None
        comments = [
            f"mission {self.mission.name}, frame {row.frame}",
            "metres in the left camera's axes: x right, y down, z forward",
            f"colours: left frame, {CONTRAST_METHOD}",
        ]
        atomic.write_bytes(file, ply_bytes(cloud.points_m, cloud.colors, comments))
        return {
            "file": str(file),
            "frame": row.frame,
            "points": len(cloud.points_m),
            "matched": cloud.matched,
            "out_of_range": cloud.out_of_range,
            "outliers": cloud.outliers,
        }

    def write_fused(
        self,
        file: Path,
        rows: Sequence[DepthRow],
        poses: CameraPoses,
        farthest_m: float,
        progress: Progress,
    ) -> dict[str, Any] | None:
        """Write the cloud that several frames agree on; what it holds, or None without a point."""
        rectifier, views = self.detector.rectifier, []
        posed = [row for row in rows if row.frame in poses.by_frame]
        for row in progress(posed, len(posed), "match"):
            left, matches = self.again(row)
            if left is not None and matches is not None:
                right = rectifier.right(self.mission.read(row.frame, RIGHT), row.row_trim_px)
                disparity = sharpened(rectifier.left(left), right, matches, len(posed))
                disparity[disparity < rectifier.focal_baseline_px_m / farthest_m] = np.nan
                views.append(PosedView(row.frame, disparity, poses.by_frame[row.frame]))
        matched = sum(int(np.isfinite(view.disparity_px).sum()) for view in views)
        joined = [part for part in Fusion(rectifier, views).fused() if len(part.points_m)]
        if not joined:
            return None
        points = np.concatenate([part.points_m for part in joined])
        kept = ~outliers(points, np.concatenate([part.away_m for part in joined]))
        colors = np.concatenate(
            [
                colors_of(rectifier, part.pixels, self.mission.read(part.frame, LEFT))
                for part in joined
            ]
        )
        used = format_frames(view.frame for view in views)
        comments = [
            f"mission {self.mission.name}, frames {used}",
            f"metres in {poses.axes}",
            f"colours: left frames, {CONTRAST_METHOD}",
        ]
        atomic.write_bytes(file, ply_bytes(points[kept], colors[kept], comments))
        return {
            "file": str(file),
            "frames": used,
            "left_out": format_frames({row.frame for row in rows} - {view.frame for view in views}),
            "points": int(kept.sum()),
            "matched": matched,
            "outliers": int((~kept).sum()),
            "axes": poses.axes,
            "residual_px": poses.residual_px,
        }


def _color_ends(rows: Sequence[DepthRow]) -> tuple[float, float]:
    """The depths of all that is drawn: one scale for all pictures, so that they compare."""
    near = [row.distance_m for row in rows if row.distance_m is not None]
    far = [row.far_m for row in rows if row.far_m is not None]
    if not near or not far:
        return _COLOR_ENDS_M
    return min(near), max(max(far), _MIN_RATIO * min(near))
