"""MAVLink: verdicts as the distances that ArduPilot and other autopilots read.

What each message means, and what autopilots make of it, is in docs/mavlink.md. Unknown is kept
apart from clear in the way the autopilot at the other end can tell them apart: ArduPilot takes a
message full of "unknown" for a healthy sensor that sees nothing, and only silence for a sensor
that gives no data. Hence nothing but heartbeats is sent for an unknown verdict, unless asked for.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import StrEnum
from types import ModuleType

from tokt.features.common.address import parse_address
from tokt.features.common.errors import ToktError
from tokt.inference.clock import Clock
from tokt.inference.reason import Reason
from tokt.inference.report import Report
from tokt.inference.stereo.lens import SECTOR_DEG, Lens
from tokt.inference.verdict import UNKNOWN

from .ranges import NEAREST_CM, NOTHING_KNOWN, Ranges, ranges_of
from .udp import DatagramSocket

HEARTBEAT_S = 1.0
ASSUMED_M = 1.0
"""Metres that are said where none were measured. Set here: inside any margin an autopilot keeps."""
SYSTEM, COMPONENT = 1, 196
"""Those of a part of the vehicle itself (autopilots are 1, too) that is there for obstacle
avoidance (MAV_COMP_ID_OBSTACLE_AVOIDANCE)."""

_VARIANCE_UNKNOWN = 255
_QUALITY_UNKNOWN = 0
_DEVICE = re.compile(r"udpout:(.+)")


class Messages(StrEnum):
    """The MAVLink messages that carry the distances."""

    BOTH = "both"
    OBSTACLE_DISTANCE = "obstacle_distance"
    DISTANCE_SENSOR = "distance_sensor"


class WhenUnknown(StrEnum):
    """Choices of what is sent for an unknown verdict, besides the heartbeat."""

    SILENCE = "silence"
    MESSAGE = "message"
    """OBSTACLE_DISTANCE with every sector unknown: for PX4, not for ArduPilot."""


@dataclass(frozen=True)
class MavlinkOptions:
    """Settings by which verdicts become distances, and the MAVLink ids of their sender.

    Parameters
    ----------
    lens : Lens
        Of the left camera, in water.
    assumed_m : float
        Metres to an obstacle whose distance nothing measured, and up to which a clear holds that
        no stereo detector gave.
    system, component : int
        MAVLink's numbers of the sender.
    messages : Messages
    unknown : WhenUnknown

    Raises
    ------
    ToktError
        If a number is not one MAVLink has, or the distance is not 0.1 to 100 m.
    """

    lens: Lens
    assumed_m: float = ASSUMED_M
    system: int = SYSTEM
    component: int = COMPONENT
    messages: Messages = Messages.BOTH
    unknown: WhenUnknown = WhenUnknown.SILENCE

    def __post_init__(self) -> None:
        if not 0.1 <= self.assumed_m <= 100:
            raise ToktError(f"an assumed distance is 0.1 to 100 m, not {self.assumed_m:g}")
        for name, number in (("system", self.system), ("component", self.component)):
            if not 1 <= number <= 255:
                raise ToktError(f"a MAVLink {name} is numbered 1 to 255, not {number}")


def parse_device(text: str) -> tuple[str, int]:
    """Read ``udpout:HOST:PORT``, as pymavlink and MAVProxy write a UDP address to send to.

    Raises
    ------
    ToktError
        If it is something else; another kind of link needs a router such as mavlink-router.
    """
    match = _DEVICE.fullmatch(text.strip())
    if match is None:
        raise ToktError(
            f"not a MAVLink address: {text!r} (write udpout:HOST:PORT; what speaks MAVLink over "
            "another link is reached through a MAVLink router)"
        )
    return parse_address(match[1])


def _dialect() -> ModuleType:
    """MAVLink's common messages, in version 2's framing."""
    try:
        from pymavlink.dialects.v20 import common
    except ImportError:
        raise ToktError("MAVLink needs the extra 'mavlink': pip install 'tokt[mavlink]'") from None
    dialect: ModuleType = common
    return dialect


class MavlinkSender(DatagramSocket):
    """Send verdicts as MAVLink messages to one address, one message a datagram.

    A heartbeat goes out with the first report a second after the one before. It is no thread's
    own: a loop that says nothing any more has no heartbeat either.

    Parameters
    ----------
    host, port
        As of `DatagramSocket`.
    options : MavlinkOptions
    clock : Clock
        Its `monotonic` stamps the messages, as time since boot; what day it is does not matter.

    Attributes
    ----------
    unsaid : int
        Unknown verdicts that were told by silence.

    Raises
    ------
    ToktError
        If the host name is not known, or pymavlink is not installed.
    """

    def __init__(self, host: str, port: int, options: MavlinkOptions, clock: Clock) -> None:
        self._words = _dialect()
        super().__init__(host, port)
        self.options = options
        self.unsaid = 0
        self._clock = clock
        self._heartbeat_due = -math.inf
        self._stamp_us = 0
        # It numbers and frames what it is given, and writes that to this socket.
        self._link = self._words.MAVLink(self, options.system, options.component)

    def send(self, report: Report) -> None:
        """Send what a report comes to in distances, and a heartbeat when one is due."""
        now = self._clock.monotonic()
        if now >= self._heartbeat_due:
            self._heartbeat_due = now + HEARTBEAT_S
            self._send_heartbeat(report)
        taken = max(now - _age_s(report), 0.0)
        self._stamp_us = max(self._stamp_us, int(1e6 * taken))
        ranges = ranges_of(report.verdict, self.options.lens, self.options.assumed_m)
        if ranges is None:
            self._tell_unknown()
            return
        # This order: ArduPilot keeps what the last of the two said of the sectors ahead.
        if self.options.messages is not Messages.OBSTACLE_DISTANCE:
            self._send_distance(ranges, report.verdict.mask_size)
        if self.options.messages is not Messages.DISTANCE_SENSOR:
            self._send_sectors(ranges.sectors, ranges.most)

    def _send_heartbeat(self, report: Report) -> None:
        words = self._words
        state = words.MAV_STATE_ACTIVE
        if report.verdict.status == UNKNOWN:
            starting = report.verdict.reason is Reason.NO_FRAME
            state = words.MAV_STATE_BOOT if starting else words.MAV_STATE_CRITICAL
        kind, none = words.MAV_TYPE_ONBOARD_CONTROLLER, words.MAV_AUTOPILOT_INVALID
        self._link.heartbeat_send(kind, none, 0, 0, state)

    def _tell_unknown(self) -> None:
        by_message = self.options.unknown is WhenUnknown.MESSAGE
        # DISTANCE_SENSOR is never sent: its quality "invalid" is read by no one but rangefinders.
        if by_message and self.options.messages is not Messages.DISTANCE_SENSOR:
            self._send_sectors(NOTHING_KNOWN, NEAREST_CM + 1)
        else:
            self.unsaid += 1

    def _send_sectors(self, sectors: tuple[int, ...], most_cm: int) -> None:
        words = self._words
        self._link.obstacle_distance_send(
            self._stamp_us,
            words.MAV_DISTANCE_SENSOR_UNKNOWN,
            sectors,
            int(SECTOR_DEG),
            NEAREST_CM,
            most_cm,
            increment_f=SECTOR_DEG,
            angle_offset=0.0,
            frame=words.MAV_FRAME_BODY_FRD,
        )

    def _send_distance(self, ranges: Ranges, mask_size: tuple[int, int] | None) -> None:
        words, lens = self._words, self.options.lens
        height_deg = 0.0 if mask_size is None else lens.fov_deg(mask_size[0] / mask_size[1])
        self._link.distance_sensor_send(
            self._stamp_us // 1000 % 2**32,
            NEAREST_CM,
            ranges.most,
            ranges.nearest,
            words.MAV_DISTANCE_SENSOR_UNKNOWN,
            0,
            words.MAV_SENSOR_ROTATION_NONE,
            _VARIANCE_UNKNOWN,
            horizontal_fov=math.radians(lens.fov_deg()),
            vertical_fov=math.radians(height_deg),
            signal_quality=_QUALITY_UNKNOWN,
        )


def _age_s(report: Report) -> float:
    """Seconds since the frame arrived, where that is known."""
    age_ms = report.age_ms
    return age_ms / 1000 if age_ms is not None and math.isfinite(age_ms) and age_ms > 0 else 0.0
