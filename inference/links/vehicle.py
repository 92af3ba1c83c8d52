"""The vehicle's state: depth, heading, position and attitude, as long as they are fresh."""

import threading
from dataclasses import dataclass

from tokt.inference.clock import Clock

PLACE_S = 2.0
"""Seconds after which a figure is old: a stale place is no place."""


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


_FIGURES = {
    "depth_m": (-10.0, 12_000.0, 2),
    "heading_deg": (0.0, 360.0, 1),
    "lat_deg": (-90.0, 90.0, 7),
    "lon_deg": (-180.0, 180.0, 7),
    "roll_deg": (-180.0, 180.0, 1),
    "pitch_deg": (-90.0, 90.0, 1),
    "vehicle_t": (1e9, 1e11, 3),  # a clock that was never set counts from 1970
}
"""Their ranges, and the digits that are kept; the place's age is that of the first four."""


class VehicleState:
    """Keep what was last said of the vehicle; for any thread."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._known: dict[str, tuple[float, float, int]] = {}  # value, when it was said, rank

    def put(self, rank: int = 0, **figures: float) -> None:
        """Take figures of one message in: all of them or, where one is out of range, none.

        They have the names that `VehiclePlace` has. A fresh figure of a smaller rank stays.
        """
        # NaN is in no range.
        if not all(_FIGURES[name][0] <= it <= _FIGURES[name][1] for name, it in figures.items()):
            return
        now = self._clock.monotonic()
        with self._lock:
            for name, value in figures.items():
                _, at, other = self._known.get(name, (value, now, rank))
                if rank <= other or now - at > PLACE_S:
                    self._known[name] = value, now, rank

    def place(self) -> VehiclePlace:
        """What is known now and not old."""
        now = self._clock.monotonic()
        with self._lock:
            known = {name: (value, now - at) for name, (value, at, _) in self._known.items()}
        fresh = {name: it for name, it in known.items() if it[1] <= PLACE_S}
        # Adding 0.0 takes the sign of -0.0 away.
        told = {name: round(it[0], _FIGURES[name][2]) + 0.0 for name, it in fresh.items()}
        if "heading_deg" in told:
            told["heading_deg"] %= 360
        if "vehicle_t" in told:
            told["vehicle_t"] += fresh["vehicle_t"][1]
        ages = [fresh[name][1] for name in list(_FIGURES)[:4] if name in fresh]
        return VehiclePlace(**told, age_ms=round(1000 * max(ages), 1) if ages else None)
