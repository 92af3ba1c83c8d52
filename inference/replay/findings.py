"""Findings: what a log's models of several classes saw, grouped over frames, with its place.

::

    frames of a log      patches of the wanted classes       one group, frame after frame
      ...                  . . . .    . . . .    . d d .
      41  42  43    ->     . d d .    . . . .    . d n .  ->  finding: damage, frames 41 to 43,
      ...                  . d . .    . d d .    . . . .      best picture 42, 17.3 m along

Neighbouring patches of any wanted class are one thing, whose class is that of most of its patches:
a model that is unsure between two faults makes no two findings of one.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import Mission
from tokt.inference.stereo.odometry import Odometry, load_odometry

from .logged_run import LoggedRun, logged_lines, open_run
from .replay import models_of_run, pictures_of

if TYPE_CHECKING:
    from tokt.models.bundle.bundle import Bundle

MIN_FRAMES, MIN_PATCHES = 3, 3
"""Frames in which a thing is seen, and patches of its best frame, before it is a finding."""
RARE_SHARE = 0.5
"""A class that is seen in more of the frames is a background, and no finding, unless asked for."""
GAP_FRAMES = 3
"""Frames without it after which a thing is no longer followed."""
REACH = 2.0
"""Patches that the centre of a thing may move from a frame to the next."""
SAME_M = 1.0
"""Metres along the track, each way, within which what is seen is one thing."""
MIN_PROJECTED = 30
"""Sightings of things that passed the picture's middle before its rows have their places."""
APART = 3.0
"""Patches across the picture without any sighting, from which there are two things."""
MIDDLE = 0.2
"""Part of the picture's height from its middle within which a thing tells its place."""
_SMOOTHED = 4
_EARTH_M = 6_371_000.0


@dataclass(frozen=True)
class InspectionFinding:
    """One thing that was seen; None is what is not known."""

    label: str  # its class
    first_frame: int
    last_frame: int
    best_frame: int  # the picture to look at: the most patches, nearest to the middle
    frames: int  # in which it was seen
    # Part of the frames from first to last that show it (one more counts as without), times the
    # part of its patches that are of its class.
    confidence: float
    distance_m: float | None  # in the best frame, as the verdict has it
    along_m: float | None  # its place, along the track from the log's first position
    lat_deg: float | None
    lon_deg: float | None
    depth_m: float | None  # of the vehicle
    t: float | None  # of the best frame
    log: str
    run: str
    mission: str
    grid: str
    patches: tuple[int, ...]  # of its class in the best frame, numbered row by row

    def to_json(self) -> dict[str, Any]:
        """A GeoJSON feature (RFC 7946); its geometry is null without a position."""
        known = None not in (self.lat_deg, self.lon_deg)
        point = {"type": "Point", "coordinates": [self.lon_deg, self.lat_deg]}
        geometry = point if known else None
        return {"type": "Feature", "geometry": geometry, "properties": asdict(self)}


@dataclass(frozen=True)
class LoggedTrack:
    """A run's frames: where the vehicle was in each, and which patches were of which class."""

    run: LoggedRun
    mission: Mission | None  # its pictures, where they are
    grid: Grid
    lines: Sequence[Mapping[str, Any]]
    along_m: F64  # shape (n_frames,); nan where no position is known

    def place(self, along_m: float) -> tuple[float | None, float | None]:
        """Latitude and longitude at that way along the track; None where the log has none."""
        places = [(line["lat_deg"], line["lon_deg"]) for line in self.lines]
        known = np.array([None not in each for each in places]) & np.isfinite(self.along_m)
        if not known.any() or not math.isfinite(along_m):
            return None, None
        ways = self.along_m[known]
        values = np.array([each for each, good in zip(places, known, strict=True) if good], float)
        # Beyond the track's ends the last steps go on.
        lat, lon = (_extended(along_m, ways, values[:, axis]) for axis in (0, 1))
        return round(lat, 7), round(lon, 7)


def _extended(at: float, ways: F64, values: F64) -> float:
    """Interpolated between rising `ways`, and beyond the last by the last metres' slope."""
    if at <= ways[-1]:
        return float(np.interp(at, ways, values))
    back = max(int(np.searchsorted(ways, ways[-1] - 2.0)) - 1, 0)
    way = ways[-1] - ways[back]
    slope = (values[-1] - values[back]) / way if way > 0 else 0.0
    return float(values[-1] + slope * (at - ways[-1]))


def open_track(
    log: Path,
    run: str | None = None,
    source: Path | None = None,
    store: Path | None = None,
    odometry: Path | None = None,
) -> LoggedTrack:
    """Read a run of a log, by default its last one.

    Parameters
    ----------
    source, store : Path, optional
        Where the pictures and the run's models are, if not where the run had them.
    odometry : Path, optional
        Poses by frame; by default those that the run was given.

    Raises
    ------
    ToktError
        If the log cannot be read, its models are not there, or no class was logged.
    """
    logged = open_run(log, run)
    lines = [
        line
        for line in logged_lines(log, logged.run, [])
        if "event" not in line and type(line.get("frame")) is int
    ]
    if not any(isinstance(line.get("class_patches"), dict) for line in lines):
        raise ToktError(f"{log}: no frame names classes; findings need a model of several classes")
    models = list(models_of_run(logged, store).values())
    if len({model.grid for model in models}) != 1:
        raise ToktError(f"{log}: models of different grids judged in it")
    lines = [_sound(line, models[0], f"{log}") for line in lines]
    if odometry is None and logged.start.odometry is not None:
        odometry = Path(logged.start.odometry.path)
    poses = None if odometry is None else load_odometry(odometry)
    try:
        mission: Mission | None = pictures_of(log, logged.run, logged.start, source)[0]
    except ToktError:
        if source is not None:
            raise
        mission = None
    return LoggedTrack(logged, mission, models[0].grid, lines, _along(lines, poses))


_FIGURES = ("t", "distance_m", "lat_deg", "lon_deg", "depth_m")


def _sound(line: Mapping[str, Any], model: Bundle, where: str) -> dict[str, Any]:
    """A frame's line with what is asked of it here; ToktError where that is not what it says."""
    seen = line.get("class_patches") or {}
    good = isinstance(seen, dict) and all(
        isinstance(cells, list)
        and all(type(cell) is int and 0 <= cell < model.grid.n_patches for cell in cells)
        for cells in seen.values()
    )
    figures = {name: line.get(name) for name in _FIGURES}
    finite = (isinstance(each, int | float) and math.isfinite(each) for each in figures.values())
    if not good or not all(
        each is None or known for each, known in zip(figures.values(), finite, strict=True)
    ):
        raise ToktError(f"{where}: the line of frame {line['frame']} is damaged")
    return {**figures, "frame": line["frame"], "seen": seen}


def _along(lines: Sequence[Mapping[str, Any]], poses: Odometry | None) -> F64:
    """Metres along the track for each frame, from the first that has a position."""
    if poses is not None:
        known_poses = [poses.get(line["frame"]) for line in lines]
        places = [None if pose is None else pose.position_m for pose in known_poses]
    else:
        places = [_flat(line, lines) for line in lines]
    along = np.full(len(lines), np.nan)
    known = [at for at, place in enumerate(places) if place is not None]
    if len(known) < 2:
        return along
    track = np.array([places[at] for at in known], np.float64)
    # A track is rough: the way back and forth is not the way along.
    n = len(track)
    ends = [(max(at - _SMOOTHED, 0), min(at + _SMOOTHED, n - 1)) for at in range(n)]
    reach = [min(at - low, high - at) for at, (low, high) in enumerate(ends)]
    smooth = np.array([track[at - r : at + r + 1].mean(axis=0) for at, r in enumerate(reach)])
    steps = np.linalg.norm(np.diff(smooth, axis=0), axis=1)
    along[known] = np.concatenate([[0.0], np.cumsum(steps)])
    return along


def _flat(line: Mapping[str, Any], lines: Sequence[Mapping[str, Any]]) -> F64 | None:
    """Metres east and north of the first position; None without a position."""
    lat, lon = line["lat_deg"], line["lon_deg"]
    if lat is None or lon is None:
        return None
    first = next(each for each in lines if None not in (each["lat_deg"], each["lon_deg"]))
    north = math.radians(lat - first["lat_deg"])
    east = math.radians(lon - first["lon_deg"]) * math.cos(math.radians(lat))
    return np.array([east, north]) * _EARTH_M


@dataclass(eq=False)
class _Sighting:
    """A thing in one frame."""

    at: int  # of the log's frames, from 0
    cells: tuple[int, ...]
    x: float  # its centre, in patches from the left and the top
    y: float
    classes: Counter[str]

    def moved_since(self, group: _Group) -> float:
        """How far its centre is from a group's last, in patches a frame; 0 where they overlap."""
        last = group.last
        if not set(self.cells).isdisjoint(last.cells):
            return 0.0
        return math.hypot(last.x - self.x, last.y - self.y) / (self.at - last.at)


@dataclass
class _Group:
    """A thing over frames."""

    sightings: list[_Sighting] = field(default_factory=list)

    @property
    def last(self) -> _Sighting:
        """The newest."""
        return self.sightings[-1]

    @property
    def label(self) -> str:
        """The class of most of its patches."""
        return self.classes.most_common(1)[0][0]

    @property
    def classes(self) -> Counter[str]:
        """Its patches by class, over all frames."""
        return sum((each.classes for each in self.sightings), Counter())


def find(
    track: LoggedTrack,
    classes: Sequence[str] | None = None,
    ahead_m: float = 0.0,
    min_frames: int = MIN_FRAMES,
    min_patches: int = MIN_PATCHES,
) -> list[InspectionFinding]:
    """The findings of one run, along its track.

    Parameters
    ----------
    classes : sequence of str, optional
        Classes that are looked for. By default those in at most `RARE_SHARE` of the frames.
    ahead_m : float
        How far ahead of the vehicle's position the picture's middle looks, in metres.
    min_frames, min_patches : int
        Frames in which a thing must be seen, and patches that it has in its best frame.

    Raises
    ------
    ToktError
        If a class was never seen.
    """
    wanted = wanted_classes(track) if classes is None else tuple(classes)
    seen = {name for line in track.lines for name in line["seen"]}
    if unknown := [name for name in wanted if name not in seen]:
        it_saw = ", ".join(sorted(seen)) or "nothing"
        raise ToktError(f"{track.run.path}: never saw {', '.join(unknown)} (it saw {it_saw})")
    groups = _grouped(track, frozenset(wanted))
    found = [_finding(group, along_m, track) for group, along_m in _placed(groups, track, ahead_m)]
    return [it for it in found if it.frames >= min_frames and len(it.patches) >= min_patches]


def wanted_classes(track: LoggedTrack) -> tuple[str, ...]:
    """The classes that are seen in at most `RARE_SHARE` of the frames."""
    counts = Counter(name for line in track.lines for name in line["seen"])
    return tuple(name for name, n in counts.items() if n <= RARE_SHARE * len(track.lines))


def _sightings(
    line: Mapping[str, Any], at: int, grid: Grid, wanted: frozenset[str]
) -> list[_Sighting]:
    """Each patch or group of neighbouring ones of the wanted classes."""
    seen = ((name, cells) for name, cells in line["seen"].items() if name in wanted)
    labels = {cell: name for name, cells in seen for cell in cells}
    if not labels:
        return []
    mask = np.zeros((grid.rows, grid.cols), np.uint8)
    mask.flat[list(labels)] = 1
    n, parts = cv2.connectedComponents(mask, connectivity=8)
    found = []
    for part in range(1, n):
        rows, cols = np.nonzero(parts == part)
        cells = tuple((rows * grid.cols + cols).tolist())
        classes = Counter(labels[cell] for cell in cells)
        x, y = float(cols.mean()) + 0.5, float(rows.mean()) + 0.5
        found.append(_Sighting(at, cells, x, y, classes))
    return found


def _grouped(track: LoggedTrack, wanted: frozenset[str]) -> list[_Group]:
    """Things followed from frame to frame: the nearest of the last ones takes each sighting."""
    groups: list[_Group] = []
    for at, line in enumerate(track.lines):
        followed = [each for each in groups if 0 < at - each.last.at <= GAP_FRAMES]
        for seen in _sightings(line, at, track.grid, wanted):
            near = min(followed, key=seen.moved_since, default=None)
            if near is not None and seen.moved_since(near) <= REACH:
                followed.remove(near)
                near.sightings.append(seen)
            else:
                groups.append(_Group([seen]))
    return groups


def _placed(
    groups: list[_Group], track: LoggedTrack, ahead_m: float
) -> list[tuple[_Group, float | None]]:
    """Groups with their place in metres along the track; None where it is not known.

    Where enough things passed through the picture, they tell how far ahead each of its rows looks.
    Then each sighting has a place of its own, and what is at one place is one thing, whatever was
    seen between.
    """
    crossed = [_crossing(group, track) for group in groups]
    offsets = np.concatenate([np.zeros((0, 2)), *(each[1] for each in crossed if each is not None)])
    if len(offsets) >= MIN_PROJECTED:
        projection = np.polynomial.Polynomial.fit(offsets[:, 0], offsets[:, 1], 3)
        return [(group, here + ahead_m) for group, here in _at_places(groups, track, projection)]
    places = [None if each is None else each[0] + ahead_m for each in crossed]
    return sorted(
        zip(groups, places, strict=True), key=lambda each: (each[1] is None, each[1] or 0.0)
    )


def _crossing(group: _Group, track: LoggedTrack) -> tuple[float, F64] | None:
    """Where the vehicle is when a thing passes the picture's middle, and the other sightings.

    Of each sighting near the middle or beyond the height off the middle, in parts of the picture,
    and the way from there, in metres: shape (n, 2), none where it did not pass. None where no way
    is known.
    """
    along = np.array([track.along_m[each.at] for each in group.sightings])
    off = np.array([each.y / track.grid.rows - 0.5 for each in group.sightings])
    sizes = np.array([len(each.cells) for each in group.sightings])
    good = np.isfinite(along) & (sizes >= sizes.max() / 2)
    if not good.any():
        return None
    along, off = along[good], off[good]
    near = np.abs(off) <= MIDDLE
    if near.sum() < 2 or np.ptp(off[near]) <= 0.5 / track.grid.rows:
        return float(along[np.abs(off).argmin()]), np.zeros((0, 2))
    here = float(np.clip(np.polyfit(off[near], along[near], 1)[1], along.min(), along.max()))
    return here, np.column_stack([off, along - here])


def _at_places(
    groups: list[_Group], track: LoggedTrack, projection: Callable[[F64], F64]
) -> list[tuple[_Group, float]]:
    """All sightings grouped anew by their places along the track, the largest thing first."""
    every = [it for group in groups for it in group.sightings if np.isfinite(track.along_m[it.at])]
    off = np.array([each.y / track.grid.rows - 0.5 for each in every])
    places = np.array([track.along_m[each.at] for each in every]) - projection(off)
    order = np.argsort(places, kind="stable")
    every, places = [every[at] for at in order], places[order]
    sizes = np.cumsum([0, *(len(each.cells) for each in every)])
    around = [np.searchsorted(places, places + side * SAME_M / 2) for side in (-1, 1)]
    free = np.ones(len(every), bool)
    found: list[tuple[_Group, float]] = []
    for at in np.argsort(sizes[around[0]] - sizes[around[1]], kind="stable"):
        if not free[at]:
            continue
        low, high = np.searchsorted(places, [places[at] - SAME_M, places[at] + SAME_M])
        members = np.flatnonzero(free[low:high]) + low
        free[members] = False
        for part in _side_by_side([every[each] for each in members]):
            chosen = members[[every[each] in part for each in members]]
            weights = [len(every[each].cells) for each in chosen]
            here = float(np.repeat(places[chosen], weights).mean())
            found.append((_Group(sorted(part, key=lambda each: each.at)), here))
    return sorted(found, key=itemgetter(1))


def _side_by_side(sightings: list[_Sighting]) -> list[list[_Sighting]]:
    """Sightings of one place, apart where nothing is between them across the picture."""
    ordered = sorted(sightings, key=lambda each: each.x)
    parts = [[ordered[0]]]
    for before, each in pairwise(ordered):
        if each.x - before.x > APART:
            parts.append([])
        parts[-1].append(each)
    return parts


def _finding(group: _Group, along_m: float | None, track: LoggedTrack) -> InspectionFinding:
    label, rows = group.label, track.grid.rows
    best = max(
        group.sightings, key=lambda each: each.classes[label] * (1 - abs(each.y / rows - 0.5))
    )
    frames = len({each.at for each in group.sightings})
    first, last = group.sightings[0].at, group.sightings[-1].at
    pure = group.classes[label] / group.classes.total()
    line = track.lines[best.at]
    of_class = set(line["seen"].get(label, ()))
    lat, lon = track.place(math.nan if along_m is None else along_m)
    return InspectionFinding(
        label=label,
        first_frame=track.lines[first]["frame"],
        last_frame=track.lines[last]["frame"],
        best_frame=line["frame"],
        frames=frames,
        confidence=round(pure * frames / (last - first + 2), 2),
        distance_m=line["distance_m"],
        along_m=None if along_m is None else round(along_m, 2),
        lat_deg=lat,
        lon_deg=lon,
        depth_m=line["depth_m"],
        t=line["t"],
        log=str(track.run.path),
        run=track.run.run,
        mission=track.run.start.source if track.mission is None else track.mission.name,
        grid=str(track.grid),
        patches=tuple(cell for cell in best.cells if cell in of_class),
    )
