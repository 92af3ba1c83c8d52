"""An autopilot of pymavlink at the other end of real links: it is believed, and nobody else."""

import math
import os
from contextlib import contextmanager
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.inference.conftest import HandClock
from tests.inference.live import bound_socket
from tests.inference.outputs.test_mavlink import AHEAD, seen, sender_over
from tests.tiers import scaled
from tests.waiting import until
from tokt.inference.links import autopilot
from tokt.inference.links.autopilot import MavlinkReader
from tokt.inference.links.link import open_link
from tokt.inference.links.vehicle import VehiclePlace, VehicleState
from tokt.inference.report import Report

common = pytest.importorskip("pymavlink.dialects.v20.common")


def packed(message, system=1, component=1):
    return bytes(message.pack(common.MAVLink(None, system, component)))


def position(lat=634467000, lon=104200000, depth_m=31.42, hdg=27150):
    relative = int(-1000 * depth_m)
    return common.MAVLink_global_position_int_message(5, lat, lon, 0, relative, 0, 0, 0, hdg)


def hud(alt=-30.0, heading=100):
    return common.MAVLink_vfr_hud_message(0.0, 0.0, heading, 0, alt, 0.0)


ATTITUDE = common.MAVLink_attitude_message(5, math.radians(-7.8), math.radians(1.3), 0, 0, 0, 0)
STATION = packed(common.MAVLink_heartbeat_message(common.MAV_TYPE_GCS, 8, 0, 0, 4, 3), 255, 190)
BEAT = common.MAVLink_heartbeat_message(12, 3, 0, 0, 4, 3)
THERE = VehiclePlace(31.42, 271.5, 63.4467, 10.42, 0.0)


class Reader:
    """A reader, what it knows, and how often it met its own ids."""

    def __init__(self, whole=False, system=1):
        self.clock = HandClock()
        self.state = VehicleState(self.clock)
        self.clashes = 0
        self.reader = MavlinkReader((system, 196), whole, self.state, self.clash)

    def clash(self):
        self.clashes += 1

    def hears(self, *data):
        for piece in data:
            self.reader.heard(piece)
        return self.state.place()


def test_the_place_of_an_autopilot():
    assert Reader().hears(packed(position())) == THERE
    assert Reader().hears(packed(hud())) == VehiclePlace(30.0, 100.0, age_ms=0.0)
    assert Reader().hears(packed(ATTITUDE)) == VehiclePlace(roll_deg=-7.8, pitch_deg=1.3)
    clock = common.MAVLink_system_time_message(1_461_149_301_250_000, 5)
    assert Reader().hears(packed(clock)) == VehiclePlace(vehicle_t=1_461_149_301.25)


def test_the_depth_from_the_surface_is_better_than_the_height_above_the_sea():
    assert Reader().hears(packed(position()), packed(hud())).depth_m == 31.42


@pytest.mark.parametrize(
    ("message", "place"),
    [
        (position(lat=0, lon=0), VehiclePlace(31.42, 271.5, age_ms=0.0)),
        (position(hdg=65535), VehiclePlace(31.42, None, 63.4467, 10.42, 0.0)),
        (position(lat=910000000), VehiclePlace(31.42, 271.5, age_ms=0.0)),
        (hud(math.nan, 400), VehiclePlace()),
        (hud(-math.inf, -1), VehiclePlace()),
        (common.MAVLink_system_time_message(0, 5), VehiclePlace()),
        (common.MAVLink_attitude_message(5, math.nan, 0, 0, 0, 0, 0), VehiclePlace()),
    ],
)
def test_what_is_not_known_or_no_such_figure(message, place):
    assert Reader().hears(packed(message)) == place


def test_a_sensor_that_was_asked_for_is_better_than_the_autopilot():
    reader = Reader()
    reader.state.put(1, heading_deg=12.0)  # a compass's
    place = reader.hears(packed(position()), packed(hud()))
    assert (place.heading_deg, place.depth_m) == (12.0, 31.42)
    reader.clock.now += 2.1
    assert reader.hears(packed(position())).heading_deg == 271.5


def test_nobody_else_is_believed():
    for system, component in ((1, 191), (2, 1), (255, 190)):
        assert Reader().hears(packed(position(), system, component)) == VehiclePlace()
    assert Reader(system=7).hears(packed(position(), 7, 1)) == THERE


def test_a_clash_is_told_once():
    reader = Reader()
    reader.hears(packed(BEAT), packed(BEAT, 1, 195), packed(BEAT, 2, 196))
    assert reader.clashes == 0
    reader.hears(*[packed(BEAT, 1, 196)] * 3)
    assert reader.clashes == 1


def test_a_station_behind_a_router_is_met(monkeypatch):
    reader = Reader()
    # The vehicle's own components are no stations.
    reader.hears(packed(BEAT), packed(BEAT, 1, 100), STATION, STATION, packed(position(), 255, 191))
    assert reader.reader.met == 1
    monkeypatch.setattr(autopilot, "PEER_S", -1.0)
    reader.hears(STATION)
    assert reader.reader.met == 2


def test_a_datagram_s_rest_belongs_to_no_other():
    whole = packed(position())
    assert Reader(whole=True).hears(whole[:20], whole) == THERE
    reader = Reader()
    assert reader.hears(whole[:20], whole[20:]) == THERE
    reader.hears(*[whole[20:] + whole[:20]] * 1000)  # no piece ever ends a message
    assert len(reader.reader._parser.buf) < 600


@settings(max_examples=scaled(100))
@given(
    st.lists(
        st.binary(max_size=300)
        | st.builds(
            lambda data, at, byte: data[: at % len(data)] + byte + data[at % len(data) :],
            st.sampled_from([packed(position()), packed(ATTITUDE), packed(hud())]),
            st.integers(0, 60),
            st.binary(max_size=2),
        ),
        max_size=6,
    ),
    st.booleans(),
)
def test_any_bytes_are_read_past(pieces, whole):
    reader = Reader(whole)
    reader.hears(*pieces)
    # A damaged length waits for its 280 bytes: what comes after them is read again.
    place = reader.hears(*[packed(position())] * 20)
    assert replace(place, roll_deg=None, pitch_deg=None) == THERE
    assert len(reader.reader._parser.buf) < 600


@contextmanager
def sending(text, tell=lambda event: None, **options):
    """A sender over a link, and what it knows of the vehicle."""
    clock = HandClock()
    state = VehicleState(clock)
    sender = sender_over(open_link(text), clock, state, tell, **options)
    try:
        yield sender, state
    finally:
        sender.close()


def talk(read, write, sender, state):
    """Both ends speak until each has heard the other."""
    parser, names = common.MAVLink(None), set()
    parser.robust_parsing = True

    def heard():
        write(packed(position()))
        sender.send(Report(1, 1, 0.0, 1.0, seen(AHEAD)))
        names.update(one.get_type() for one in parser.parse_buffer(read()) or [])
        return {"DISTANCE_SENSOR", "OBSTACLE_DISTANCE"} <= names and state.place() == THERE

    until(heard, lambda: (names, sender.last_error))


def soon(read):
    """What has come by now."""

    def now():
        try:
            return read()
        except (BlockingIOError, TimeoutError):
            return b""

    return now


def test_udpin_both_ways(closed_port):
    here = ("127.0.0.1", closed_port)
    with sending(f"udpin:127.0.0.1:{closed_port}") as (sender, state), bound_socket() as autopilot:
        autopilot.settimeout(0.01)
        talk(soon(lambda: autopilot.recv(4096)), lambda d: autopilot.sendto(d, here), sender, state)


def test_serial_both_ways():
    ours, theirs = os.openpty()
    os.set_blocking(ours, False)
    with sending(f"serial:{os.ttyname(theirs)}:57600") as (sender, state):
        talk(soon(lambda: os.read(ours, 4096)), lambda d: os.write(ours, d), sender, state)
    os.close(ours)
    os.close(theirs)


def test_a_clash_is_an_event(closed_port):
    events = []
    link = f"udpin:127.0.0.1:{closed_port}"
    with sending(link, events.append, component=191), bound_socket() as other:
        other.sendto(packed(BEAT, 1, 191), ("127.0.0.1", closed_port))
        until(lambda: events)
    assert events[0].name == "mavlink_clash"
    assert "system 1, component 191" in events[0].words


def newest_words(station, parser):
    """The next line that a station is told."""
    while True:
        for message in parser.parse_buffer(station.recv(4096)):
            if message.get_type() == "STATUSTEXT":
                return message.text


@pytest.mark.parametrize("link", ["udpin", "udpout"])
def test_who_comes_later_is_told_the_state(closed_port, receiver, link):
    """A station that connects while nothing changes has the newest words all the same.

    By udpout it is behind a router, which spoke before.
    """
    parser, station = common.MAVLink(None), receiver
    port = closed_port if link == "udpin" else receiver.getsockname()[1]
    with sending(f"{link}:127.0.0.1:{port}") as (sender, _):

        def hears(data, gaps):
            station.sendto(data, ("127.0.0.1", sender._to._socket.getsockname()[1]))
            until(lambda: sender._to.gaps + sender._reader.met == gaps)
            sender._clock.now += 2.0
            sender.send(Report(1, 1, 0.0, 1.0, seen(AHEAD)))
            return newest_words(station, parser)

        sender.send(Report(1, 1, 0.0, 1.0, seen(AHEAD)))  # to nobody, or to the router
        if link == "udpout":
            assert newest_words(station, parser) == "tokt: obstacle ahead"
        assert hears(packed(BEAT), 1) == "tokt: obstacle ahead"
        assert hears(STATION, 2) == "tokt: obstacle ahead"
