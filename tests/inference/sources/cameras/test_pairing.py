"""Pairing: only captures of one moment, each capture once, whatever the clocks and delays."""

import math
import random
from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.inference.reason import Reason
from tokt.inference.sources.cameras.capture import LEFT, RIGHT, Capture
from tokt.inference.sources.cameras.pairing import NOT_FITTED, ClockFit, Moment, Pairer

PERIOD_S = 0.05


def capture(camera: int, moment: int, offset_s: float = 0.0, delay_s: float = 0.001) -> Capture:
    """Of a moment, 100 s after the host's zero; `frame_id` tells which."""
    taken_s = moment * PERIOD_S
    return Capture(camera, moment, taken_s + offset_s, 100 + taken_s + delay_s, 0.0, None)


def pairer(period_s: float | None = None, shared: bool = False) -> Pairer:
    made = Pairer()
    for camera in (LEFT, RIGHT):
        made.present(camera, ClockFit(period_s, shared))
    return made


def feed(to: Pairer, one: Capture) -> list[Moment]:
    if not math.isnan(one.taken_s):
        to.fits[one.camera].add(one)
    return to.add(one)


def run(to: Pairer, captures: list[Capture]) -> list[Moment]:
    """All captures as they arrive, time going on between them, and what is left at the end."""
    moments: list[Moment] = []
    for one in sorted(captures, key=lambda one: one.arrived):
        moments += to.expired(one.arrived)
        moments += feed(to, one)
    return moments + to.expired(math.inf)


def pairs(moments: list[Moment]) -> list[tuple[int, int]]:
    both = [moment for moment in moments if moment.left and moment.right]
    return [(moment.left.frame_id, moment.right.frame_id) for moment in both]


@st.composite
def rigs(draw: st.DrawFn) -> list[Capture]:
    """Two cameras with clocks of their own, that lose captures and deliver with jitter.

    The jitter is under half a period; more than that cannot be told from another moment.
    """
    captures = []
    for camera in (LEFT, RIGHT):
        offset_s = draw(st.floats(0, 1e6))
        for moment in range(draw(st.integers(10, 30))):
            if draw(st.integers(0, 9)):
                delay_s = 0.003 + draw(st.floats(0, 0.45)) * PERIOD_S
                captures.append(capture(camera, moment, offset_s, delay_s))
    return captures


@given(rigs())
@settings(max_examples=scaled(40))
def test_only_captures_of_one_moment_are_paired_and_none_is_lost(captures):
    # Captures of a camera come in order: a later one never overtakes.
    latest = {LEFT: 0.0, RIGHT: 0.0}
    for index, one in enumerate(captures):
        arrived = latest[one.camera] = max(latest[one.camera], one.arrived)
        captures[index] = replace(one, arrived=arrived)
    moments = run(pairer(PERIOD_S), captures)
    assert all(left == right for left, right in pairs(moments))
    given_back = [one for moment in moments for one in (moment.left, moment.right) if one]
    given_back.sort(key=lambda one: (one.camera, one.frame_id))
    assert given_back == captures
    assert all(bool(moment.alone) == (None in (moment.left, moment.right)) for moment in moments)


@given(st.floats(0, 1e5), st.floats(0, 1e5), st.integers(9, 40))
@settings(max_examples=scaled(30))
def test_whole_rigs_are_paired_from_the_eighth_capture_on(left_s, right_s, count):
    captures = [
        capture(camera, moment, offset_s)
        for moment in range(count)
        for camera, offset_s in ((LEFT, left_s), (RIGHT, right_s))
    ]
    moments = run(pairer(), captures)
    assert pairs(moments)[-1:] == [(count - 1, count - 1)]
    assert len(pairs(moments)) >= count - 8
    assert all(moment.alone is NOT_FITTED for moment in moments if moment.alone)


@given(st.floats(-0.49, 0.49), st.floats(0, 3))
@settings(max_examples=scaled(30))
def test_shared_clocks_are_compared_as_they_are_whatever_the_delays(skew, right_delay):
    """By PTP a link of the right camera that is slower by periods changes nothing."""
    right = [capture(RIGHT, n, skew * PERIOD_S, right_delay * PERIOD_S) for n in range(30)]
    left = [capture(LEFT, n) for n in range(30)]
    moments = run(pairer(PERIOD_S, shared=True), left + right)
    assert all(one == other for one, other in pairs(moments))
    if right_delay < 0.9:
        assert len(pairs(moments)) == 30


def test_a_capture_waits_for_the_other_camera_for_a_period_at_most():
    made = pairer(PERIOD_S, shared=True)
    assert feed(made, capture(LEFT, 0)) == []
    due = made.due()
    assert due == 100.001 + PERIOD_S
    assert made.expired(due - 1e-6) == []
    (moment,) = made.expired(due)
    assert moment.left is not None and moment.right is None
    assert moment.alone.reason is Reason.UNPAIRED
    # The right one that comes too late is alone as well, and never paired with the next left.
    feed(made, capture(RIGHT, 0))
    (moment,) = feed(made, capture(LEFT, 1))
    assert moment.left is None and moment.right is not None
    assert pairs(feed(made, capture(RIGHT, 1))) == [(1, 1)]


def test_nothing_waits_for_a_camera_that_is_gone():
    made = pairer(PERIOD_S, shared=True)
    feed(made, capture(LEFT, 0))
    (moment,) = made.absent(RIGHT)
    assert moment.left is not None and moment.right is None
    (moment,) = feed(made, capture(LEFT, 1))
    assert moment.left is not None and moment.right is None and made.due() is None


def test_a_camera_that_began_anew_is_compared_anew():
    """Its clock starts at zero: with the old difference it would be paired with the past."""
    made = pairer()
    run(made, [capture(camera, n) for n in range(12) for camera in (LEFT, RIGHT)])
    anew = [capture(camera, n, -0.4 * camera) for n in range(12, 32) for camera in (0, 1)]
    moments = run(made, anew)
    assert all(left == right for left, right in pairs(moments))
    assert len(pairs(moments)) >= 12


def test_a_link_that_is_slow_for_ten_seconds_makes_no_wrong_pairs():
    """More captures than any window would hold: what was learnt before them is not forgotten."""
    slow = range(100, 300)
    right = [capture(RIGHT, n, delay_s=0.7 * PERIOD_S * (n in slow)) for n in range(400)]
    left = [capture(LEFT, n) for n in range(400)]
    moments = run(pairer(PERIOD_S), left + right)
    assert all(one == other for one, other in pairs(moments))
    assert len(pairs(moments)) >= 390


def test_clocks_that_drift_for_hours_stay_paired():
    """200 ppm apart come to 1.4 s in two hours, three periods; most captures are left out."""
    period_s, count, chance = 0.5, 14_400, random.Random(0)
    captures = [
        Capture(camera, n, n * period_s * rate, n * period_s + chance.uniform(0.002, 0.05), 0, None)
        for n in range(count)
        for camera, rate in ((LEFT, 1 - 1e-4), (RIGHT, 1 + 1e-4))
        if chance.random() < 0.2
    ]
    moments = run(pairer(period_s), captures)
    assert all(one == other for one, other in pairs(moments))
    both = Counter(one.frame_id for one in captures).values()
    assert len(pairs(moments)) >= 0.95 * sum(times == 2 for times in both)


def test_a_clock_set_back_by_less_than_a_period_is_compared_anew():
    captures = [
        capture(camera, n, -0.7 * PERIOD_S if camera and n >= 100 else 0.0)
        for n in range(300)
        for camera in (LEFT, RIGHT)
    ]
    moments = run(pairer(PERIOD_S), captures)
    assert all(one == other for one, other in pairs(moments))
    assert len(pairs(moments)) >= 270


def test_a_capture_without_a_time_is_of_no_pair():
    made = pairer(PERIOD_S, shared=True)
    feed(made, capture(LEFT, 0))
    (moment,) = feed(made, replace(capture(RIGHT, 0), taken_s=math.nan))
    assert moment.left is None and moment.alone.reason is Reason.UNPAIRED
    assert math.isnan(moment.at)


def test_what_waits_is_bounded():
    """Should nobody ask what has expired, no more than four captures wait."""
    made = pairer(PERIOD_S, shared=True)
    settled = [moment for n in range(100) for moment in feed(made, capture(LEFT, n))]
    assert [moment.left.frame_id for moment in settled if moment.left] == list(range(96))


@pytest.mark.parametrize("nominal", [None, math.nan])
@given(st.lists(st.integers(1, 5), min_size=1, max_size=30))
@settings(max_examples=scaled(30))
def test_the_period_is_found_where_captures_are_left_out(nominal, steps):
    fit, moment, left_out = ClockFit(nominal), 0, 0
    fit.add(capture(LEFT, 0))
    for step in steps:
        moment += step
        left_out += fit.add(capture(LEFT, moment))
    assert fit.period_s is not None and math.isclose(fit.period_s, PERIOD_S)
    assert left_out == sum(steps) - len(steps)


@given(st.lists(st.integers(1, 5), min_size=3, max_size=30))
@settings(max_examples=scaled(30))
def test_a_period_is_never_taken_for_longer_than_the_nominal_one(steps):
    """A camera that numbers what it delivers hides that exposures are left out."""
    fit, moment = ClockFit(PERIOD_S), 0
    for number, step in enumerate(steps):
        moment += step
        fit.add(replace(capture(LEFT, moment), frame_id=number))
    assert fit.period_s is not None and fit.period_s <= PERIOD_S * (1 + 1e-9)
