"""A logged run along its track: where the vehicle was at each frame, and which classes it saw."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import Mission
from tokt.inference.report import WITH_CLASSES
from tokt.inference.stereo.odometry import Odometry

from .logged_run import LoggedRun, kind_of, logged_lines, open_run
from .replay import models_of_run, odometry_of, pictures_of

_SMOOTHED = 4
"""Frames each way over which a track is smoothed: the way back and forth is not the way along."""
_EARTH_M = 6_371_000.0
_LAST_M = 2.0  # metres at a track's end that say which way it goes on


@dataclass(frozen=True, eq=False)
class LoggedTrack:
    """A run's frames, in the order in which they were judged."""

    log: str
    run: str  # its id
    mission: Mission | None  # its pictures, where they are
    mission_name: str
    grid: Grid
    classes: tuple[str, ...]  # that its models know, water left out
    lines: Sequence[Mapping[str, Any]]
    along_m: F64  # shape (n_frames,): the way from the first position; nan where none is known
    damaged: int = 0  # lines that were left out

    @property
    def seen(self) -> list[Mapping[str, Sequence[int]]]:
        """For each frame its patches by class; nothing where no model judged it."""
        return [line.get("class_patches") or {} for line in self.lines]

    def place(self, along_m: float) -> tuple[float | None, float | None]:
        """Latitude and longitude at that way along the track; None where the log has none."""
        places = _positions(self.lines)
        known = np.isfinite(places[:, 0]) & np.isfinite(self.along_m)
        if not known.any() or not math.isfinite(along_m):
            return None, None
        ways = self.along_m[known]
        lat = _extended(along_m, ways, places[known, 0])
        lon = _extended(along_m, ways, np.unwrap(places[known, 1], period=360.0))
        return round(lat, 7), round((lon + 180.0) % 360.0 - 180.0, 7)


def _extended(at: float, ways: F64, values: F64) -> float:
    """Interpolated between rising `ways`, and on beyond the last one as its last metres went."""
    if at <= ways[-1]:
        return float(np.interp(at, ways, values))
    back = max(int(np.searchsorted(ways, ways[-1] - _LAST_M)) - 1, 0)
    way = ways[-1] - ways[back]
    slope = (values[-1] - values[back]) / way if way > 0 else 0.0
    return float(values[-1] + slope * (at - ways[-1]))


def open_track(
    log: Path,
    run: str | None = None,
    source: Path | None = None,
    store: Path | None = None,
    odometry: Odometry | None = None,
) -> LoggedTrack:
    """Read a run of a log, by default its last one.

    Pictures and models are read from where the run had them, unless `source` and `store` say
    otherwise; poses by frame are those that the run was given, but for `odometry`. Damaged lines,
    and patches that the model's grid does not have, are left out and counted.

    Raises ToktError if the log cannot be read, its models are not there, or they tell no classes.
    """
    logged = open_run(log, run)
    models = list(models_of_run(logged, store).values())
    classes = {name for model in models for name in model.model.named_classes}
    if not classes:
        raise ToktError(
            f"{log}: findings need a model of several classes; its dataset is one of tokt dataset "
            "build --task classes"
        )
    if len({model.grid for model in models}) != 1:
        raise ToktError(f"{log}: models of different grids judged in it")
    grid = models[0].grid
    every = [line for line in logged_lines(log, logged.run, []) if line.get("frame") is not None]
    lines = [line for line in every if kind_of(line) == "frames" and _fits_grid(line, grid)]
    if not any("class_patches" in line for line in lines):
        raise ToktError(f"{log}: its tokt did not log classes yet (version {WITH_CLASSES} does)")
    if odometry is None:
        odometry = odometry_of(logged.start)
    mission, name = _mission(log, logged, source)
    return LoggedTrack(
        log=str(log),
        run=logged.run,
        mission=mission,
        mission_name=name,
        grid=grid,
        classes=tuple(sorted(classes)),
        lines=lines,
        along_m=_along(lines, odometry),
        damaged=len(every) - len(lines),
    )


def _fits_grid(line: Mapping[str, Any], grid: Grid) -> bool:
    cells = [cell for each in (line.get("class_patches") or {}).values() for cell in each]
    return all(type(cell) is int and 0 <= cell < grid.n_patches for cell in cells)


def _mission(log: Path, logged: LoggedRun, source: Path | None) -> tuple[Mission | None, str]:
    """Where a run's pictures are, None if they are not there, and the mission's name."""
    try:
        mission = pictures_of(log, logged.run, logged.start, source)[0]
    except ToktError:
        if source is not None:
            raise
        return None, Path(logged.start.source).name
    return mission, mission.name


def _positions(lines: Sequence[Mapping[str, Any]]) -> F64:
    """Latitudes and longitudes in degrees, shape (n_frames, 2); nan where one is not known."""
    places = [(line.get("lat_deg"), line.get("lon_deg")) for line in lines]
    return np.array([(math.nan,) * 2 if None in each else each for each in places], np.float64)


def _along(lines: Sequence[Mapping[str, Any]], poses: Odometry | None) -> F64:
    """Metres along the track for each frame, from the first that has a position."""
    if poses is not None:
        known_poses = [poses.get(line["frame"]) for line in lines]
        nowhere = np.full(3, np.nan)
        places = np.array([nowhere if each is None else each.position_m for each in known_poses])
    else:
        places = _flat(_positions(lines))
    along = np.full(len(lines), np.nan)
    known = np.isfinite(places[:, 0])
    if np.count_nonzero(known) < 2:
        return along
    track = np.asarray(places[known], np.float64)
    last = len(track) - 1
    reach = [min(at, last - at, _SMOOTHED) for at in range(last + 1)]
    smooth = np.array([track[at - r : at + r + 1].mean(axis=0) for at, r in enumerate(reach)])
    steps = np.linalg.norm(np.diff(smooth, axis=0), axis=1)
    along[known] = np.concatenate([[0.0], np.cumsum(steps)])
    return along


def _flat(positions: F64) -> F64:
    """Metres east and north of the equator and Greenwich, on a plane about each position."""
    lat, lon = np.radians(positions).T
    known = np.isfinite(lon)
    east = np.full_like(lon, np.nan)
    steps = np.diff(np.unwrap(lon[known]), prepend=lon[known][:1])
    east[known] = np.cumsum(steps * np.cos(lat[known]))
    return np.column_stack([east, lat]) * _EARTH_M
