"""Sentences as sensors and positioning systems send them, and all that is none."""

import socket

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.inference.conftest import HandClock
from tests.tiers import scaled
from tests.waiting import until
from tokt.inference.links.link import open_link
from tokt.inference.links.nmea import MAX_LINE, NmeaReader
from tokt.inference.links.vehicle import VehiclePlace, VehicleState


def sentence(body: str) -> bytes:
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    return f"${body}*{checksum:02X}\r\n".encode()


def place_of(*lines: bytes, dpt: bool = False) -> VehiclePlace:
    state = VehicleState(HandClock())
    NmeaReader(state, dpt, whole=False).heard(b"".join(lines))
    return state.place()


TRONDHEIM = VehiclePlace(lat_deg=63.4467, lon_deg=10.42, age_ms=0.0)
SOUTH_WEST = VehiclePlace(lat_deg=-33.9, lon_deg=-70.5, age_ms=0.0)


@pytest.mark.parametrize(
    ("body", "place"),
    [
        ("GPGGA,120000.00,6326.802,N,01025.200,E,1,08,1.0,0.0,M,,M,,", TRONDHEIM),
        ("GPGGA,120000.00,6326.802,N,01025.200,E,0,00,,,M,,M,,", VehiclePlace()),
        ("GPGGA,120000.00,6326.802,N,01025.200,E,8,08,1.0,0.0,M,,M,,", VehiclePlace()),
        ("GPGGA,120000.00,,,,,1,,,,M,,M,,", VehiclePlace()),
        ("GPGGA,120000.00,6326.802,N,01025.200,E,,08,1.0,0.0,M,,M,,", VehiclePlace()),
        ("GNRMC,120000,A,3354.0,S,07030.0,W,0.0,0.0,200416,,,A", SOUTH_WEST),
        ("GNRMC,120000,V,3354.0,S,07030.0,W,0.0,0.0,200416,,,N", VehiclePlace()),
        ("GPGLL,3354.0,S,07030.0,W,120000,A,A", SOUTH_WEST),
        ("GPGLL,3354.0,S,07030.0,W", VehiclePlace()),  # older ones have no status
        ("GPGLL,3364.0,S,07030.0,W,120000,A,A", VehiclePlace()),  # 64 minutes
        ("HEHDT,271.5,T", VehiclePlace(heading_deg=271.5, age_ms=0.0)),
        ("HEHDT,,T", VehiclePlace()),
        ("HCHDG,358.0,1.0,E,2.5,E", VehiclePlace(heading_deg=1.5, age_ms=0.0)),
        ("HCHDG,10.0,,,2.5,W", VehiclePlace(heading_deg=7.5, age_ms=0.0)),
        ("HCHDM,10.0,M", VehiclePlace(heading_deg=10.0, age_ms=0.0)),
        (
            "PRDID,-1.31,7.81,047.3",
            VehiclePlace(heading_deg=47.3, age_ms=0.0, roll_deg=7.8, pitch_deg=-1.3),
        ),
        ("YXXDR,C,9.5,C,TEMP,D,31.42,M,DEPTH", VehiclePlace(depth_m=31.42, age_ms=0.0)),
        ("YXXDR,D,31.42,M,ALTITUDE", VehiclePlace()),
        ("SDDPT,4.2,0.0", VehiclePlace()),
        ("SDDBT,13.8,f,4.2,M,2.3,F", VehiclePlace()),
        ("SDDBS,13.8,f,4.2,M,2.3,F", VehiclePlace()),
        ("HEHDT,1_0,T", VehiclePlace()),
        ("HEHDT,nan,T", VehiclePlace()),
        ("HEHDT,1e1,T", VehiclePlace()),
    ],
)
def test_which_sentence_is_taken_for_what(body, place):
    assert place_of(sentence(body)) == place


def test_dpt_is_the_vehicle_s_depth_where_that_was_said():
    assert place_of(sentence("IIDPT,31.4,0.0"), dpt=True) == VehiclePlace(depth_m=31.4, age_ms=0.0)


def test_a_compass_waits_for_true_north():
    lines = sentence("HEHDT,20.0,T"), sentence("HCHDM,10.0,M")
    assert place_of(*lines).heading_deg == 20.0


def test_a_checksum_is_needed():
    good = sentence("HEHDT,271.5,T")
    assert place_of(good.replace(b"271", b"272")) == VehiclePlace()
    assert place_of(good.partition(b"*")[0] + b"\r\n") == VehiclePlace()


def test_a_line_comes_in_pieces_and_a_datagram_needs_no_end():
    state, line = VehicleState(HandClock()), sentence("HEHDT,271.5,T")
    reader = NmeaReader(state, False, whole=False)
    assert [reader.heard(line[at : at + 1]) for at in range(len(line))] == [False] * 18 + [True]
    assert reader.heard(b"x" * MAX_LINE * 5 + b"\n" + line) is True
    reader.heard(b"x" * 10_000)
    assert len(reader._rest) <= MAX_LINE
    assert NmeaReader(state, False, whole=True).heard(line.strip()) is True


anything = st.binary(max_size=100) | st.builds(
    lambda kind, body: sentence(f"GP{kind},{body}"),
    st.sampled_from(["GGA", "RMC", "GLL", "HDT", "HDG", "HDM", "DPT", "XDR"]),
    st.text(st.sampled_from("0123456789.,-+ANSEWMD"), max_size=60),
)


@settings(max_examples=scaled(80))
@given(st.lists(anything, max_size=5), st.booleans())
def test_any_bytes_are_passed_over(pieces, whole):
    state = VehicleState(HandClock())
    reader = NmeaReader(state, True, whole)
    for piece in pieces:
        reader.heard(piece)
    state.place()
    reader.heard(b"\n" + sentence("HEHDT,271.5,T"))
    assert state.place().heading_deg is not None


def test_over_a_socket(hand_clock, closed_port):
    state, link = VehicleState(hand_clock), open_link(f"udpin:127.0.0.1:{closed_port}")
    link.listen(NmeaReader(state, False, link.whole).heard)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
        sensor.sendto(sentence("HEHDT,271.5,T"), ("127.0.0.1", closed_port))
        until(lambda: state.place().heading_deg == 271.5)
    link.close()
