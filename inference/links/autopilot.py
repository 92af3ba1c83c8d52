"""MAVLink that is heard: the vehicle's place from its autopilot, and who else speaks."""

import math
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from types import ModuleType
from typing import Any

from tokt.features.common.errors import ToktError

from .datagrams import NOBODY, OTHER, OWN, PEER_S
from .vehicle import AUTOPILOT_RANK, VehicleState

AUTOPILOT = 1
"""The component (MAV_COMP_ID_AUTOPILOT1) that is believed."""
_STATION = 6  # its type of vehicle (MAV_TYPE_GCS)


def mavlink_dialect() -> ModuleType:
    """MAVLink's common messages, in version 2's framing; ToktError without pymavlink."""
    try:
        return import_module("pymavlink.dialects.v20.common")
    except ImportError:
        wanted = "MAVLink needs the extra 'mavlink'"
        raise ToktError(wanted) from None


class MavlinkReader:
    """Read one link's messages, in pieces or, as datagrams, `whole`.

    The vehicle's state is told what component 1 of our own system says; `clashed` is called once,
    when somebody else with our own ids is heard. `met` grows with each station whose heartbeat is
    new: behind a router, which alone speaks on the link, one may begin to listen.
    """

    def __init__(
        self, ids: tuple[int, int], whole: bool, vehicle: VehicleState, clashed: Callable[[], None]
    ) -> None:
        self.met = 0
        self._own, self._autopilot = ids, (ids[0], AUTOPILOT)
        self._whole, self._vehicle = whole, vehicle
        self._clashed: Callable[[], None] | None = clashed
        self._beats: dict[tuple[int, int], float] = {}  # when they were heard last
        self._parser = mavlink_dialect().MAVLink(None)
        self._parser.robust_parsing = True

    def heard(self, data: bytes, sender: str = "") -> int:
        """Take a piece in; return the best of the senders of the messages that ended in it."""
        parser = self._parser
        messages = parser.parse_buffer(data) or []
        # What it has read it keeps, and a datagram's rest belongs to no other.
        del parser.buf[: len(parser.buf) if self._whole else parser.buf_index]
        parser.buf_index = 0
        # What is damaged or of another dialect, which no checksum tells apart, has no system.
        known = [message for message in messages if message.get_srcSystem()]
        for message in known:
            source = (message.get_srcSystem(), message.get_srcComponent())
            if message.get_type() == "HEARTBEAT" and message.type == _STATION:
                now = time.monotonic()
                self.met += now - self._beats.get(source, -math.inf) > PEER_S
                self._beats[source] = now
            if source == self._autopilot:
                self._take(message, sender)
            elif source == self._own and self._clashed is not None:
                self._clashed()
                self._clashed = None
        systems = {message.get_srcSystem() for message in known}
        return OWN if self._own[0] in systems else OTHER if systems else NOBODY

    def _take(self, message: Any, sender: str) -> None:
        """Keep its figures; NMEA's, which somebody asked for, have smaller ranks."""
        kind, put = message.get_type(), partial(self._vehicle.put, sender=sender)
        put(AUTOPILOT_RANK)  # it speaks, though it may not say where it is
        if kind == "GLOBAL_POSITION_INT":
            put(2, depth_m=-message.relative_alt / 1000)
            put(2, heading_deg=message.hdg / 100)  # 65535, unknown, is no heading
            if message.lat or message.lon:  # both are 0 without a position
                put(2, lat_deg=message.lat / 1e7, lon_deg=message.lon / 1e7)
        elif kind == "VFR_HUD":  # in metres above the sea, not the surface where the dive began
            put(3, depth_m=-message.alt)
            put(3, heading_deg=message.heading)
        elif kind == "ATTITUDE":
            roll_deg, pitch_deg = math.degrees(message.roll), math.degrees(message.pitch)
            put(2, roll_deg=roll_deg, pitch_deg=pitch_deg)
        elif kind == "SYSTEM_TIME":
            put(2, vehicle_t=message.time_unix_usec / 1e6)
