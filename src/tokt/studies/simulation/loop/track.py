"""The record of one flight: the vehicle's path, the planner's modes, the verdicts heard."""

from collections.abc import Sequence

import numpy as np

from tokt.features.common.arrays import F64

from .autopilot import Mode
from .vehicle import State

Step = tuple[float, State, Mode, float]
"""Time, the vehicle's state, the planner's mode, and the clearance."""
SaidOfFrame = tuple[float, int, bool]
"""When a frame was taken, its status (-1 also where nothing was said), and whether something solid
was before the camera, near enough to be seen."""
IN_VIEW_M = 10.0
"""What is solid and farther off, along the camera's axis, counts as nothing to see."""


class Track:
    """One run, as it was recorded: arrays of n control steps, m frames and k avoidances.

    It has the scene in words, its name, what judged the frames, and whether it came to the goal.
    """

    def __init__(
        self, title: str, scene: str, method: str, seed: int, steps: Sequence[Step],
        frames: Sequence[SaidOfFrame], avoidances_s: Sequence[float], reached: bool,
    ) -> None:  # fmt: skip
        self.title, self.scene, self.method, self.seed = title, scene, method, seed
        times, states, modes, clearances = zip(*steps, strict=True)
        said = np.array(frames, np.float64).reshape(-1, 3)
        self.t_s = np.array(times)  # (n,), from the start
        # (n, 3): the vehicle's centre, east, down, north, m
        self.position = np.stack([state.position for state in states])
        self.heading = np.array([state.heading_rad for state in states])  # (n,), rad
        self.mode = np.array([str(mode) for mode in modes])  # (n,): the planner's `Mode`
        # (n,): from the vehicle's centre to the nearest solid; infinite where there is none
        self.clearance_m = np.array(clearances)
        self.frame_t_s = said[:, 0]  # (m,): when frames were taken
        self.frame_status = said[:, 1].astype(np.int64)  # 1 obstacle, 0 clear, -1 unknown, nothing
        self.frame_in_view = said[:, 2].astype(np.bool_)  # something solid, within `IN_VIEW_M`
        self.avoidances_s = np.array(avoidances_s, np.float64)  # when the planner began to avoid
        self.reached = reached

    def at(self, t_s: F64) -> F64:
        """(k, 3) Where the vehicle was at these times, k of them."""
        return np.stack(
            [np.interp(t_s, self.t_s, self.position[:, axis]) for axis in range(3)], axis=1
        )

    @property
    def obstacle_places(self) -> F64:
        """(k, 3) Where it was when a frame was taken that the verdict obstacle is of."""
        return self.at(self.frame_t_s[self.frame_status == 1])

    @property
    def nearest(self) -> int:
        """The step at which the clearance was least; 0 where there is nothing solid."""
        return int(np.argmin(self.clearance_m))
