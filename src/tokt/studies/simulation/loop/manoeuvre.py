"""One manoeuvre past an obstacle: what was seen of it, in its own frame, and how far to go.

The frame is the body-fixed one of the moment at which the obstacle was first seen: `along` is
ahead, `beside` to the side that the planner passes on. All that follows is remembered in it, as
the body itself moves and turns on.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64

from .vehicle import CAMERA_AHEAD_M, State, turn

BACK_ON_M = 1.0
"""While it is to back off, it goes on for this much at least."""
ON_HEADING = math.radians(4)
"""Nearer to a heading than this looks along it."""


@dataclass(frozen=True)
class CameraAssumptions:
    """The camera that judges, and what is assumed where a datagram does not say; metres.

    Parameters
    ----------
    focal_px : float
        Of the frame as the model sees it: 2222 px at 1360, so 588 at 360.
    mask_width : int
        Of that frame, in pixels.
    near_m, far_m : float
        Between these an obstacle of unknown distance is: nearer it is backed off from before, and
        from farther it is not seen.
    distance_error : float
        Of a distance that is known, as a fraction.
    half_m : float
        From the centre of what is seen to its edge. A tower's legs reach 0.85 m from its axis.
    wide_half_m : float
        The same where the mean value is large: the obstacle goes on beyond the view.
    depth_m : float
        From an obstacle's near end to its far end.
    """

    focal_px: float = 588.0
    mask_width: int = 360
    near_m: float = 3.0
    far_m: float = 9.0
    distance_error: float = 0.15
    half_m: float = 0.9
    wide_half_m: float = 3.0
    depth_m: float = 1.8

    def bearing(self, column: float) -> float:
        """Radians to starboard of a column, in pixels from the frame's middle."""
        return math.atan(column / self.focal_px)

    @property
    def half_view(self) -> float:
        """Radians from the middle of the frame to its edge."""
        return self.bearing(self.mask_width / 2)

    def ranges(self, distance_m: float | None) -> tuple[float, float]:
        """The least and the greatest distance an obstacle may have."""
        if distance_m is None:
            return self.near_m, self.far_m
        return distance_m * (1 - self.distance_error), distance_m * (1 + self.distance_error)


@dataclass(frozen=True)
class ObstacleSighting:
    """An obstacle as one verdict shows it, in metres of the manoeuvre's frame.

    Parameters
    ----------
    at : float
        How far along the vehicle was.
    edge : float
        How far it reaches to the side that is passed on, at most.
    end : float
        How far along it reaches, at most.
    places : tuple of (along, beside)
        Where its centre may be: at the least and at the greatest distance.
    """

    at: float
    edge: float
    end: float
    places: tuple[tuple[float, float], ...]


@dataclass
class Manoeuvre:
    """One manoeuvre past an obstacle, or several that are seen together.

    Parameters
    ----------
    origin : (3,) float64
        Where the vehicle was when it began.
    heading : float
        Of the frame, radians.
    look : float
        The vehicle's heading then, which it keeps: the heading of the frame, if that is body-fixed.
    side : {-1, 1}
        Passed on: port or starboard.
    hold_along : float
        Where along the vehicle goes sideways.
    retreat, retreat_beside : float or None, float
        Where to back off to.
    nearest : float
        The farthest along at which it had to back off.
    settled : int
        Verdicts since something new was seen.
    absent : int
        Clear verdicts in a row that should not be, if what was seen is there.
    glance : (position, heading) or None
        Past the obstacle: where it stops to look whether the way back is free, and which way.
    glances : int
        Clear verdicts in that direction.
    """

    origin: F64
    heading: float
    look: float
    side: int
    camera: CameraAssumptions
    hold_along: float = 0.0
    retreat: float | None = None
    retreat_beside: float = 0.0
    nearest: float = -math.inf
    settled: int = 0
    absent: int = 0
    glance: tuple[F64, float] | None = None
    glances: int = 0
    seen: list[ObstacleSighting] = field(default_factory=list)

    def place(self, position: F64) -> tuple[float, float]:
        """(along, beside) of a place in the world."""
        east, _, north = position - self.origin
        sine, cosine = math.sin(self.heading), math.cos(self.heading)
        return north * cosine + east * sine, self.side * (east * cosine - north * sine)

    def world(self, along: float, beside: float, depth: float) -> F64:
        """(3,) The place in the world, at a depth (the world's y)."""
        sine, cosine = math.sin(self.heading), math.cos(self.heading)
        right = self.side * beside
        east = self.origin[0] + along * sine + right * cosine
        north = self.origin[2] + along * cosine - right * sine
        return np.array([east, depth, north])

    def see(self, datagram: Mapping[str, Any], nav: State, wide: bool) -> None:
        """Remember what a verdict of status 1 says, from where the vehicle is."""
        camera = self.camera
        own = self.place(nav.position)
        turned = turn(nav.heading_rad - self.look)
        ranges = camera.ranges(datagram.get("distance_m"))
        centre = turned + camera.bearing(-(datagram["x"] or 0))
        places = tuple(self._spot(own, turned, centre, far) for far in ranges)
        half = camera.wide_half_m if wide else camera.half_m
        edge = max(beside for _, beside in places) + half
        box = datagram.get("box")
        if box is not None:
            column = box[0] + (box[2] if self.side > 0 else 0) - camera.mask_width / 2
            rim = turned + camera.bearing(column)
            edge = max(edge, *(self._spot(own, turned, rim, far)[1] for far in ranges))
        end = max(along for along, _ in places) + camera.depth_m
        before = self.edge(own[0])
        self.seen.append(ObstacleSighting(own[0], edge, end, places))
        self.absent = self.glances = 0
        self.glance = None
        # A tenth of a metre more is noise of the mask's centre, not another obstacle.
        self.settled = 0 if self.edge(own[0]) > before + 0.1 else self.settled + 1

    def clear(self, nav: State, within: float) -> None:
        """Count a clear verdict: in a glance, or where what was seen should be in view.

        Parameters
        ----------
        nav : State
        within : float
            Radians from the middle of the view.
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

    def back_off(self, nav: State, least_m: float, most_m: float) -> None:
        """Go straight back: `least_m` from here, and on while this is asked for.

        Parameters
        ----------
        nav : State
        least_m, most_m : float
            `most_m` is counted from where it was nearest.
        """
        along, beside = self.place(nav.position)
        self.nearest = max(self.nearest, along)
        wanted = max(self.nearest - least_m, self.nearest - most_m)
        if self.retreat is None:
            self.retreat_beside = beside
        else:
            wanted = max(min(self.retreat, along - BACK_ON_M), self.nearest - most_m)
        self.retreat = wanted if wanted < along else self.retreat

    def edge(self, along: float) -> float:
        """How far what is remembered and not yet behind reaches to the side passed on."""
        return max((one.edge for one in self.seen if one.end > along), default=-math.inf)

    def end(self) -> float:
        """How far along what is remembered reaches."""
        return max(one.end for one in self.seen)

    def _spot(
        self, own: tuple[float, float], turned: float, bearing: float, far: float
    ) -> tuple[float, float]:
        along, beside = self._camera(own, turned)
        return along + far * math.cos(bearing), beside + self.side * far * math.sin(bearing)

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
