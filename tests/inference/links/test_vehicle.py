"""What is said of the vehicle counts while it is fresh, finite and in its range."""

import math

from hypothesis import given
from hypothesis import strategies as st

from tests.inference.conftest import HandClock
from tokt.inference.links.vehicle import VehiclePlace, VehicleState


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
