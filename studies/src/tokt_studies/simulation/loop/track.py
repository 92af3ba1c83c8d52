"""The record of one flight: the vehicle's path, the planner's modes, the verdicts heard."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64, I64, Bools
from tokt.features.common.errors import ToktError

from .autopilot import Mode
from .vehicle import HULL_RADIUS_M, State

Step = tuple[float, State, Mode, float]
"""Time, the vehicle's state, the planner's mode, and the clearance."""
SaidOfFrame = tuple[float, int, bool]
"""When a frame was taken, its status (-1 also where nothing was said), and whether something solid
was before the camera, near enough to be seen."""
IN_VIEW_M = 10.0
"""What is solid and farther off, along the camera's axis, counts as nothing to see."""


TRACK_FORMAT = 1
"""Version of a track's file."""


@dataclass(frozen=True, eq=False)
class Track:
    """One run, as it was recorded: arrays of n control steps, m frames and k avoidances."""

    title: str  # the scene in words
    scene: str
    method: str  # what judged the frames
    seed: int
    reached: bool  # whether it came to the goal, or kept its station
    t_s: F64  # (n,), from the start
    position: F64  # (n, 3): the vehicle's centre, east, down, north, m
    heading: F64  # (n,), rad
    mode: np.ndarray[Any, np.dtype[np.str_]]  # (n,): the planner's `Mode`
    clearance_m: F64  # (n,): from that centre to the nearest solid; infinite where there is none
    frame_t_s: F64  # (m,): when frames were taken
    frame_status: I64  # (m,): 1 obstacle, 0 clear, -1 unknown or nothing said
    frame_in_view: Bools  # (m,): something solid, within `IN_VIEW_M`
    avoidances_s: F64  # (k,): when the planner began to avoid
    frame_anchor: I64  # (m,), or (0,): 0 not held, 1 held, 2 held where the object is not
    station: F64  # (3,): the wanted place before an object, m; NaN without one

    @classmethod
    def recorded(
        cls, title: str, scene: str, method: str, seed: int, steps: Sequence[Step],
        frames: Sequence[SaidOfFrame], avoidances_s: Sequence[float], reached: bool,
        station: F64 | None = None, anchor: Sequence[int] = (),
    ) -> Track:  # fmt: skip
        """The track of a run's steps and frames."""
        times, states, modes, clearances = zip(*steps, strict=True)
        said = np.array(frames, np.float64).reshape(-1, 3)
        return cls(
            title, scene, method, seed, reached,
            t_s=np.array(times),
            position=np.stack([state.position for state in states]),
            heading=np.array([state.heading_rad for state in states]),
            mode=np.array([str(mode) for mode in modes]),
            clearance_m=np.array(clearances),
            frame_t_s=said[:, 0],
            frame_status=said[:, 1].astype(np.int64),
            frame_in_view=said[:, 2].astype(np.bool_),
            avoidances_s=np.array(avoidances_s, np.float64),
            frame_anchor=np.array(anchor, np.int64),
            station=np.full(3, np.nan) if station is None else station,
        )  # fmt: skip

    def to_bytes(self, about: dict[str, Any]) -> bytes:
        """An npz file's content; `about` (plain JSON) says how it was flown."""
        everything = vars(self)
        arrays: dict[str, Any] = {k: v for k, v in everything.items() if isinstance(v, np.ndarray)}
        names = {key: value for key, value in everything.items() if key not in arrays}
        words = json.dumps({"format": TRACK_FORMAT, "about": about, **names})
        file = io.BytesIO()
        np.savez_compressed(file, words=words, **arrays)
        return file.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes) -> tuple[Track, dict[str, Any]]:
        """The same again, with `about`. Raises ToktError for a file of another format."""
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = dict(file)
        words = json.loads(str(arrays.pop("words")))
        if words.pop("format") != TRACK_FORMAT:
            raise ToktError(f"a track of another format than {TRACK_FORMAT}")
        about = words.pop("about")
        # What the first tracks do not have.
        arrays.setdefault("frame_anchor", np.zeros(0, np.int64))
        arrays.setdefault("station", np.full(3, np.nan))
        return cls(**words, **arrays), about

    def places(self, status: int, until_s: float = math.inf) -> F64:
        """(k, 3) Where the vehicle was when the frames of a status were taken, till a time."""
        t_s = self.frame_t_s[(self.frame_status == status) & (self.frame_t_s <= until_s)]
        return np.stack([np.interp(t_s, self.t_s, along) for along in self.position.T], axis=1)

    @property
    def least_m(self) -> float:
        """The least clearance; infinite where there is nothing solid."""
        return float(self.clearance_m.min())

    @property
    def collided(self) -> bool:
        """Whether the hull touched something solid."""
        return self.least_m < HULL_RADIUS_M

    @property
    def nearest(self) -> int:
        """The step at which the clearance was least; 0 where there is nothing solid."""
        return int(np.argmin(self.clearance_m))
