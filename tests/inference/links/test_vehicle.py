"""What is said of the vehicle counts while it is fresh, finite and in its range."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.inference.conftest import HandClock
from tokt.inference.links.datagrams import PEER_S
from tokt.inference.links.vehicle import DOUBT_S, PLACE_S, VehiclePlace, VehicleState


def test_a_figure_is_told_until_it_is_old(hand_clock):
    state = VehicleState(hand_clock)
    assert state.place() == VehiclePlace()
    state.put(depth_m=12.345)
    hand_clock.now += 1.0
    state.put(heading_deg=271.54)
    hand_clock.now += 0.5
    assert state.place() == VehiclePlace(depth_m=12.35, heading_deg=271.5, age_ms=1500.0)
    hand_clock.now += 0.6
    assert state.place() == VehiclePlace(heading_deg=271.5, age_ms=1100.0)
    hand_clock.suspend(3600)
    assert state.place() == VehiclePlace()


def test_a_position_is_whole_or_none(hand_clock):
    state = VehicleState(hand_clock)
    state.put(lat_deg=63.4, lon_deg=181.0)
    assert state.place() == VehiclePlace()
    state.put(lat_deg=63.4, lon_deg=10.4)
    assert state.place() == VehiclePlace(lat_deg=63.4, lon_deg=10.4, age_ms=0.0)


def test_north_is_0(hand_clock):
    state = VehicleState(hand_clock)
    for heading_deg in (360.0, 359.97):
        state.put(heading_deg=heading_deg)
        assert state.place().heading_deg == 0.0


def test_the_better_source_wins_while_it_speaks(hand_clock):
    state = VehicleState(hand_clock)
    state.put(1, depth_m=2.0)
    state.put(0, depth_m=5.0)
    hand_clock.now += 1.5
    state.put(1, depth_m=2.0)
    assert state.place().depth_m == 5.0
    hand_clock.now += 1.0
    state.put(1, depth_m=2.0)
    assert state.place().depth_m == 2.0


def test_the_vehicle_s_clock_goes_on(hand_clock):
    state = VehicleState(hand_clock)
    state.put(vehicle_t=0.0)  # never set
    assert state.place().vehicle_t is None
    state.put(vehicle_t=1_461_149_301.0)
    hand_clock.now += 1.25
    assert state.place() == VehiclePlace(vehicle_t=1_461_149_302.25)


def doubt_of(state):
    """The words of the doubt, of which no place is given."""
    place = state.place()
    assert place == VehiclePlace(doubt=place.doubt)
    return place.doubt


def test_another_sender_is_not_believed_while_the_first_one_speaks(hand_clock):
    state = VehicleState(hand_clock)
    for _ in range(3):
        state.put(2, "one", depth_m=31.4, lat_deg=63.4, lon_deg=10.4)
        state.put(2, "two", depth_m=31.6, lat_deg=63.4001, lon_deg=10.4)  # by another way
        hand_clock.now += 1.0
    assert state.place() == VehiclePlace(31.4, None, 63.4, 10.4, 1000.0)
    state.put(2, "two", depth_m=31.6)
    hand_clock.now += 1.5
    state.put(2, "two", depth_m=31.7)  # the first one has been silent
    assert state.place() == VehiclePlace(31.7, age_ms=0.0)


def test_two_that_contradict_each_other_are_not_given(hand_clock):
    state = VehicleState(hand_clock)
    state.put(2, "one", depth_m=31.4, lat_deg=63.4, lon_deg=10.4)
    state.put(2, "two", depth_m=31.4, lat_deg=64.4, lon_deg=10.4)
    assert doubt_of(state) == "one and two contradict each other (lat_deg)"
    state.put(0, "compass", heading_deg=90.0)  # nobody contradicts that one
    assert (state.place().heading_deg, state.place().depth_m) == (90.0, None)
    for _ in range(4):
        hand_clock.now += 1.5
        state.put(2, "one", depth_m=31.4)
    assert state.place() == VehiclePlace(31.4, age_ms=0.0)


def test_a_place_that_the_first_sender_never_says(hand_clock):
    """An autopilot under water often has no position."""
    state = VehicleState(hand_clock)
    state.put(2, "one")
    state.put(2, "two", lat_deg=64.4, lon_deg=10.4)  # one may be about to say the same
    assert state.place() == VehiclePlace()
    for _ in range(3):
        hand_clock.now += 1.0
        state.put(2, "one")
    state.put(2, "two", lat_deg=64.4, lon_deg=10.4)
    assert doubt_of(state).startswith("one and two")


def test_a_vehicle_that_comes_back_from_another_port(hand_clock):
    state = VehicleState(hand_clock)
    state.put(2, "old", depth_m=31.4)
    silent_s = 0.0
    while state.place().depth_m != 0.1:
        silent_s += 0.25
        hand_clock.now += 0.25
        state.put(2, "new", depth_m=0.1)
    assert silent_s <= PLACE_S + DOUBT_S + 0.25 <= PEER_S


@pytest.mark.parametrize("name", ["depth_m", "lat_deg", "lon_deg"])
def test_one_sender_that_jumps_contradicts_itself(name, hand_clock):
    """As two do that one router passes on, or one serial port."""
    state = VehicleState(hand_clock)
    for value in (10.0, 10.0001, 10.0):
        state.put(2, "tcp:rov:5777", **{name: value})
        hand_clock.now += 0.5
    assert getattr(state.place(), name) == 10.0
    state.put(2, "tcp:rov:5777", **{name: 17.0})
    assert doubt_of(state) == f"tcp:rov:5777 contradicts itself ({name})"


def test_a_vehicle_turns_as_fast_as_it_likes(hand_clock):
    state = VehicleState(hand_clock)
    for heading_deg in (10.0, 190.0, 350.0):
        state.put(2, "one", heading_deg=heading_deg)
        state.put(2, "two", heading_deg=(heading_deg + 30) % 360)
        assert state.place().heading_deg == heading_deg
    state.put(2, "two", heading_deg=100.0)
    assert doubt_of(state)


def test_sensors_are_senders_each(hand_clock):
    """A compass may say something else than what another sensor measures better."""
    state = VehicleState(hand_clock)
    state.put(0, "usbl", lat_deg=63.4, lon_deg=10.4)
    state.put(1, "compass", heading_deg=90.0)
    state.put(0, "gyro", heading_deg=190.0)
    assert state.place() == VehiclePlace(None, 190.0, 63.4, 10.4, 0.0)
    state.put(0, "forger", lat_deg=64.4, lon_deg=10.4)
    place = state.place()
    assert (place.heading_deg, place.lat_deg) == (190.0, None)
    assert place.doubt == "usbl and forger contradict each other (lat_deg)"


RANGES = {
    "depth_m": (-10, 12_000),
    "heading_deg": (0, 360),
    "lat_deg": (-90, 90),
    "lon_deg": (-180, 180),
    "roll_deg": (-180, 180),
    "pitch_deg": (-90, 90),
    "vehicle_t": (1e9, 1e11),
}


@given(st.dictionaries(st.sampled_from(list(RANGES)), st.floats(width=64) | st.floats(-400, 400)))
def test_nothing_else_than_a_place_gets_in(figures):
    state = VehicleState(HandClock())
    state.put(**figures)
    place = state.place()
    good = all(
        low <= figures[name] <= high for name, (low, high) in RANGES.items() if name in figures
    )
    for name, (low, high) in RANGES.items():
        value = getattr(place, name)
        assert (value is not None) == (good and name in figures)
        assert value is None or (math.isfinite(value) and low <= value <= high)
    assert place.heading_deg != 360.0
