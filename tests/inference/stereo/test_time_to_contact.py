"""Closing speed and time to contact from distances over time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.inference.stereo import disparity as module
from tokt.inference.stereo.disparity import Closing, ClosingSpeed

STEP_S = 0.1


def after(distances: list[float | None], step_s: float = STEP_S) -> Closing:
    """What is known after distances at a regular pace."""
    speed = ClosingSpeed()
    last = Closing()
    for index, distance in enumerate(distances):
        last = speed.add(index * step_s, distance)
    return last


def approach(n: int, closing_m_s: float = 0.5, from_m: float = 8.0) -> list[float | None]:
    return [from_m - closing_m_s * STEP_S * index for index in range(n)]


def test_an_even_approach_is_exact() -> None:
    found = after(approach(30))
    assert found.closing_m_s == pytest.approx(0.5, abs=1e-9)
    assert found.contact_s == pytest.approx((8.0 - 0.5 * 2.9) / 0.5, abs=1e-6)


def test_irregular_times_change_nothing() -> None:
    times = np.cumsum(np.random.default_rng(0).uniform(0.02, 0.3, 40))
    speed = ClosingSpeed()
    found = [speed.add(float(t), 9.0 - 0.4 * float(t)) for t in times][-1]
    assert found.closing_m_s == pytest.approx(0.4, abs=1e-9)


def test_the_stated_error_of_the_speed_holds() -> None:
    rng = np.random.default_rng(1)
    full, least = [], []
    for _ in range(200):
        speed = ClosingSpeed()
        found = [
            speed.add(index * STEP_S, distance + rng.normal(0, 0.03))
            for index, distance in enumerate(approach(30))
            if distance is not None
        ]
        speeds = [each.closing_m_s for each in found if each.closing_m_s is not None]
        full.append(speeds[-1])
        least.append(speeds[0])
    assert np.std(full) == pytest.approx(0.012, abs=0.003)
    assert np.std(least) == pytest.approx(0.03, abs=0.008)
    assert np.mean(full) == pytest.approx(0.5, abs=0.005)


def test_a_retreat_is_negative_and_has_no_contact() -> None:
    found = after(approach(30, closing_m_s=-0.3, from_m=2.0))
    assert found.closing_m_s == pytest.approx(-0.3, abs=1e-9)
    assert found.contact_s is None


def test_standing_still_has_no_contact() -> None:
    found = after(approach(30, closing_m_s=module.MIN_CLOSING_M_S * 0.9))
    assert found.closing_m_s is not None
    assert found.contact_s is None


def test_too_few_points_or_too_short_a_time_give_no_speed() -> None:
    whole = math.ceil(module.MIN_SPAN_S / STEP_S)
    assert after(approach(whole)) == Closing()
    assert after(approach(whole + 1)).closing_m_s is not None
    assert after(approach(module.MIN_POINTS - 1), step_s=0.5) == Closing()


def test_a_missed_distance_gives_no_speed_itself_but_leaves_the_line() -> None:
    distances = approach(30)
    assert after([*distances, None]) == Closing()
    distances[20:24] = [None] * 4
    assert after(distances).closing_m_s == pytest.approx(0.5, abs=1e-9)


def test_a_long_gap_starts_anew() -> None:
    missed = math.ceil(module.GAP_S / STEP_S)
    assert after([*approach(30), *[None] * missed, 3.0]) == Closing()


def test_stray_distances_are_dropped() -> None:
    distances = approach(30)
    for stray in (8, 15, 22, 28):
        distances[stray] = 2.0
    assert after(distances).closing_m_s == pytest.approx(0.5, abs=1e-9)
    distances[29] = 2.0  # the last: not yet known to be one
    assert after(distances[:30]) == Closing()


def test_a_jump_that_stays_starts_a_new_line() -> None:
    jumped = [*approach(30), *approach(12, closing_m_s=0.2, from_m=3.0)]
    assert after(jumped[:32]) == Closing()
    assert after(jumped).closing_m_s == pytest.approx(0.2, abs=1e-9)


def test_distances_that_only_jump_give_no_speed() -> None:
    assert after([float(2 + 5 * (index % 2) + index % 7) for index in range(60)]) == Closing()


@pytest.mark.parametrize("t_s", [1.0, 2.9, math.nan, -math.inf, math.inf])
def test_time_that_does_not_go_on_starts_anew(t_s: float) -> None:
    speed = ClosingSpeed()
    for index, distance in enumerate(approach(30)):
        speed.add(index * STEP_S, distance)
    assert speed.add(t_s, 6.5) == Closing()
    start = t_s if math.isfinite(t_s) else 100.0
    found = [speed.add(start + 0.1 * (index + 1), 6.0 - 0.03 * index) for index in range(20)]
    assert found[5] == Closing()
    assert found[-1].closing_m_s == pytest.approx(0.3, abs=0.01)


numbers = st.floats(allow_nan=True, allow_infinity=True, width=32)


@settings(max_examples=scaled(60))
@given(st.lists(st.tuples(numbers | st.integers(0, 9), st.none() | numbers | st.floats(0, 9))))
def test_nothing_raises_and_contact_only_lies_ahead(points: list[tuple[float, float]]) -> None:
    speed = ClosingSpeed()
    for t_s, distance in points:
        found = speed.add(t_s, distance)
        if found.contact_s is not None:
            assert found.closing_m_s is not None
            assert found.closing_m_s >= module.MIN_CLOSING_M_S
            assert 0 <= found.contact_s < math.inf
