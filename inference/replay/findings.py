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
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from operator import attrgetter
from typing import Any

import cv2
import numpy as np

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid

from .logged_track import LoggedTrack

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
LONG = 3.0
"""A thing that goes on for so many times what one picture shows runs along: it has no one place."""
PASSES = 0.9
"""Least correlation of height in the picture and way, where a thing passes through it."""
APART = 3.0
"""Patches across the picture without any sighting, from which there are two things."""
MIDDLE = 0.2
"""Part of the picture's height from its middle within which a thing tells its place."""


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


@dataclass(eq=False)
class _Sighting:
    """A thing in one frame."""

    at: int  # of the track's frames, from 0
    cells: tuple[int, ...]
    x: float  # its centre, in patches from the left
    y: float  # and from the top
    off: float  # the same from the picture's middle, in parts of its height
    classes: Counter[str]
    along_m: float  # of the vehicle; nan where not known
    place_m: float = math.nan  # of the thing, by how far ahead its height in the picture looks

    def moved_since(self, group: _Group) -> float:
        """How far its centre is from a group's last, in patches a frame; 0 where they overlap."""
        last = group.sightings[-1]
        if not set(self.cells).isdisjoint(last.cells):
            return 0.0
        return math.hypot(last.x - self.x, last.y - self.y) / (self.at - last.at)


@dataclass
class _Group:
    """A thing over frames."""

    sightings: list[_Sighting]
    along_m: float = math.nan  # where the vehicle is when its middle looks at the thing

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

    Looked for are `classes`, by default those in at most `RARE_SHARE` of the frames. The picture's
    middle looks `ahead_m` metres ahead of the vehicle's position. A thing must be seen in
    `min_frames` frames, and have `min_patches` patches in its best one.

    Raises ToktError if the models do not know a class.
    """
    wanted = rare_classes(track) if classes is None else tuple(classes)
    if unknown := [name for name in wanted if name not in track.classes]:
        known = ", ".join(track.classes)
        raise ToktError(f"{track.log}: its model knows no {', '.join(unknown)} (it knows {known})")
    groups = _placed(_followed(track, frozenset(wanted)), track.grid)
    found = [_finding(group, track, ahead_m) for group in groups]
    return [it for it in found if it.frames >= min_frames and len(it.patches) >= min_patches]


def rare_classes(track: LoggedTrack) -> tuple[str, ...]:
    """The classes that are seen in at most `RARE_SHARE` of the frames."""
    counts = Counter(name for seen in track.seen for name in seen)
    return tuple(name for name, n in counts.items() if n <= RARE_SHARE * len(track.lines))


def _followed(track: LoggedTrack, wanted: frozenset[str]) -> list[_Group]:
    """Things followed from frame to frame: the nearest of the last ones takes each sighting."""
    groups: list[_Group] = []
    near_by: list[_Group] = []
    for at, seen in enumerate(track.seen):
        near_by = [each for each in near_by if at - each.sightings[-1].at <= GAP_FRAMES]
        free, begun = [*near_by], []
        for one in _sightings(seen, at, track, wanted):
            nearest = min(free, key=one.moved_since, default=None)
            if nearest is not None and one.moved_since(nearest) <= REACH:
                free.remove(nearest)
                nearest.sightings.append(one)
            else:
                begun.append(_Group([one]))
        groups += begun
        near_by += begun
    return groups


def _sightings(
    seen: Mapping[str, Sequence[int]], at: int, track: LoggedTrack, wanted: frozenset[str]
) -> list[_Sighting]:
    """Each patch or group of neighbouring ones of the wanted classes."""
    grid = track.grid
    labels = {cell: name for name, cells in seen.items() if name in wanted for cell in cells}
    mask = np.zeros((grid.rows, grid.cols), np.uint8)
    mask.flat[list(labels)] = 1
    n, parts = cv2.connectedComponents(mask, connectivity=8)
    found = []
    for part in range(1, n):
        rows, cols = np.nonzero(parts == part)
        cells = tuple((rows * grid.cols + cols).tolist())
        classes = Counter(labels[cell] for cell in cells)
        y, along_m = float(rows.mean()) + 0.5, float(track.along_m[at])
        place = (float(cols.mean()) + 0.5, y, y / grid.rows - 0.5)
        found.append(_Sighting(at, cells, *place, classes, along_m))
    return found


def _placed(groups: list[_Group], grid: Grid) -> list[_Group]:
    """Groups in the order of their places; those without a place come last.

    Where enough things passed through the picture, they tell how far ahead each of its rows looks.
    Then each sighting has a place of its own, and what is at one place is one thing, whatever was
    seen between.
    """
    passed = [_passed(group, grid) for group in groups]
    offsets = np.concatenate([np.zeros((0, 2)), *passed])
    if len(offsets) >= MIN_PROJECTED:
        groups = _at_places(groups, offsets)
    # nan is behind all numbers
    return [groups[at] for at in np.argsort([each.along_m for each in groups], kind="stable")]


def _passed(group: _Group, grid: Grid) -> F64:
    """Say where a group is seen in the picture's middle; how it passed through the picture.

    Of each sighting the height off the middle, in parts of the picture, and the way from where it
    is in the middle, in metres: shape (n, 2), none of a thing that did not pass.
    """
    along = np.array([each.along_m for each in group.sightings])
    off = np.array([each.off for each in group.sightings])
    sizes = np.array([len(each.cells) for each in group.sightings])
    good = np.isfinite(along) & (sizes >= sizes.max() / 2)
    nothing = np.zeros((0, 2))
    if not good.any():
        return nothing
    along, off = along[good], off[good]
    near = np.abs(off) <= MIDDLE
    if near.sum() < 2 or np.ptp(off[near]) <= 0.5 / grid.rows:
        group.along_m = float(along[np.abs(off).argmin()])
        return nothing
    middle = float(np.polyfit(off[near], along[near], 1)[1])
    group.along_m = float(np.clip(middle, along.min(), along.max()))
    steady = np.ptp(along) > 0 and abs(np.corrcoef(off, along)[0, 1]) >= PASSES
    return np.column_stack([off, along - group.along_m]) if steady else nothing


def _at_places(groups: list[_Group], offsets: F64) -> list[_Group]:
    """Sightings grouped anew by their places along the track, the largest thing first.

    What runs along the track, and what was seen where no position is known, stays as it was
    followed.
    """
    heights = offsets[:, 0]
    projection = np.polynomial.Polynomial.fit(heights, offsets[:, 1], 3)
    view_m = float(np.ptp(projection(np.linspace(heights.min(), heights.max()))))
    kept: list[_Group] = []
    loose: list[_Sighting] = []
    for group in groups:
        along = np.array([each.along_m for each in group.sightings])
        placed = np.isfinite(along)
        if placed.any() and np.ptp(along[placed]) > LONG * view_m:
            kept.append(group)
            continue
        loose += [each for each, known in zip(group.sightings, placed, strict=True) if known]
        if not placed.all():
            kept.append(_Group([each for each in group.sightings if math.isnan(each.along_m)]))
    for each in loose:
        # What never was seen to pass so far up or down is not guessed.
        off = min(max(each.off, heights.min()), heights.max())
        each.place_m = each.along_m - float(projection(off))
    return kept + _clustered(loose)


def _clustered(sightings: list[_Sighting]) -> list[_Group]:
    """Sightings within `SAME_M` of a place, where the most patches are first."""
    ordered = sorted(sightings, key=attrgetter("place_m"))
    places = np.array([each.place_m for each in ordered])
    patches = np.cumsum([0, *(len(each.cells) for each in ordered)])
    first, last = (np.searchsorted(places, places + side * SAME_M / 2) for side in (-1, 1))
    free = np.ones(len(ordered), bool)
    found: list[_Group] = []
    for at in np.argsort(patches[first] - patches[last], kind="stable"):
        if not free[at]:
            continue
        low, high = np.searchsorted(places, [places[at] - SAME_M, places[at] + SAME_M])
        members = np.flatnonzero(free[low:high]) + low
        free[members] = False
        found += map(_at_one_place, _side_by_side([ordered[each] for each in members]))
    return found


def _at_one_place(sightings: list[_Sighting]) -> _Group:
    weights = [len(each.cells) for each in sightings]
    place_m = float(np.average([each.place_m for each in sightings], weights=weights))
    return _Group(sorted(sightings, key=attrgetter("at")), place_m)


def _side_by_side(sightings: list[_Sighting]) -> list[list[_Sighting]]:
    """Sightings of one place, apart where nothing is between them across the picture."""
    ordered = sorted(sightings, key=attrgetter("x"))
    parts = [[ordered[0]]]
    for before, each in pairwise(ordered):
        if each.x - before.x > APART:
            parts.append([])
        parts[-1].append(each)
    return parts


def _finding(group: _Group, track: LoggedTrack, ahead_m: float) -> InspectionFinding:
    classes = group.classes
    label, of_label = classes.most_common(1)[0]
    best = max(group.sightings, key=lambda each: each.classes[label] * (1 - abs(each.off)))
    frames = len({each.at for each in group.sightings})
    first, last = group.sightings[0].at, group.sightings[-1].at
    line, of_class = track.lines[best.at], set(track.seen[best.at].get(label, ()))
    along_m = group.along_m + ahead_m
    lat, lon = track.place(along_m)
    return InspectionFinding(
        label=label,
        first_frame=track.lines[first]["frame"],
        last_frame=track.lines[last]["frame"],
        best_frame=line["frame"],
        frames=frames,
        confidence=round(of_label / classes.total() * frames / (last - first + 2), 2),
        distance_m=line["distance_m"],
        along_m=None if math.isnan(along_m) else round(along_m, 2),
        lat_deg=lat,
        lon_deg=lon,
        depth_m=line.get("depth_m"),
        t=line["t"],
        log=track.log,
        run=track.run,
        mission=track.mission_name,
        grid=str(track.grid),
        patches=tuple(cell for cell in best.cells if cell in of_class),
    )
