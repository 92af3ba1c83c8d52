"""Strangers on a vehicle's links: they take nobody's place, and no place of theirs is believed."""

from contextlib import ExitStack, contextmanager

import pytest

from tests.inference.conftest import HandClock
from tests.inference.links.test_autopilot import BEAT, STATION, packed, position, sending
from tests.inference.links.test_nmea import sentence
from tests.inference.live import bound_socket
from tests.inference.outputs.test_mavlink import AHEAD, seen
from tests.inference.test_faults import hold_row
from tests.waiting import until
from tokt.inference.links.autopilot import MavlinkReader
from tokt.inference.links.datagrams import NOBODY, OTHER, OWN, PLACES
from tokt.inference.links.link import open_link
from tokt.inference.links.nmea import NmeaReader
from tokt.inference.links.vehicle import DOUBT_S, VehicleState
from tokt.inference.monitoring.receivers import PlaceWatch
from tokt.inference.monitoring.run_counts import RunCounts
from tokt.inference.report import Report

SAID = "as without it"


def kind_of(*data, system=1):
    return MavlinkReader((system, 196), True, VehicleState(HandClock()), list).heard(b"".join(data))


def test_whose_a_datagram_is():
    assert kind_of(packed(BEAT)) == kind_of(packed(BEAT, 1, 154)) == OWN
    assert kind_of(packed(BEAT, 101, 1)) == kind_of(STATION) == OTHER
    assert kind_of(packed(BEAT, 101, 1), system=101) == OWN
    assert kind_of(STATION, packed(BEAT), STATION) == OWN  # a router's
    for rubbish in (b"", b"rubbish", packed(BEAT)[:-1], packed(BEAT)[:-1] + b"x"):
        assert kind_of(rubbish) == NOBODY


@contextmanager
def crowded(port, *systems):
    """A sender over udpin to which so many have spoken first; its events, and who speaks to it."""
    events = []
    with sending(f"udpin:127.0.0.1:{port}", events.append) as (sender, _), ExitStack() as sockets:

        def speaks(data):
            peer = sockets.enter_context(bound_socket())
            peer.sendto(data, ("127.0.0.1", port))
            return peer

        for number, system in enumerate(systems, 1):
            speaks(packed(BEAT, system, 1))
            until(lambda number=number: sender._to.gaps == number)
        yield sender, events, speaks


def answered(sender, peer, gaps):
    """Whether it gets what a report comes to, once it was heard."""
    until(lambda: sender._to.gaps == gaps)
    sender.send(Report(1, 1, 0.0, 1.0, seen(AHEAD)))
    return bool(peer.recv(4096))


def test_strangers_that_speak_first(closed_port):
    with crowded(closed_port, *range(101, 101 + PLACES[OTHER])) as (sender, events, speaks):
        late = speaks(STATION)
        assert answered(sender, speaks(packed(BEAT)), PLACES[OTHER] + 1)
        for _ in range(3):
            sender.send(Report(1, 1, 0.0, 1.0, seen(AHEAD)))
        late.settimeout(0.05)
        with pytest.raises(TimeoutError):
            late.recv(100)
    (event,) = events
    assert event.name == "mavlink_strangers"
    words = "MAVLink has 8 senders of systems other than system 1: no more are answered"
    assert event.words == words
    fault = "8 senders of other systems speak first on a MAVLink link (`udpin`)"
    hold_row(fault, f"{SAID}; the own system is answered", "event `mavlink_strangers`")


def test_a_station_is_answered_while_there_is_room(closed_port):
    with crowded(closed_port, *range(101, 100 + PLACES[OTHER])) as (sender, _, speaks):
        assert answered(sender, speaks(STATION), PLACES[OTHER])


def test_more_senders_of_the_own_system_than_there_are_places(closed_port):
    with crowded(closed_port, *[1] * PLACES[OWN]) as (sender, events, speaks):
        assert answered(sender, speaks(packed(BEAT)), PLACES[OWN] + 1)
    assert [event.name for event in events] == ["mavlink_strangers"]
    assert "32 senders of system 1: the last ones heard are answered" in events[0].words
    fault = "more than 32 senders with the own system's number on a MAVLink link (`udpin`)"
    said = f"{SAID}; the 32 heard last are answered"
    hold_row(fault, said, "event `mavlink_strangers`")


class Placed:
    """A vehicle's place, what is told of it, and a link to hear it by."""

    def __init__(self, link, nmea=False):
        self.clock, self.events = HandClock(), []
        self.state, self.link = VehicleState(self.clock), open_link(link)
        self.counts = RunCounts(self.clock)
        self.watch = PlaceWatch(self.clock, self.tell, str)
        autopilot = MavlinkReader((1, 196), self.link.whole, self.state, list)
        self.link.listen((NmeaReader(self.state, True, True) if nmea else autopilot).heard)

    def tell(self, event):
        self.events.append(event)
        self.counts.event(event)

    def said(self):
        """The fields of a datagram that is said now."""
        report = Report(1, 1, 0.0, 1.0, seen(AHEAD), place=self.state.place())
        self.watch.heartbeat(report)
        return report.fields()

    @property
    def port(self):
        return self.link._socket.getsockname()[1]


TRUE, FORGED = packed(position()), packed(position(lat=644467000))
SENTENCES = sentence("IIXDR,D,31.42,M,DEPTH"), sentence("IIXDR,D,3.0,M,DEPTH")
NAMES = ("depth_m", "heading_deg", "lat_deg", "lon_deg")


@pytest.mark.parametrize(
    ("text", "nmea", "said"),
    [
        ("udpin:127.0.0.1:{}", False, (TRUE, FORGED)),
        ("udpout:127.0.0.1:{}", False, (TRUE, FORGED)),
        ("udpin:127.0.0.1:{}", True, SENTENCES),
    ],
    ids=["udpin", "udpout", "nmea"],
)
def test_two_senders_of_one_place(text, nmea, said, closed_port):
    true, forged = said
    placed = Placed(text.format(closed_port), nmea)
    with bound_socket() as vehicle, bound_socket() as forger:

        def speaks(peer, data):
            peer.sendto(data, ("127.0.0.1", placed.port))

        speaks(vehicle, true)
        until(lambda: placed.said()["depth_m"] == 31.42)
        speaks(forger, forged)
        until(lambda: placed.said()["depth_m"] is None)
        assert {name: placed.said()[name] for name in NAMES} == dict.fromkeys(NAMES)
        (event,) = placed.events
        assert event.name == "place_doubtful"
        for peer in (vehicle, forger):
            assert f"127.0.0.1:{peer.getsockname()[1]}" in event.words
        assert list(placed.counts.warnings.values()) == [event.words]
        for _ in range(2):
            placed.clock.now += 0.6 * DOUBT_S
            placed.said()

        def is_back():
            speaks(vehicle, true)
            return placed.said()["depth_m"] == 31.42

        until(is_back)
        assert [event.name for event in placed.events] == ["place_doubtful", "place_back"]
        assert placed.counts.warnings == {}
    placed.link.close()
    fault = "two senders with the autopilot's numbers, each at its address, contradict each other"
    if nmea:
        fault = "two NMEA senders, each at its address, contradict each other"
    said = f"{SAID}; no place while they do and for 5 s"
    hold_row(fault, said, "events `place_doubtful`, `place_back`")


def test_a_router_that_passes_on_two_places(closed_port):
    placed = Placed(f"udpin:127.0.0.1:{closed_port}")
    with bound_socket() as router:
        for data in (TRUE, FORGED):
            router.sendto(data, ("127.0.0.1", closed_port))
        until(lambda: placed.state.place().doubt)
        assert placed.said()["lat_deg"] is None
    placed.link.close()
    assert "contradicts itself (lat_deg)" in placed.events[0].words
    fault = "the place jumps by over 5 m of depth or 0.0005 degrees within 2 s"
    said = f"{SAID}; no place for 5 s"
    hold_row(fault, said, "events `place_doubtful`, `place_back`")


def test_a_doubtful_place_that_is_lost_then(closed_port):
    placed = Placed(f"udpin:127.0.0.1:{closed_port}")
    placed.state.put(2, "one", depth_m=30.0)
    placed.state.put(2, "two", depth_m=3.0)
    placed.said()
    for _ in range(12):
        placed.clock.now += 1.0
        placed.said()
    placed.link.close()
    assert [event.name for event in placed.events] == ["place_doubtful", "place_lost"]


def test_a_vehicle_that_starts_again_is_heard_at_another_port(closed_port):
    placed = Placed(f"udpin:127.0.0.1:{closed_port}")
    with bound_socket() as old, bound_socket() as new:
        old.sendto(TRUE, ("127.0.0.1", closed_port))
        until(lambda: placed.said()["depth_m"] == 31.42)
        placed.clock.now += 2.1

        def is_heard():
            new.sendto(packed(position(depth_m=0.5)), ("127.0.0.1", closed_port))
            return placed.said()["depth_m"] == 0.5

        until(is_heard)
    placed.link.close()
    assert placed.events == []
    fault = "the vehicle starts again and is heard at another port"
    hold_row(fault, f"{SAID}; its place once the old port has been silent for 2 s", "nothing")
