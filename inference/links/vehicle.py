"""The vehicle's state: depth, heading, position and attitude, as long as they are fresh."""

import math
import threading
from collections.abc import Hashable
from dataclasses import dataclass
from typing import NamedTuple

from tokt.inference.clock import Clock

PLACE_S = 2.0
"""Seconds after which a figure is old: a stale place is no place."""
DOUBT_S = 5.0
"""Seconds after the last contradiction that a place is doubtful."""
AUTOPILOT_RANK = 2
"""The smallest rank of an autopilot's figures."""


@dataclass(frozen=True)
class VehiclePlace:
    """Where the vehicle is; None for what is not known, or old."""

    depth_m: float | None = None  # below the surface
    heading_deg: float | None = None  # from north, clockwise
    lat_deg: float | None = None
    lon_deg: float | None = None
    age_ms: float | None = None  # of the oldest of these four
    roll_deg: float | None = None
    pitch_deg: float | None = None
    vehicle_t: float | None = None  # the vehicle's clock now: seconds since 1970 (UTC)
    doubt: str = ""  # who contradict each other, and so are left out above


_FIGURES = {
    "depth_m": (-10.0, 12_000.0, 2, 5.0),
    "heading_deg": (0.0, 360.0, 1, 45.0),
    "lat_deg": (-90.0, 90.0, 7, 5e-4),  # 56 m
    "lon_deg": (-180.0, 180.0, 7, 5e-4),
    "roll_deg": (-180.0, 180.0, 1, 45.0),
    "pitch_deg": (-90.0, 90.0, 1, 45.0),
    "vehicle_t": (1e9, 1e11, 3, 5.0),  # a clock that was never set counts from 1970
}
"""Their ranges, the digits that are kept, and how far apart two in `PLACE_S` are that agree. The
place's age is that of the first four."""
_STEADY = ("depth_m", "lat_deg", "lon_deg")
"""Those that no vehicle changes as fast, though one sender says both."""


class _Figure(NamedTuple):
    value: float = math.nan
    said_s: float = -math.inf
    role: Hashable = None  # whose it is


class _Speaker(NamedTuple):
    name: str
    since_s: float
    heard_s: float


class VehicleState:
    """Keep what was last said of the vehicle; for any thread.

    The autopilot is one sender, as is each sensor: the first one, for as long as it speaks. What
    another says in its place is not given and, where the two contradict each other, neither is.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._known: dict[tuple[str, int], _Figure] = {}  # by name and rank
        self._speakers: dict[Hashable, _Speaker] = {}  # by role
        self._doubts: dict[Hashable, tuple[float, str]] = {}  # by role: when, and why

    def put(self, rank: int = 0, sender: str = "", **figures: float) -> None:
        """Take figures of one message in: all of them or, where one is out of range, none.

        They have the names that `VehiclePlace` has. The fresh figure of the smallest rank is given.
        """
        # NaN is in no range.
        if not all(_FIGURES[name][0] <= it <= _FIGURES[name][1] for name, it in figures.items()):
            return
        now = self._clock.monotonic()
        role = AUTOPILOT_RANK if rank >= AUTOPILOT_RANK else (rank, *figures)
        with self._lock:
            first = self._speakers.get(role, _Speaker(sender, now, now))
            is_rival = sender != first.name and now - first.heard_s <= PLACE_S
            for name, value in figures.items():
                if self._contradicts((name, rank), value, first if is_rival else None, now):
                    pair = f"{first.name} and {sender} contradict each other"
                    words = pair if is_rival else f"{sender} contradicts itself"
                    self._doubts[role] = now, f"{words} ({name})"
                if not is_rival:
                    self._known[name, rank] = _Figure(value, now, role)
            if not is_rival:
                since_s = first.since_s if sender == first.name else now
                self._speakers[role] = _Speaker(sender, since_s, now)

    def _contradicts(
        self, key: tuple[str, int], value: float, first: _Speaker | None, now: float
    ) -> bool:
        """Compare a figure to the last one, of the same sender or of the `first` one."""
        name, known = key[0], self._known.get(key, _Figure())
        if (first.heard_s if first else now) - known.said_s > PLACE_S:
            # Another sender says a place that the first one does not say, who had the time to.
            return first is not None and name in _STEADY and now - first.since_s > PLACE_S
        apart = abs(value - known.value)
        if name.endswith("_deg"):
            apart = min(apart, 360 - apart)
        return (first is not None or name in _STEADY) and apart > _FIGURES[name][3]

    def place(self) -> VehiclePlace:
        """What is known now and not old."""
        now = self._clock.monotonic()
        with self._lock:
            known = dict(self._known)
            doubts = {
                role: words for role, (at, words) in self._doubts.items() if now - at <= DOUBT_S
            }
        fresh = {
            name: (figure.value, now - figure.said_s)
            for (name, _), figure in sorted(known.items(), key=lambda each: -each[0][1])
            if now - figure.said_s <= PLACE_S and figure.role not in doubts
        }
        # Adding 0.0 takes the sign of -0.0 away.
        told = {name: round(it[0], _FIGURES[name][2]) + 0.0 for name, it in fresh.items()}
        if "heading_deg" in told:
            told["heading_deg"] %= 360
        if "vehicle_t" in told:
            told["vehicle_t"] += fresh["vehicle_t"][1]
        ages = [fresh[name][1] for name in list(_FIGURES)[:4] if name in fresh]
        age_ms = round(1000 * max(ages), 1) if ages else None
        return VehiclePlace(**told, age_ms=age_ms, doubt="; ".join(doubts.values()))
