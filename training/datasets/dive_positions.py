"""Positions of frames in their dive, by time where it is known, and the length of a scene.

Blocks of frames that are held out together, and the gaps around them, are counted in frames of the
dive. A number in a file's name is no time: the same pictures, numbered in steps of ten, would give
blocks a tenth as long, whose neighbours are near copies of each other.
"""

import csv
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from math import ceil, isfinite
from pathlib import Path
from statistics import median

import cv2
import numpy as np
from PIL import Image

from tokt.features.common.arrays import F64, I64
from tokt.features.common.errors import FrameError, ToktError
from tokt.features.common.names import same_text
from tokt.features.frames.mission import LEFT, FolderMission, Mission, VideoMission
from tokt.features.frames.single_pictures import seconds_taken
from tokt.labels.formats.frame_metadata import mission_metadata

from .folds import BLOCK_FRAMES, block_of

TIMES_FILE = "times.csv"
"""Beside the frames: columns ``file`` and ``time`` (seconds, or ISO 8601)."""

_SIDE_PX = (20, 15)  # of the small pictures that are compared: what a scene is, without its texture
_MOST_PICTURES = 256
_ALIKE = 0.5
"""A scene is another one where frames are half as unlike as any two frames of the dive."""
_FEWEST_PAIRS = 8  # of frames equally far apart, for a median
_GROWTH = 1.25  # of the distances, from one to the next, at which frames are compared
_LONGEST_DIVE = 10**9  # frames; a year at 30 a second
_LEAST_FRAMES = 40  # of a dive: of fewer there are too few pairs


@dataclass(frozen=True)
class DivePositions:
    """The positions of a dive's frames, counted in frames from 1."""

    of_frame: dict[int, int]
    remark: str = ""  # what a person should know of how it was found


def dive_positions(mission: Mission) -> DivePositions:
    """Return where frames come: by their times where all are known, else by their order.

    Times are those of `TIMES_FILE`, of an iFDO file with the mission, or of the pictures' Exif; a
    video's frames are equally far apart. One frame more is the median time between two. Times that
    go back or stand still are not taken, with a remark.
    """
    frames = sorted({n for camera in mission.cameras for n in mission.frames(camera)})
    frames.sort(key=mission.place)
    by_order = {number: mission.place(number) + 1 for number in frames}
    if not isinstance(mission, FolderMission) or len(frames) < 2:
        return DivePositions(by_order)
    for source, read in (
        (TIMES_FILE, _times_in_table),
        ("iFDO", _times_in_ifdo),
        ("Exif", _times_in_pictures),
    ):
        try:
            times = read(mission)
        except ToktError as error:
            return DivePositions(by_order, f"times are not used: {error}")
        if not times:
            continue
        known = [times.get(number) for number in frames]
        if None in known:
            return DivePositions(by_order, f"{source} has no time of some frames: not used")
        seconds = [time for time in known if time is not None]
        steps = [after - before for before, after in pairwise(seconds)]
        if min(steps) < 0:
            at = frames[1 + int(np.argmin(steps))]
            words = f"by {source} frame {at} of {mission.name} is earlier than the one before it"
            return DivePositions(by_order, f"{words}: times are not used")
        if min(steps) == 0:  # whole seconds, of a camera that takes several a second
            return DivePositions(by_order)
        usual = median(steps)
        if not (seconds[-1] - seconds[0]) / usual <= _LONGEST_DIVE:
            return DivePositions(by_order, f"times of {source} are years apart: not used")
        places = np.rint((np.array(seconds) - seconds[0]) / usual).astype(np.int64)
        # Frames nearer than half a step still follow each other.
        places = np.maximum.accumulate(places - np.arange(len(places))) + np.arange(len(places))
        return DivePositions(dict(zip(frames, (1 + places).tolist(), strict=True)))
    return DivePositions(by_order)


def _times_in_table(mission: FolderMission) -> dict[int, float]:
    """Seconds by frame, from the CSV file beside the frames; ToktError if it cannot be read."""
    file = mission.path / TIMES_FILE
    if not file.is_file():
        return {}
    numbers = {
        same_text(mission.file(number, camera).name): number
        for camera in mission.cameras
        for number in mission.frames(camera)
    }
    try:
        with file.open(encoding="utf-8-sig", newline="") as opened:
            rows = list(csv.DictReader(opened))
        return {
            numbers[name]: _seconds(row["time"])
            for row in rows
            if (name := same_text(Path(row["file"]).name)) in numbers
        }
    except (OSError, UnicodeDecodeError, csv.Error, ValueError, TypeError, KeyError) as error:
        raise ToktError(
            f"{file}: not a table of columns file and time ({type(error).__name__}: {error})"
        ) from None


def _seconds(text: str) -> float:
    """A time in seconds, or as ISO 8601 writes it."""
    try:
        seconds = float(text)
    except ValueError:
        moment = datetime.fromisoformat(text)
        seconds = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    if not isfinite(seconds):
        raise ValueError(f"{text[:20]!r} is no time")
    return seconds


def _times_in_ifdo(mission: FolderMission) -> dict[int, float]:
    metadata = mission_metadata(mission)
    times = {key.frame: one.time for key, one in metadata.items() if one.time}
    return {number: _seconds(time) for number, time in times.items()}


def _times_in_pictures(mission: FolderMission) -> dict[int, float]:
    """Seconds by frame, where the camera wrote down a time in every picture."""
    found: dict[int, float] = {}
    for number in mission.frames(LEFT):
        try:
            with Image.open(mission.file(number)) as picture:
                taken = seconds_taken(picture)
        except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
            taken = None
        if taken is None:
            return {}
        found[number] = taken
    return found


def scene_length(
    mission: Mission, positions: Mapping[int, int], used: Collection[int] = ()
) -> int | None:
    """Return the frames for which a scene stays the same; None of too few frames.

    It is the distance at which two frames are half as unlike as two frames that are a quarter of
    the dive or more apart, in the median. Unlike is 1 minus the correlation of two small gray
    pictures, without what all pictures of the dive have in common. Where frames a quarter of the
    dive apart are not that unlike, it is a quarter of the dive.

    A video is read in order: it is looked at up to the last of the frames that are `used`.
    """
    frames = mission.frames(LEFT)
    if used and isinstance(mission, VideoMission):
        frames = frames[: mission.place(max(used)) + 1]
    if len(frames) < _LEAST_FRAMES:
        return None
    small, places = [], []
    for number in _chosen(frames):
        try:
            picture = mission.read(number, LEFT)
        except FrameError:
            continue
        gray = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        small.append(cv2.resize(gray, _SIDE_PX, interpolation=cv2.INTER_AREA).ravel())
        places.append(positions[number])
    if len(small) < _LEAST_FRAMES:
        return None
    return _length(np.array(small, np.float64), np.array(places, np.int64))


def independent_blocks(mission: Mission, used: Collection[int]) -> dict[int, str]:
    """Return the block of each frame: frames of different blocks are no near copies.

    A block is as long as the scene stays the same (`scene_length`), or `BLOCK_FRAMES` at the least.
    """
    positions = dive_positions(mission).of_frame
    length = max(BLOCK_FRAMES, scene_length(mission, positions, used) or 0)
    return {frame: block_of(mission.name, at, length) for frame, at in positions.items()}


def _chosen(frames: Sequence[int]) -> list[int]:
    """All frames of a short dive; of a longer one some, near and far from each other."""
    if len(frames) <= _MOST_PICTURES:
        return list(frames)
    offsets = [0, 1, 2, 4, 8, 16, 32, 64]
    starts = np.linspace(0, len(frames) - 1, _MOST_PICTURES // len(offsets)).astype(int).tolist()
    places = {start + offset for start in starts for offset in offsets}
    return [frames[place] for place in sorted(places) if place < len(frames)]


def _length(small: F64, places: I64) -> int:
    own = small - small.mean(axis=0)
    own -= own.mean(axis=1, keepdims=True)
    own /= np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1e-9)
    one, other = np.triu_indices(len(own), 1)
    apart = places[other] - places[one]
    unlike = 1 - (own @ own.T)[one, other]
    quarter = (places[-1] - places[0]) / 4
    usual = float(np.median(unlike[apart >= quarter]))
    before, distance = (0.0, 0.0), 1
    while distance < quarter:
        end = max(distance + 1, round(distance * _GROWTH))
        inside = (apart >= distance) & (apart < end)
        if inside.sum() >= _FEWEST_PAIRS:
            at = float(np.median(apart[inside])), float(np.median(unlike[inside]))
            if at[1] >= _ALIKE * usual:
                return _crossing(before, at, _ALIKE * usual)
            before = at
        distance = end
    return ceil(float(quarter))


def _crossing(before: tuple[float, float], at: tuple[float, float], level: float) -> int:
    """Return the distance at which a line between two points reaches a level, on a log scale."""
    if before[0] == 0 or at[1] == before[1]:
        return ceil(at[0])
    part = (level - before[1]) / (at[1] - before[1])
    return ceil(float(before[0] * (at[0] / before[0]) ** part))
