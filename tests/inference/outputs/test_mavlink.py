"""What is sent is decoded by pymavlink from a real socket, and read as an autopilot reads it."""

import math
import socket
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.calls import refuses, succeeds
from tests.inference.conftest import HandClock
from tests.inference.live import BROADCAST, refuse
from tests.tiers import scaled
from tokt.inference.clock import Clock
from tokt.inference.config import OutputConfig
from tokt.inference.links.datagrams import UdpLink
from tokt.inference.links.vehicle import VehicleState
from tokt.inference.outputs.mavlink import MavlinkSender, check_mavlink, lens_of, ranges_of
from tokt.inference.outputs.pilot_words import ENDED
from tokt.inference.reason import Fault, Reason
from tokt.inference.report import Report
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.verdict import Verdict, unknown_verdict, verdict_from_mask

common = pytest.importorskip("pymavlink.dialects.v20.common")

UNKNOWN = 65535
WORDS = ("STATUSTEXT", "NAMED_VALUE_FLOAT")
LENS = lens_of(60, None)
DARK = unknown_verdict(Fault(Reason.DARK, "left: too dark"))
LEFT, AHEAD, RIGHT = slice(0, 60), slice(150, 210), slice(300, 360)


def seen(columns, method="texture", distance_m=None) -> Verdict:
    """The verdict on a 360x271 mask that is white in these columns."""
    mask = np.zeros((271, 360), np.uint8)
    if columns is not None:
        mask[100:150, columns] = 255
    return verdict_from_mask(mask, method, None, distance_m)


def sender_over(link, clock, vehicle=None, tell=lambda event: None, lens=LENS, **options):
    """A sender with these of MAVLink's options."""
    wanted = OutputConfig(**{f"mavlink_{name}": value for name, value in options.items()})
    return MavlinkSender(link, lens, wanted, clock, vehicle or VehicleState(clock), tell)


class Link:
    """A sender, and an autopilot's end of its line."""

    def __init__(self, receiver: socket.socket, clock: Clock, **options: Any) -> None:
        self.receiver = receiver
        # What the last report sends ends with a datagram of this one, on the same way.
        self.marker = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sender = sender_over(UdpLink(*receiver.getsockname()), clock, **options)
        self.parser = common.MAVLink(None)
        self.seq = 0

    def says(self, verdict: Verdict, age_ms: float | None = None) -> dict[str, Any]:
        """The messages of distances that a verdict comes to, by name."""
        self.seq += 1
        self.sender.send(Report(self.seq, self.seq, 0.0, 1.0, verdict, age_ms))
        self.marker.sendto(b"end", self.receiver.getsockname())
        found = {}
        while (data := self.receiver.recv(4096)) != b"end":
            (message,) = self.parser.parse_buffer(data)
            if message.get_type() in WORDS:  # tests/inference/outputs/test_pilot_words.py
                continue
            assert message.get_type() not in found
            found[message.get_type()] = message
        return found

    def sectors(self, verdict: Verdict) -> list[int]:
        return self.says(verdict)["OBSTACLE_DISTANCE"].distances


@pytest.fixture
def link(receiver, hand_clock):
    opened: list[Link] = []

    def open_link(**options: Any) -> Link:
        opened.append(Link(receiver, hand_clock, **options))
        return opened[-1]

    yield open_link
    for one in opened:
        one.sender.close()
        one.marker.close()


def ahead_of(sectors: list[int], first_deg: int, last_deg: int) -> list[int]:
    """The sectors from one angle to another, from left to right."""
    return [sectors[deg // 5 % 72] for deg in range(first_deg, last_deg + 1, 5)]


def as_ardupilot(sectors: list[int], least: int, most: int) -> dict[int, float]:
    """Written from AP_Proximity_MAV's rules: the nearest distance of each face of 45 degrees."""
    faces: dict[int, float] = {}
    for index, distance in enumerate(sectors):
        if distance in (0, UNKNOWN) or not least <= distance <= most:
            continue
        face = int((index * 5 + 22.5) % 360 // 45)
        faces[face] = min(faces.get(face, math.inf), distance / 100)
    return faces


def test_what_is_left_in_the_picture_is_left_of_the_vehicle(link):
    wire = link()
    left, right = seen(LEFT), seen(RIGHT)
    assert left.x > 0  # v1 and v2: steer to the right
    at_left, at_right = wire.sectors(left), wire.sectors(right)
    assert ahead_of(at_left, -30, -20) == [99, 99, 99]
    assert ahead_of(at_right, 20, 30) == [99, 99, 99]
    assert at_left.count(UNKNOWN) == at_right.count(UNKNOWN) == 69
    assert at_left == [at_right[-index % 72] for index in range(72)]
    # Index 71 is 5 degrees to the left, by MAVLink: clockwise from ahead.
    assert ahead_of(wire.sectors(seen(AHEAD)), -10, 10) == [UNKNOWN, 99, 99, 99, UNKNOWN]


def test_sectors_are_of_the_body_and_five_degrees_wide(link):
    message = link().says(seen(AHEAD))["OBSTACLE_DISTANCE"]
    assert (message.frame, message.increment, message.increment_f) == (12, 5, 5.0)
    assert (message.angle_offset, message.min_distance) == (0.0, 1)
    assert message.get_srcSystem() == 1 and message.get_srcComponent() == 196


@pytest.mark.parametrize(
    ("method", "most"),
    [("disparity", 1060), ("texture+disparity", 1060), ("pushbroom", 800), ("texture", 100)],
)
def test_clear_reaches_as_far_as_was_measured(link, method, most):
    said = link().says(seen(None, method))
    sectors = said["OBSTACLE_DISTANCE"]
    assert sectors.max_distance == most
    # Of a view of 60 degrees the sectors from -25 to 25 lie wholly in it.
    assert ahead_of(sectors.distances, -25, 25) == [most + 1] * 11
    assert sectors.distances.count(UNKNOWN) == 61
    ahead = said["DISTANCE_SENSOR"]
    assert (ahead.current_distance, ahead.max_distance) == (most + 1, most)


def test_a_measured_obstacle_is_at_its_distance(link):
    said = link().says(seen(LEFT, "disparity", 4.567))
    sectors = said["OBSTACLE_DISTANCE"]
    assert ahead_of(sectors.distances, -30, -20) == [456, 456, 456]
    assert sectors.distances.count(UNKNOWN) == 69
    ahead = said["DISTANCE_SENSOR"]
    assert (ahead.min_distance, ahead.current_distance, ahead.max_distance) == (1, 456, 1060)
    assert (ahead.orientation, ahead.covariance, ahead.signal_quality) == (0, 255, 0)
    assert ahead.horizontal_fov == pytest.approx(math.radians(60))
    assert ahead.vertical_fov == pytest.approx(2 * math.atan(271 / 360 * math.tan(math.pi / 6)))


def test_an_obstacle_without_a_distance_is_at_the_assumed_one(link):
    for options, assumed in (({}, 99), ({"assumed_m": 2.5}, 249)):
        said = link(**options).says(seen(AHEAD))
        assert said["DISTANCE_SENSOR"].current_distance == assumed
        assert ahead_of(said["OBSTACLE_DISTANCE"].distances, -5, 5) == [assumed] * 3


def test_a_box_of_an_unknown_picture_is_anywhere_in_view(link):
    verdict = Verdict(1, 5, 5, (0, 0, 10, 10), 9.0, 3.0, "disparity", None)
    sectors = link().sectors(verdict)
    assert ahead_of(sectors, -30, 30) == [300] * 13 and sectors.count(UNKNOWN) == 59


def test_unknown_is_silence_and_a_heartbeat(link, hand_clock):
    wire = link()
    first = wire.says(DARK)
    assert list(first) == ["HEARTBEAT"]
    assert first["HEARTBEAT"].system_status == common.MAV_STATE_CRITICAL
    hand_clock.sleep(0.5)
    assert wire.says(DARK) == {}


def test_unknown_as_a_message_is_unknown_everywhere(link):
    said = link(unknown="message").says(DARK)
    assert set(said) == {"HEARTBEAT", "OBSTACLE_DISTANCE"}
    assert set(said["OBSTACLE_DISTANCE"].distances) == {UNKNOWN}


def test_the_messages_can_be_chosen(link):
    for messages in ("obstacle_distance", "distance_sensor"):
        assert set(link(messages=messages).says(seen(None))) == {"HEARTBEAT", messages.upper()}
    alone = link(messages="distance_sensor", unknown="message")
    assert set(alone.says(DARK)) == {"HEARTBEAT"}


def test_the_heartbeat_comes_once_a_second_and_tells_the_state(link, hand_clock):
    wire = link(system=7, component=191)
    states = []
    silent = unknown_verdict(Fault(Reason.NO_FRAME, "no frame has come yet"))
    for verdict in (silent, *[seen(None)] * 10, DARK):
        beat = wire.says(verdict).get("HEARTBEAT")
        states.append(None if beat is None else beat.system_status)
        hand_clock.sleep(0.25)
    none = [None] * 3
    boot, active = common.MAV_STATE_BOOT, common.MAV_STATE_ACTIVE
    assert states == [boot, *none, active, *none, active, *none]
    hand_clock.sleep(1.0)
    beat = wire.says(DARK)["HEARTBEAT"]
    assert (beat.type, beat.autopilot) == (18, 8)
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (7, 191)


def test_times_count_from_boot_and_never_step_back(link, hand_clock):
    wire = link()
    said = wire.says(seen(None), 40.0)
    assert said["OBSTACLE_DISTANCE"].time_usec == 99_960_000
    assert said["DISTANCE_SENSOR"].time_boot_ms == 99_960
    hand_clock.sleep(0.1)
    assert wire.says(seen(None), 300.0)["OBSTACLE_DISTANCE"].time_usec == 99_960_000
    assert wire.says(seen(None), math.nan)["OBSTACLE_DISTANCE"].time_usec == 100_100_000
    hand_clock.now = 2**32 / 1000 + 5
    assert wire.says(seen(None))["DISTANCE_SENSOR"].time_boot_ms == 5000


def test_messages_are_numbered_for_the_receiver(link):
    wire = link()
    numbers = [message.get_seq() for _ in range(2) for message in wire.says(seen(None)).values()]
    # After the first three: three figures and a line of words.
    assert numbers == [0, 1, 2, 7, 8]


class Kept:
    """A link that keeps what is written."""

    whole, gaps, full, data = True, 0, frozenset(), b""

    def listen(self, heard): ...

    def write(self, data):
        self.data += data


anything = st.floats(allow_nan=True, allow_infinity=True) | st.floats(0, 20)
verdicts = st.builds(
    Verdict,
    status=st.sampled_from([-1, 0, 1]),
    x=st.none() | st.integers(-180, 180),
    y=st.none() | st.integers(-180, 180),
    box=st.none()
    | st.tuples(st.integers(0, 359), st.integers(0, 270), st.integers(1, 360), st.integers(1, 271)),
    mean=st.none() | anything,
    distance_m=st.none() | anything,
    method=st.sampled_from(["texture", "disparity", "pushbroom", "texture+disparity", "none"]),
    model=st.none(),
    mask_size=st.none() | st.just((271, 360)),
)


@settings(max_examples=scaled(80))
@example(Verdict(-1, None, None, None, None, None, "texture", None), 1e306, "silence", 1.0, 60.0)
@given(
    verdicts,
    anything,
    st.sampled_from(["silence", "message"]),
    st.floats(0.1, 100),
    st.floats(10, 170),
)
def test_unknown_is_never_no_obstacle_and_an_obstacle_always_one(
    verdict, age_ms, unknown, assumed_m, fov_deg
):
    link, options = Kept(), {"assumed_m": assumed_m, "unknown": unknown}
    sender = sender_over(link, HandClock(), lens=lens_of(fov_deg, None), **options)
    sender.send(Report(1, 1, 0.0, 1.0, verdict, age_ms))
    said = {message.get_type(): message for message in common.MAVLink(None).parse_buffer(link.data)}
    sectors, ahead = said.get("OBSTACLE_DISTANCE"), said.get("DISTANCE_SENSOR")
    if verdict.status == -1:
        assert ahead is None
        assert sectors is None or set(sectors.distances) == {UNKNOWN}
        return
    faces = as_ardupilot(sectors.distances, sectors.min_distance, sectors.max_distance)
    known = set(sectors.distances) - {UNKNOWN}
    if verdict.status == 0:
        assert known == {sectors.max_distance + 1} and faces == {}
        assert ahead.current_distance == ahead.max_distance + 1
    else:
        (distance,) = known
        assert 1 <= sectors.min_distance <= distance < sectors.max_distance
        assert ahead.current_distance == distance and ahead.max_distance == sectors.max_distance
        assert faces and set(faces.values()) == {distance / 100}


@given(st.integers(0, 359), st.integers(1, 360), st.floats(10, 170))
def test_an_obstacle_s_sectors_hold_all_of_its_box(x0, width, fov_deg):
    lens = lens_of(fov_deg, None)
    verdict = Verdict(1, 0, 0, (x0, 0, width, 9), 9.0, 3.0, "disparity", None, mask_size=(271, 360))
    ranges = ranges_of(verdict, lens, 1.0)
    for column in np.linspace(x0, x0 + width, 7) / 360:
        assert ranges.sectors[round(lens.angle_deg(float(column)) / 5) % 72] == 300


def test_the_lens_of_a_calibration_is_its_left_camera_s():
    K = np.array([[1000.0, 0, 599.5], [0, 1000, 500], [0, 0, 1]])
    other, straight = np.diag([9.0, 9.0, 1.0]), np.zeros(5)
    calibration = StereoCalibration(
        K, straight, other, straight, np.eye(3), np.array([[-300.0], [0], [0]]), (1360, 1024)
    )
    lens = lens_of(None, calibration)
    assert lens.edges_deg == pytest.approx(np.degrees(np.arctan([-0.6, 0.76])))
    assert lens_of(60, calibration) == LENS
    assert LENS.edges_deg == pytest.approx((-30, 30))
    refuses("--camera-fov-deg", lens_of, None, None)


def test_angles_of_view_and_options_that_are_none():
    for fov_deg in (0, 9.9, 171, -60, math.nan):
        refuses("field of view", lens_of, fov_deg, None)
    for words, name, value in (
        *(("assumed distance", "assumed_m", metres) for metres in (0.0, 101, math.nan)),
        ("--mavlink-system is 1 to 255", "system", 0),
        ("--mavlink-component is 1 to 255", "component", 256),
        ("--mavlink-component 1 is the autopilot", "component", 1),
        ("--mavlink-words-component is 1 to 255", "words_component", 0),
        ("--mavlink-messages is both or ", "messages", "all"),
        ("--mavlink-unknown is silence or message", "unknown", ""),
    ):
        refuses(words, check_mavlink, OutputConfig(**{f"mavlink_{name}": value}))


def test_a_receiver_that_is_not_there_costs_nothing(closed_port):
    clock = HandClock()
    sender = sender_over(UdpLink("127.0.0.1", closed_port), clock)
    broadcast = UdpLink(BROADCAST, 9)
    refused = sender_over(broadcast, clock)
    refuse(broadcast)
    for _ in range(10):
        sender.send(Report(1, 1, 0.0, 1.0, seen(AHEAD)))
        refused.send(Report(1, 1, 0.0, 1.0, seen(AHEAD)))
    # A heartbeat, three figures, a line of words, and ten times two.
    assert sender.sent + sender.failed == 25 and clock.slept == []
    assert (refused.sent, refused.failed) == (0, 25) and refused.last_error
    sender.close()
    refused.close()


def test_without_pymavlink_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20.common", None)
    refuses("MAVLink needs the extra 'mavlink'", sender_over, None, HandClock())


def test_the_command_sends_what_the_frames_show(make_mission, bundle_file, receiver, closed_port):
    folder = make_mission([[(4, 0)], [(4, 9)], []])  # something left, something right, water
    succeeds(
        *("run", "--bundle", bundle_file, "--source", folder, "--policy", "texture"),
        *("--udp", f"127.0.0.1:{closed_port}", "--camera-fov-deg", "60"),
        *("--mavlink", f"udpout:127.0.0.1:{receiver.getsockname()[1]}"),
        *("--mavlink-messages", "obstacle_distance", "--mavlink-assumed-m", "2"),
    )
    parser, said = common.MAVLink(None), []
    while not said or getattr(said[-1], "text", "") != ENDED:
        said += parser.parse_buffer(receiver.recv(4096))
    beat, left, right, water = (one for one in said if one.get_type() not in WORDS)
    assert beat.get_type() == "HEARTBEAT"
    # Whether more is told hangs on how long the run takes.
    assert "tokt: obstacle on the left" in {getattr(one, "text", "") for one in said}
    assert ahead_of(left.distances, -30, 30) == [199] * 2 + [UNKNOWN] * 11
    assert ahead_of(right.distances, -30, 30) == [UNKNOWN] * 11 + [199] * 2
    assert ahead_of(water.distances, -25, 25) == [201] * 11
