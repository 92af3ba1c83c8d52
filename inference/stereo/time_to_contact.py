r"""Closing speed and time to contact from the distances of the last seconds.

::

    distance          .     the slope is the median of the slopes between all pairs of points
       |  o            .    of the last seconds (Theil-Sen): a quarter of them may be wrong
       |     o  o       .
       |           o  *     a point off the line waits: it is dropped when the next ones are on
       |              o     the line again, and starts a new line when they are off like itself
       +------------------ time
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

WINDOW_S = 2.0
"""Seconds of distances that a line is fitted to. With the sea trial's jitter of distance, 0.03 m,
and 10 pairs a second the speed then has an error of 0.012 m/s (0.03 after `MIN_SPAN_S`), and it
is that of one second ago."""
MAX_POINTS = 40
"""Of more points in the window the oldest are left out: the slopes of 40 take 0.1 ms."""
MIN_POINTS = 5
MIN_SPAN_S = 1.0
"""Fewest points, and least seconds from the first to the last, that give a speed."""
GAP_S = 1.0
"""After so long without a distance it is another thing that is seen: the line starts anew."""
FASTEST_M_S = 3.0
"""No thing's distance changes faster. Source: twice the speed of a work-class ROV."""
JUMP_M = 0.3
"""Beside `FASTEST_M_S`, a distance may differ by this much from the last: ten times the jitter."""
MIN_CLOSING_M_S = 0.05
"""Slower is taken for standing still: no contact. Source: the speed's error, above."""


class Closing(NamedTuple):
    """Closing speed and time to contact, as far as the last distances tell.

    Parameters
    ----------
    closing_m_s : float or None
        Metres per second by which the distance shrinks, negative while it grows; None unknown.
    contact_s : float or None
        Seconds until the distance is 0 at that speed; None unless it shrinks.
    """

    closing_m_s: float | None = None
    contact_s: float | None = None


class ClosingSpeed:
    """Follow one distance over time.

    Notes
    -----
    Times need not be regular. A time that is not later than the last one, or is no number, starts
    anew, as a clock that was set does. Memory is at most `MAX_POINTS` points.
    """

    def __init__(self) -> None:
        self._points: deque[tuple[float, float]] = deque(maxlen=MAX_POINTS)
        self._waiting: list[tuple[float, float]] = []
        self._last_s = -math.inf

    def add(self, t_s: float, distance_m: float | None) -> Closing:
        """Take the distance at one moment.

        Parameters
        ----------
        t_s : float
            Moment of capture in seconds, of any clock that goes evenly.
        distance_m : float or None
            None where nothing was seen or measured. A gap shorter than `GAP_S` leaves the
            distances before it standing, and gives no speed itself.

        Returns
        -------
        Closing
        """
        if not self._last_s < t_s < math.inf:
            self._start_anew()
        self._last_s = t_s if math.isfinite(t_s) else -math.inf
        if distance_m is None or not math.isfinite(t_s) or not 0 <= distance_m < math.inf:
            return Closing()
        self._take((t_s, distance_m))
        return Closing() if self._waiting else self._fitted(t_s)

    def _start_anew(self) -> None:
        self._points.clear()
        self._waiting.clear()

    def _take(self, point: tuple[float, float]) -> None:
        """Add a point to the line, or keep it waiting where it is off the line."""
        newest = self._waiting or self._points
        if newest and point[0] - newest[-1][0] > GAP_S:
            self._start_anew()
        if not self._points or _continues(self._points[-1], point):
            self._waiting.clear()
            self._points.append(point)
        elif self._waiting and _continues(self._waiting[-1], point):
            # Two alike: what is seen has changed.
            self._points.clear()
            self._points.extend((*self._waiting, point))
            self._waiting.clear()
        else:
            self._waiting[:] = [point]
        while self._points and point[0] - self._points[0][0] > WINDOW_S:
            self._points.popleft()

    def _fitted(self, t_s: float) -> Closing:
        """Speed and time to contact from the points of the window."""
        points = np.array(self._points)
        if len(points) < MIN_POINTS or points[-1, 0] - points[0, 0] < MIN_SPAN_S:
            return Closing()
        slope, distance_m = _line(points[:, 0] - t_s, points[:, 1])
        closing = -slope
        if closing < MIN_CLOSING_M_S:
            return Closing(closing)
        return Closing(closing, max(distance_m, 0.0) / closing)


def _continues(old: tuple[float, float], new: tuple[float, float]) -> bool:
    """Whether one thing can have been at both distances."""
    return abs(new[1] - old[1]) <= JUMP_M + FASTEST_M_S * (new[0] - old[0])


def _line(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Slope and value at 0 of the line through points, by Theil and Sen."""
    first, second = np.triu_indices(len(x), 1)
    slope = float(np.median((y[second] - y[first]) / (x[second] - x[first])))
    return slope, float(np.median(y - slope * x))
