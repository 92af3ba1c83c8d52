"""The trend of the mean value, how sure it is, and the time to contact from it.

Curves are made as a grid of patches makes them: an area that follows from a distance, errors in
some patches, whole patches, frames without anything, times that are not even.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.inference.policy import temporal_cues as module
from tokt.inference.policy.temporal_cues import (
    GROWING,
    HORIZON_S,
    PATCH_MEAN,
    SATURATED_MEAN,
    SHRINKING,
    SLOTS,
    STEADY,
    STEADY_PER_S,
    TRENDS,
    Trend,
    TrendEstimator,
)

pytestmark = pytest.mark.xdist_group("trend")

STEP_S = 0.25
LATER = 1_461_149_301.0
"""A time of day, seconds since 1970: nothing may hang on times being small."""


def told(times: Iterable[float], means: Iterable[Any], whole: bool = True) -> list[Trend]:
    """What is known after each mean."""
    watch = TrendEstimator()
    return [watch.add(float(t), mean, whole) for t, mean in zip(times, means, strict=True)]


def after(means: list[float | None], step_s: float = STEP_S, whole: bool = True) -> Trend:
    """What is known after means at a regular pace."""
    return told([LATER + index * step_s for index in range(len(means))], means, whole)[-1]


def approach(n: int, contact_s: float, last_mean: float = 40.0) -> list[float | None]:
    """Means of a thing wholly in view that is reached `contact_s` after the last."""
    left = [contact_s + STEP_S * (n - 1 - index) for index in range(n)]
    return [last_mean * (contact_s / seconds) ** 2 for seconds in left]


@pytest.mark.parametrize("contact_s", [2.0, 5.0, 12.0])
def test_an_even_approach_is_exact(contact_s):
    found = after(approach(20, contact_s))
    assert found.trend == GROWING and found.contact_s == pytest.approx(contact_s, abs=0.02)
    assert found.confidence is not None and 0.9 < found.confidence <= 1


def test_what_goes_away_shrinks_and_has_no_contact():
    found = after(approach(20, 3.0)[::-1])
    assert (found.trend, found.contact_s) == (SHRINKING, None)
    assert found.confidence is not None and found.confidence > 0.9


def test_what_stays_is_steady_and_has_no_contact():
    found = after([12 * PATCH_MEAN] * 20)
    assert (found.trend, found.contact_s) == (STEADY, None)
    assert found.confidence is not None and found.confidence > 0.9
    # One patch may as well be half of one or one and a half: that is not sure.
    small = after([PATCH_MEAN] * 20)
    assert small.confidence is None or small.confidence < 0.8


def test_a_growth_slower_than_the_steady_band_is_steady():
    slow = [60 * math.exp(0.4 * STEADY_PER_S * STEP_S * index) for index in range(20)]
    fast = [60 * math.exp(2.0 * STEADY_PER_S * STEP_S * index) for index in range(20)]
    assert after(list(slow)).trend == STEADY and after(list(fast)).trend == GROWING


def test_too_few_means_or_too_short_a_time_have_no_trend():
    assert after(approach(module.MIN_SLOTS - 1, 4.0), step_s=0.5) == Trend()
    assert after(approach(6, 4.0)) == Trend()  # 1.25 s
    assert after(approach(7, 4.0)).trend == GROWING


def test_a_status_that_flickers_has_no_trend_itself_but_leaves_the_means():
    means = approach(20, 5.0)
    for gone, nothing in ((9, 0.0), (10, None), (14, 0.0), (17, None)):
        means[gone] = nothing
    found = after(means)
    assert found.trend == GROWING and found.contact_s == pytest.approx(5.0, abs=0.1)
    for nothing in (0.0, None, math.nan):
        assert after([*means, nothing]) == Trend()


def test_a_long_time_without_anything_starts_anew():
    missed = math.ceil(module.GAP_S / STEP_S)
    means = approach(20, 5.0)
    assert after([*means, *[0.0] * (missed - 1), 41.0]).trend == GROWING
    assert after([*means, *[0.0] * missed, 41.0]) == Trend()


def test_two_frames_of_one_tick_of_the_clock_leave_the_means():
    watch = TrendEstimator()
    for index, mean in enumerate(approach(20, 5.0)):
        found = [watch.add(LATER + index * STEP_S, mean) for _ in range(2)]
    assert [each.trend for each in found] == [GROWING] * 2
    # A clock that stands still says nothing.
    assert [watch.add(LATER + 100, 40.0) for _ in range(50)] == [Trend()] * 50


@pytest.mark.parametrize("t_s", [LATER, LATER + 3.0, math.nan, -math.inf, math.inf, 1e308])
def test_time_that_does_not_go_on_starts_anew(t_s):
    watch = TrendEstimator()
    for index, mean in enumerate(approach(20, 5.0)):
        watch.add(LATER + index * STEP_S, mean)
    assert watch.add(t_s, 41.0) == Trend()
    start = t_s if abs(t_s) < module.END_S else LATER + 100
    found = [watch.add(start + STEP_S * (i + 1), 60.0 * 0.9**i) for i in range(12)]
    assert found[2] == Trend() and found[-1].trend == SHRINKING


def test_what_is_cut_off_by_the_edge_has_a_trend_but_no_contact():
    means = approach(20, 5.0)
    found = after(means, whole=False)
    assert (found.trend, found.contact_s) == (GROWING, None)
    # Coming in at the side it grows and is no nearer: as long as such means count, no contact.
    watch = TrendEstimator()
    given_ = [
        watch.add(LATER + index * STEP_S, mean, whole=index != 10)
        for index, mean in enumerate(approach(30, 5.0, 80.0))
    ]
    assert given_[9].contact_s is not None
    assert {found.contact_s for found in given_[10 : 10 + SLOTS]} == {None}
    assert all(found.trend == GROWING for found in given_[10:])
    assert given_[10 + SLOTS].contact_s is not None


def test_one_frame_that_is_cut_off_is_enough():
    watch = TrendEstimator()
    for index in range(40):  # two frames in a slot
        mean = 1000.0 / (10.0 - 0.125 * index) ** 2
        found = watch.add(LATER + 0.125 * index, mean, whole=index != 30)
    assert found.trend == GROWING and found.contact_s is None


def test_a_full_picture_has_no_trend():
    full = SATURATED_MEAN + 1
    assert after([full] * 20) == Trend()
    assert after([*approach(20, 5.0, 200.0), full]) == Trend()


def test_nothing_older_than_the_horizon_has_a_part():
    rng = np.random.default_rng(3)
    times = LATER + np.cumsum(rng.uniform(0.05, 0.4, 120))
    means = rng.integers(0, 30, len(times)) * PATCH_MEAN
    all_ = told(times, means)
    for begin in range(0, 60, 7):
        rest = told(times[begin:], means[begin:])
        known = times[begin:] - times[begin] >= HORIZON_S
        assert known.sum() > 20
        pairs = zip(all_[begin:], rest, known, strict=True)
        assert all(repr(whole) == repr(part) for whole, part, sure in pairs if sure)


numbers = st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=scaled(60))
@given(
    st.lists(
        st.tuples(
            st.floats(0, 9) | st.integers(0, 9) | numbers,
            st.none() | st.floats(0, 255) | numbers,
            st.booleans(),
        ),
        max_size=60,
    )
)
def test_nothing_raises(points):
    watch = TrendEstimator()
    t_s = LATER
    for step_s, mean, whole in points:
        t_s = t_s + step_s if math.isfinite(t_s + step_s) else step_s
        found = watch.add(t_s, mean, whole)
        assert (found.trend is None) == (found.confidence is None)
        if found.trend is not None:
            assert found.trend in TRENDS
            assert found.confidence is not None and 0.5 <= found.confidence <= 1
        if found.contact_s is not None:
            assert found.trend == GROWING and 0 < found.contact_s < math.inf


# Simulated curves


@dataclass(frozen=True)
class Curve:
    """A curve and its truth: the rate by which the area grows in the middle of the last 4 s."""

    times: np.ndarray
    means: np.ndarray
    rate_per_s: float
    contact_s: float


def curve(rng, rate_per_s, patches=None, fps=0.0) -> Curve:
    """A noisy curve in whole patches, of a thing that grows by `rate_per_s` of itself a second.

    Drawn from: 2.5 to 15 frames a second with 20 % jitter; 3 to 40 patches at the end; errors of
    0.2 to 0.5 times the root of the patches that are alike for 0 to 0.5 s; up to 15 % of the
    frames without anything, each.
    """
    rate_hz = fps or rng.uniform(2.5, 15)
    t = np.cumsum(rng.uniform(0.8, 1.2, int(6 * rate_hz)) / rate_hz)
    middle = t[-1] - 2.0
    # Z over what it is in the middle: at a constant speed; the area is 1 / Z**2.
    z = 1 - rate_per_s / 2 * (t - middle)
    t, z = t[z > 0.2], z[z > 0.2]
    last = rng.uniform(3, 40) if patches is None else patches
    area = last * (z[-1] / z) ** 2
    alike_s, error = rng.uniform(0, 0.5), rng.normal(size=len(t))
    for i in range(1, len(t)):
        alike = math.exp((t[i - 1] - t[i]) / alike_s)
        error[i] = alike * error[i - 1] + math.sqrt(1 - alike**2) * error[i]
    n = np.clip(np.round(area + rng.uniform(0.2, 0.5) * np.sqrt(area) * error), 0, 85)
    n[rng.random(len(t)) < rng.uniform(0, 0.15)] = 0
    contact_s = (z[-1] / rate_per_s * 2) if rate_per_s > 0 else math.inf
    return Curve(LATER + t, n * PATCH_MEAN, rate_per_s, contact_s)


def answer(one: Curve) -> Trend:
    """The last trend that is told: one a curve, as the next frame's would be nearly the same."""
    found = [each for each in told(one.times, one.means) if each.trend is not None]
    return found[-1] if found else Trend()


def share_sure(found: list[Trend], word: str) -> float:
    """The share of those that say this word, and nine tenths surely or more."""
    return sum(each.trend == word and (each.confidence or 0) >= 0.9 for each in found) / len(found)


def truth(rate_per_s: float) -> str:
    if abs(rate_per_s) <= STEADY_PER_S:
        return STEADY
    return GROWING if rate_per_s > 0 else SHRINKING


@pytest.fixture(scope="module")
def answers():
    """Truth and answer of 900 curves: a third each quite steady, of any slope, and of nearly none,
    where it is hardest.
    """
    rng = np.random.default_rng(5)
    rates = [*[0.0] * 300, *rng.uniform(-0.5, 0.5, 300), *rng.uniform(-0.12, 0.12, 300)]
    return [(truth(rate), answer(curve(rng, float(rate)))) for rate in rates]


@pytest.mark.parametrize("word", TRENDS)
def test_a_confidence_of_nine_tenths_is_wrong_in_at_most_a_tenth(word, answers):
    said = [(true, found) for true, found in answers if found.trend == word]
    sure = [true for true, found in said if (found.confidence or 0) >= 0.9]
    assert len(sure) >= 80
    assert sum(true != word for true in sure) / len(sure) <= 0.10


def test_a_confidence_is_about_how_often_it_is_right(answers):
    for least, most in ((0.5, 0.7), (0.7, 0.9), (0.9, 1.01)):
        sayings = [
            (true == found.trend, found.confidence)
            for true, found in answers
            if found.confidence is not None and least <= found.confidence < most
        ]
        right, said = np.mean(sayings, axis=0)
        # Two standard errors of the share; more right than said is no fault.
        assert right >= said - 2 * math.sqrt(0.25 / len(sayings)), (least, right, said)


@pytest.mark.parametrize(
    ("rate_per_s", "wrong", "most"),
    [
        # Most curves of a dive may be steady: of these next to none may be taken for another.
        (0.0, (GROWING, SHRINKING), 0.02),
        (-0.2, (GROWING, STEADY), 0.02),
        (0.2, (SHRINKING, STEADY), 0.02),
        (STEADY_PER_S, (GROWING,), 0.17),  # on the border itself either word is a guess
    ],
)
def test_no_truth_is_often_taken_for_another(rate_per_s, wrong, most):
    rng = np.random.default_rng(6)
    found = [answer(curve(rng, rate_per_s)) for _ in range(150)]
    for word in wrong:
        assert share_sure(found, word) <= most


def test_a_slope_through_few_means_is_less_sure():
    """Student's distribution, and not the normal one: five means have three degrees of freedom."""
    rng = np.random.default_rng(10)
    found = [answer(curve(rng, STEADY_PER_S, 8, fps=1.2)) for _ in range(500)]
    sayings = [each for each in found if each.trend is not None]
    assert len(sayings) > 200 and share_sure(sayings, GROWING) <= 0.11


@pytest.mark.parametrize(("rate_per_s", "least_share"), [(0.1, 0.15), (0.2, 0.75), (0.4, 0.95)])
def test_growth_is_found(rate_per_s, least_share):
    """The other half of being honest: a way that never dares to say it would pass all else."""
    rng = np.random.default_rng(8)
    found = [answer(curve(rng, rate_per_s, 15)) for _ in range(100)]
    assert share_sure(found, GROWING) >= least_share


@pytest.mark.parametrize(("rate_per_s", "spread"), [(0.2, 0.35), (0.4, 0.21)])
def test_the_time_to_contact_is_right_within_its_spread(rate_per_s, spread):
    rng = np.random.default_rng(9)
    ratios = []
    for _ in range(100):
        one = curve(rng, rate_per_s, 20)
        found = told(one.times, one.means)[-1]
        if found.contact_s is not None:
            ratios.append(found.contact_s / one.contact_s)
    assert len(ratios) >= 60
    assert np.median(ratios) == pytest.approx(1.0, abs=0.08)
    assert np.mean(np.abs(np.array(ratios) - 1) <= spread) >= 0.9
