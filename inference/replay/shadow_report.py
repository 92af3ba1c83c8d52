"""The report on a shadow log: where a challenger and the running model disagree.

Neither is known to be right here: this tells where they differ, and where to look. Frames that
follow each other show almost the same, so that a hundred frames of one thing are hardly more than
one piece of evidence: stretches and episodes are counted beside frames.
"""

import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from tokt.features.common.errors import ToktError, check_format
from tokt.inference.recording.log import LogGap, read_log
from tokt.inference.verdict import OBSTACLE, STATUS_WORDS, UNKNOWN, status_table

from .shadow import END, FAILED, SHADOW_FORMAT, START

EPISODE_GAP = 10
"""Compared frames without an obstacle that end an episode of it; fewer are gaps in it."""
SIDES = ("champion", "challenger")


@dataclass
class ShadowStretch:
    """Compared frames in a row, from number to number, on which the two differ alike."""

    first: int
    last: int
    frames: int
    champion: int
    challenger: int

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form, statuses in words."""
        return {**vars(self), **{side: STATUS_WORDS[getattr(self, side)] for side in SIDES}}


@dataclass
class Episode:
    """A time in which one of the two says obstacle, with short gaps; of compared frames, from 0."""

    begins: int
    ends: int


@dataclass
class ShadowReport:
    """A run's comparison; statuses are the champion's, then the challenger's."""

    run: str
    policy: str
    challenger: Mapping[str, str]  # ``label`` and ``sha256``
    live: bool
    champions: list[str] = field(default_factory=list)  # models whose verdicts were sent
    frames: int = 0  # compared
    dropped: int = 0  # those that the challenger was too slow for
    fault: str = ""  # why it judged no more
    lost_lines: int = 0  # places of the log that cannot be read
    statuses: Counter[tuple[int, int]] = field(default_factory=Counter)
    stretches: list[ShadowStretch] = field(default_factory=list)
    episodes: dict[str, list[Episode]] = field(default_factory=lambda: {side: [] for side in SIDES})
    latency_ms: dict[str, list[float]] = field(default_factory=lambda: {side: [] for side in SIDES})
    _open: bool = False

    def add(self, line: Mapping[str, Any]) -> None:
        """Take in one compared frame."""
        champion, challenger = line["champion"], line["challenger"]
        then, now, number = champion["status"], challenger["status"], line["frame"]
        self.statuses[then, now] += 1
        self.dropped += line["dropped"]
        model = champion["model"]
        if model is not None and model not in self.champions:
            self.champions.append(model)
        for side in SIDES:
            if line[side]["latency_ms"] is not None:
                self.latency_ms[side].append(line[side]["latency_ms"])
            if line[side]["status"] == OBSTACLE:
                self._obstacle(side)
        self._stretch(then, now, number)
        self.frames += 1

    def _obstacle(self, side: str) -> None:
        episodes = self.episodes[side]
        if not episodes or self.frames - episodes[-1].ends > EPISODE_GAP:
            episodes.append(Episode(self.frames, self.frames))
        episodes[-1].ends = self.frames

    def _stretch(self, champion: int, challenger: int, number: int) -> None:
        if champion == challenger:
            self._open = False
            return
        newest = self.stretches[-1] if self._open else None
        if newest is not None and (newest.champion, newest.challenger) == (champion, challenger):
            newest.last, newest.frames = number, newest.frames + 1
        else:
            self.stretches.append(ShadowStretch(number, number, 1, champion, challenger))
            self._open = True

    @property
    def agree(self) -> int:
        """Frames with one status."""
        return sum(count for (one, other), count in self.statuses.items() if one == other)

    def alone(self, side: str) -> tuple[int, int]:
        """Frames and stretches in which only that one says obstacle."""
        mine = [stretch for stretch in self.stretches if getattr(stretch, side) == OBSTACLE]
        return sum(stretch.frames for stretch in mine), len(mine)

    def unknown(self, side: str) -> int:
        """Frames on which that one says unknown."""
        place = SIDES.index(side)
        return sum(count for pair, count in self.statuses.items() if pair[place] == UNKNOWN)

    def shared_episodes(self, side: str) -> list[tuple[Episode, Episode]]:
        """Episodes of one with the first of the other's that begins or goes on in it."""
        other = next(each for each in SIDES if each != side)
        pairs: dict[int, tuple[Episode, Episode]] = {}
        for mine, theirs in product(self.episodes[side], self.episodes[other]):
            if theirs.begins <= mine.ends and theirs.ends >= mine.begins:
                pairs.setdefault(mine.begins, (mine, theirs))
        return list(pairs.values())

    def lead_frames(self) -> list[int]:
        """By how many compared frames the challenger begins earlier, in each shared episode."""
        return [mine.begins - theirs.begins for mine, theirs in self.shared_episodes("champion")]

    def latency(self, side: str) -> dict[str, float] | None:
        """Median, 99th percentile and maximum in milliseconds, or None without frames."""
        values = self.latency_ms[side]
        if not values:
            return None
        median, p99, most = np.percentile(values, [50, 99, 100])
        return {"median": float(median), "p99": float(p99), "max": float(most)}

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        sides = {}
        for side in SIDES:
            frames, stretches = self.alone(side)
            sides[side] = {
                "obstacle_alone_frames": frames,
                "obstacle_alone_stretches": stretches,
                "unknown_frames": self.unknown(side),
                "episodes": len(self.episodes[side]),
                "episodes_shared": len(self.shared_episodes(side)),
                "latency_ms": self.latency(side),
            }
        return {
            "run": self.run,
            "policy": self.policy,
            "live": self.live,
            "champions": self.champions,
            "challenger_model": dict(self.challenger),
            "frames": self.frames,
            "dropped": self.dropped,
            "agree": self.agree,
            "statuses": status_table(self.statuses),
            **sides,
            "challenger_leads_frames": self.lead_frames(),
            "differences": [stretch.to_json() for stretch in self.stretches],
            "fault": self.fault,
            "lost_lines": self.lost_lines,
        }


def read_shadow(path: Path, run: str | None = None) -> ShadowReport:
    """Read one run of a shadow log, by default the last.

    ToktError if there is no such log or run, or a line is not one of a shadow log.
    """
    gaps: list[LogGap] = []
    reports: dict[str, ShadowReport] = {}
    for line in read_log(path, gaps):
        try:
            check_format(line.get("format_version", SHADOW_FORMAT), SHADOW_FORMAT, str(path))
            _take(line, reports)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            detail = f"{type(error).__name__}: {error}"
            raise ToktError(f"{path} is no shadow log ({detail})") from None
    if not reports:
        raise ToktError(f"{path} has no run with a challenger")
    wanted = next(reversed(reports)) if run is None else run
    if wanted not in reports:
        raise ToktError(f"{path} has no run {wanted} (it has {', '.join(reports)})")
    reports[wanted].lost_lines = len(gaps)
    return reports[wanted]


def _take(line: Mapping[str, Any], reports: dict[str, ShadowReport]) -> None:
    """Add a line to its run's report."""
    event, run = line.get("event"), line["run"]
    if event == START:
        challenger = {name: str(line["challenger"][name]) for name in ("label", "sha256")}
        reports[run] = ShadowReport(run, str(line["policy"]), challenger, bool(line["live"]))
    elif event == FAILED:
        reports[run].fault = str(line["words"])
    elif event == END:
        # Frames that were overtaken after the last one that was judged are in no line.
        reports[run].dropped = max(reports[run].dropped, int(line["dropped"]))
    elif event is None:
        _check(line)
        reports[run].add(line)


def _check(line: Mapping[str, Any]) -> None:
    """Raise TypeError or ValueError where a frame's line is not what `ShadowReport.add` counts."""
    if type(line["frame"]) is not int or type(line["dropped"]) is not int:
        raise TypeError("a frame's number and how many were dropped are whole numbers")
    for side in SIDES:
        said = line[side]
        if said["status"] not in STATUS_WORDS:
            raise ValueError(f"there is no status {said['status']!r}")
        if said["model"] is not None and not isinstance(said["model"], str):
            raise TypeError(f"{said['model']!r} is no model's name")
        took = said["latency_ms"]
        number = type(took) in (int, float) and abs(took) <= sys.float_info.max
        if took is not None and not number:
            raise TypeError(f"{took!r} is no duration")
