"""One manoeuvre past an obstacle: what was seen of it, in its own frame, and how far to go.

The frame is the body-fixed one of the moment at which the obstacle was first seen: `along` is
ahead, `beside` to the side that the planner passes on. All that follows is remembered in it, as
the body itself moves and turns on.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from tokt.features.common.arrays import F64

from .vehicle import CAMERA_AHEAD_M, State, turn

BACK_OFF_M, BACK_OFF_MOST_M = 3.0, 6.0
"""How far back at least, and at most, from where it was nearest."""
BACK_ON_M = 1.0
"""While it is to back off, it goes on for this much at least."""
ON_HEADING = math.radians(4)
"""Nearer to a heading than this looks along it."""
FOCAL_PX, MASK_WIDTH = 588.0, 360
"""Of the frame as the model sees it, in pixels: 2222 px at 1360 is 588 at 360."""
NEAR_M, FAR_M = 3.0, 9.0
"""Between these an obstacle of unknown distance is: nearer it is backed off from before, and from
farther it is not seen."""
DISTANCE_ERROR = 0.15
"""Of a distance that is known, as a fraction."""
HALF_M, WIDE_HALF_M = 0.9, 3.0
"""From the centre of what is seen to its edge: a tower's legs reach 0.85 m from its axis; where the
mean value is large, the obstacle goes on beyond the view."""
DEPTH_M = 1.8
"""From an obstacle's near end to its far end."""


def bearing(column: float) -> float:
    """Radians to starboard of a column, in pixels from the frame's middle."""
    return math.atan(column / FOCAL_PX)


HALF_VIEW = bearing(MASK_WIDTH / 2)
"""Radians from the middle of the frame to its edge."""


class ObstacleSighting(NamedTuple):
    """An obstacle as one verdict shows it, in metres of the manoeuvre's frame."""

    at: float  # how far along the vehicle was
    edge: float  # how far it reaches to the side that is passed on, at most
    end: float  # how far along it reaches, at most
    places: tuple[tuple[float, float], ...]  # of its centre, at the least and greatest distance


@dataclass
class Manoeuvre:
    """One manoeuvre past an obstacle, or several that are seen together."""

    origin: F64  # (3,): where the vehicle was when it began
    look: float  # its heading then, which it keeps, and that of the frame; rad
    side: int  # passed on: port (-1) or starboard (1)
    hold_along: float  # where along the vehicle goes sideways
    oncoming: bool = False  # whether what was seen comes towards the vehicle
    retreat: tuple[float, float] | None = None  # where to back off to, along and beside
    nearest: float = -math.inf  # the farthest along at which it had to back off
    settled: int = 0  # verdicts since something new was seen
    absent: int = 0  # clear verdicts in a row that should not be, if what was seen is there
    glance: tuple[F64, float] | None = None  # past it: where it looks whether the way back is free
    glances: int = 0  # clear verdicts in that direction
    seen: list[ObstacleSighting] = field(default_factory=list)

    def place(self, position: F64) -> tuple[float, float]:
        """(along, beside) of a place in the world."""
        east, _, north = position - self.origin
        sine, cosine = math.sin(self.look), math.cos(self.look)
        return north * cosine + east * sine, self.side * (east * cosine - north * sine)

    def world(self, along: float, beside: float, depth: float) -> F64:
        """(3,) The place in the world, at a depth (the world's y)."""
        sine, cosine = math.sin(self.look), math.cos(self.look)
        right = self.side * beside
        east = self.origin[0] + along * sine + right * cosine
        north = self.origin[2] + along * cosine - right * sine
        return np.array([east, depth, north])

    def see(self, datagram: Mapping[str, Any], nav: State, wide: bool) -> None:
        """Remember what a verdict of status 1 says, from where the vehicle is."""
        own = self.place(nav.position)
        turned = turn(nav.heading_rad - self.look)
        ranges, distance_m = (NEAR_M, FAR_M), datagram.get("distance_m")
        if distance_m is not None:
            ranges = distance_m * (1 - DISTANCE_ERROR), distance_m * (1 + DISTANCE_ERROR)
        centre = turned + bearing(-(datagram["x"] or 0))
        places = tuple(self._spot(own, turned, centre, far) for far in ranges)
        half = WIDE_HALF_M if wide else HALF_M
        edge = max(beside for _, beside in places) + half
        box = datagram.get("box")
        if box is not None:
            column = box[0] + (box[2] if self.side > 0 else 0) - MASK_WIDTH / 2
            rim = turned + bearing(column)
            edge = max(edge, *(self._spot(own, turned, rim, far)[1] for far in ranges))
        end = max(along for along, _ in places) + DEPTH_M
        before = self.edge(own[0])
        self.seen.append(ObstacleSighting(own[0], edge, end, places))
        self.absent = self.glances = 0
        self.glance = None
        # A tenth of a metre more is noise of the mask's centre, not another obstacle.
        self.settled = 0 if self.edge(own[0]) > before + 0.1 else self.settled + 1

    def suppose_wall(self) -> None:
        """Take something wide for granted ahead, of which nothing was seen."""
        places = (NEAR_M, 0.0), (FAR_M, 0.0)
        self.seen.append(ObstacleSighting(0.0, WIDE_HALF_M, NEAR_M + DEPTH_M, places))

    def clear(self, nav: State, within: float) -> None:
        """Count a clear verdict: in a glance, or where what was seen should be in view.

        That is `within` so many radians of the view's middle.
        """
        own = self.place(nav.position)
        turned = turn(nav.heading_rad - self.look)
        # From farther away than it was seen, not seeing it says nothing.
        in_view = all(
            own[0] >= one.at - 0.3 and abs(self._off_middle(own, turned, spot)) <= within
            for one in self.seen
            for spot in one.places
        )
        self.absent = self.absent + 1 if in_view else 0
        self.settled += 1
        if self.glance is not None and abs(turn(nav.heading_rad - self.glance[1])) < ON_HEADING:
            self.glances += 1

    def back_off(self, nav: State) -> None:
        """Go straight back, and on while this is asked for."""
        along, beside = self.place(nav.position)
        self.nearest = max(self.nearest, along)
        wanted = self.nearest - BACK_OFF_M
        if self.retreat is not None:
            before, beside = self.retreat
            wanted = max(min(before, along - BACK_ON_M), self.nearest - BACK_OFF_MOST_M)
        if wanted < along:
            self.retreat = wanted, beside

    def edge(self, along: float) -> float:
        """How far what is remembered and not yet behind reaches to the side passed on."""
        return max((one.edge for one in self.seen if one.end > along), default=-math.inf)

    def end(self) -> float:
        """How far along what is remembered reaches."""
        return max(one.end for one in self.seen)

    def _spot(
        self, own: tuple[float, float], turned: float, angle: float, far: float
    ) -> tuple[float, float]:
        along, beside = self._camera(own, turned)
        return along + far * math.cos(angle), beside + self.side * far * math.sin(angle)

    def _off_middle(
        self, own: tuple[float, float], turned: float, spot: tuple[float, float]
    ) -> float:
        along, beside = self._camera(own, turned)
        return math.atan2(self.side * (spot[1] - beside), spot[0] - along) - turned

    def _camera(self, own: tuple[float, float], turned: float) -> tuple[float, float]:
        return (
            own[0] + CAMERA_AHEAD_M * math.cos(turned),
            own[1] + self.side * CAMERA_AHEAD_M * math.sin(turned),
        )
