"""Approaches in the labels: distance and time left at the first status; false statuses an hour."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import theilslopes

from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import LEFT, RIGHT, Mission
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import pixel_mark
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.reason import Fault, Reason
from tokt.inference.replay.logged_run import open_run
from tokt.inference.sources.files import MissionSource, read_picture
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import (
    MIN_CLOSING_M_S,
    MIN_POINTS,
    MIN_SPAN_S,
    WINDOW_S,
    DisparityDetector,
)
from tokt.inference.verdict import OBSTACLE
from tokt.training.datasets.dive_positions import dive_positions
from tokt.training.datasets.folds import BLOCK_FRAMES

from .metrics import BOUND_CONFIDENCE, upper_bound

GONE_FRAMES = 20
"""Ocean frames in a row after which an obstacle is gone, and the next one another approach."""
SOON_FRAMES = 10
"""A distance is looked for up to so many frames after the status: stereo may see it later."""


class LoggedDistance(NamedTuple):
    """What a run's log tells of a frame; `left` is its picture's mark, or why there was none."""

    t: float | None
    distance_m: float | None
    left: str | Fault


@dataclass(frozen=True)
class AtSea:
    """What is stated of dives, beside their frames and labels.

    Raises ToktError if a number is out of its bounds, distances are to come from both or from
    nowhere.
    """

    rate: float | None = None  # frames a second; by default that of the log, if it has times
    stopping_m: float | None = None  # distance in which the vehicle stops
    calibration: StereoCalibration | None = None  # of the cameras; distances are measured by it
    log: Mapping[int, LoggedDistance] = field(default_factory=dict)  # by frame, of the same frames

    def __post_init__(self) -> None:
        if self.rate is not None and not 0 < self.rate < math.inf:
            raise ToktError(f"a rate is a positive number of frames per second, not {self.rate}")
        if self.stopping_m is not None and not 0 < self.stopping_m < math.inf:
            raise ToktError(f"a stopping distance is a length in metres, not {self.stopping_m}")
        if self.calibration is not None and self.log:
            raise ToktError("distances come from a calibration or from a log, not from both")
        if self.stopping_m is not None and self.calibration is None and not self.log:
            raise ToktError("a stopping distance needs distances: --calibration or --log")

    @property
    def frames_per_second(self) -> float | None:
        """The stated rate, or else the log's median one."""
        times = [one.t for one in self.log.values() if one.t is not None]
        if self.rate is not None or len(times) < 2:
            return self.rate
        period = float(np.median(np.diff(times)))
        return 1 / period if period > 0 else None


NOTHING_STATED = AtSea()


def logged_distances(path: Path) -> dict[int, LoggedDistance]:
    """Distances and times of the frames of a log's last run; ToktError if it has none."""
    found = {}
    for one in open_run(path).frames():
        metres = one.verdict["distance_m"]
        if metres is not None and (isinstance(metres, bool) or not isinstance(metres, int | float)):
            raise ToktError(f"{path}: frame {one.number} has distance {metres!r}, no number")
        t = one.t if one.timed and math.isfinite(one.t) else None
        found[one.number] = LoggedDistance(t, metres, one.left)
    if all(one.distance_m is None for one in found.values()):
        raise ToktError(f"{path}: its last run measured no distance (tokt run --calibration does)")
    return found


def approaches(frames: Iterable[int], ocean: Set[int], obstacle: Set[int]) -> list[tuple[int, int]]:
    """The approaches that labels show: each one's first and last obstacle frame.

    One begins with an obstacle frame after an ocean frame, and lasts until the obstacle is gone
    for `GONE_FRAMES` ocean frames in a row. Frames of neither kind neither begin nor end one, and
    a dive that begins before an obstacle has not approached that one.
    """
    found: list[tuple[int, int]] = []
    clear, needed = 0, 1
    for number in frames:
        clear += number in ocean
        if number not in obstacle:
            continue
        if clear >= needed:
            found.append((number, number))
        elif found:
            found[-1] = (found[-1][0], number)
        clear, needed = 0, GONE_FRAMES
    return found


@dataclass(frozen=True)
class KnownDistances:
    """Distances (m) and times (s) of a dive's frames by number, as far as they are known."""

    distance_m: Mapping[int, float] = field(default_factory=dict)
    seconds: Mapping[int, float] = field(default_factory=dict)

    def closing_m_s(self, frame: int) -> float | None:
        """Speed by which the distance shrinks around a frame; None of too few distances.

        Theil and Sen's slope over the runtime's `WINDOW_S` on both sides of the frame.
        """
        if frame not in self.seconds:
            return None
        points = [
            (at - self.seconds[frame], self.distance_m[number])
            for number, at in self.seconds.items()
            if number in self.distance_m and abs(at - self.seconds[frame]) <= WINDOW_S
        ]
        seconds, metres = np.array(points).reshape(-1, 2).T
        if len(points) < MIN_POINTS or np.ptp(seconds) < MIN_SPAN_S:
            return None
        return -float(theilslopes(metres, seconds).slope)


def known_distances(
    mission: Mission, spans: Sequence[tuple[int, int]], stated: AtSea, progress: Callable[..., Any]
) -> KnownDistances:
    """Distances and times of a mission's approaches, from its pairs or from a run's log.

    Raises ToktError if the mission has no pairs, is not of the calibration's size, or is not what
    the log is of.
    """
    numbers = mission.frames(LEFT)
    if stated.log:
        _check_log(mission, stated.log)
    if stated.rate is not None:
        positions = dive_positions(mission).of_frame
        seconds = {number: positions[number] / stated.rate for number in numbers}
    else:
        seconds = {number: one.t for number, one in stated.log.items() if one.t is not None}
    if stated.calibration is None:
        logged = {n: one.distance_m for n, one in stated.log.items() if one.distance_m is not None}
        return KnownDistances(logged, seconds)
    if RIGHT not in mission.cameras:
        raise ToktError(f"mission {mission.name!r} has no right camera: no distance by calibration")
    # With frames before each, from which the detector knows the rig's drift and what is faint.
    places = [(mission.place(first), mission.place(last)) for first, last in spans]
    wanted = [
        n for n in numbers if any(a - GONE_FRAMES <= mission.place(n) <= b for a, b in places)
    ]
    policy, measured = SinglePolicy(DisparityDetector(stated.calibration, DEFAULT_GRID)), {}
    source = MissionSource(mission, SYSTEM_CLOCK, wanted)
    for frame in progress(source, len(wanted), "measuring distances"):
        verdict = policy.judge(frame).verdict
        if verdict.reason is Reason.WRONG_SIZE:
            raise ToktError(f"mission {mission.name!r}, frame {frame.number}: {verdict.health}")
        if verdict.distance_m is not None:
            measured[frame.number] = verdict.distance_m
    return KnownDistances(measured, seconds)


def _check_log(mission: Mission, log: Mapping[int, LoggedDistance]) -> None:
    """Refuse a log of other frames: its numbers may be a camera's, or another dive's."""
    present = set(mission.frames(LEFT))
    marked = {n: one.left for n, one in log.items() if isinstance(one.left, str)}
    number = next((n for n in marked if n in present), None)
    picture = None if number is None else read_picture(mission, number, LEFT)[0]
    if number is None or picture is None or pixel_mark(picture) != marked[number]:
        raise ToktError(f"the log is not of the frames of mission {mission.name!r}")


def approach_figures(
    frames: Sequence[int],
    missed: Sequence[int],
    status: Sequence[int],
    spans: Iterable[tuple[int, int]],
    ranges: KnownDistances,
    stopping_m: float | None,
) -> list[dict[str, Any]]:
    """What is left at the first status of each approach, of those that `approaches` found.

    Frames, missed and status are as in `tokt.training.evaluation.evaluate.ScoredMission`. A status
    before an approach's first obstacle frame does not count for it. Found are
    first_obstacle_frame, last_obstacle_frame, first_status (frame), frames_late; distance_m, at the
    status or else the first one measured in the `SOON_FRAMES` after it, in distance_frame;
    closing_m_s and contact_s there; stopping_distance_m and enough. None is what is not known;
    enough is false where there is no status.
    """
    place = np.cumsum(np.asarray(missed) + 1)
    found = []
    for first, last in spans:
        begin, end = frames.index(first), frames.index(last) + 1
        said = next((i for i in range(begin, end) if status[i] == OBSTACLE), None)
        soon = range(0) if said is None else range(said, end)
        known = (frames[i] for i in soon if place[i] <= place[soon[0]] + SOON_FRAMES)
        near = next((number for number in known if number in ranges.distance_m), None)
        metres = None if near is None else ranges.distance_m[near]
        closing = None if near is None else ranges.closing_m_s(near)
        enough = None
        if stopping_m is not None and said is None:
            enough = False
        elif stopping_m is not None and metres is not None:
            enough = metres >= stopping_m
        contact = None
        if metres is not None and closing is not None and closing >= MIN_CLOSING_M_S:
            contact = metres / closing
        found.append(
            {
                "first_obstacle_frame": first,
                "last_obstacle_frame": last,
                "first_status": None if said is None else frames[said],
                "frames_late": None if said is None else int(place[said] - place[begin]),
                "distance_m": metres,
                "distance_frame": near,
                "closing_m_s": closing,
                "contact_s": contact,
                "stopping_distance_m": stopping_m,
                "enough": enough,
            }
        )
    return found


def false_status_per_hour(
    false: int, frames: int, false_blocks: int, blocks: int, rate: float | None
) -> dict[str, Any] | None:
    """False statuses in an hour of open ocean, and what the frames seen can show; None of none.

    Given are, of the ocean frames, those with a false status and all, the same of blocks of frames,
    which are near copies, and the frames a second. Found are rate_fps, in_frames (that all is said
    of: an hour's, 1000 without a rate), false_status, and upper_bound, by exact bounds of each
    rate: confidence, of_frames (false statuses, were frames independent), of_blocks (blocks with
    one), blocks (in_frames are so many).
    """
    if not frames:
        return None
    many = 1000.0 if rate is None else 3600 * rate
    return {
        "rate_fps": rate,
        "in_frames": many,
        "false_status": many * false / frames,
        "upper_bound": {
            "confidence": BOUND_CONFIDENCE,
            "of_frames": many * upper_bound(false, frames),
            "of_blocks": many / BLOCK_FRAMES * upper_bound(false_blocks, blocks),
            "blocks": many / BLOCK_FRAMES,
        },
    }
