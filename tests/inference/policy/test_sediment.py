"""A cloud of sediment in the water, and what looks a little like one."""

import math
from functools import lru_cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.inference.swimming import HEIGHT, STEP_S, WIDTH, Told, frame, texture
from tests.tiers import scaled
from tokt.inference.policy.moving import MovingThings
from tokt.inference.policy.sediment import FRAMES, LEARNT_FRAMES, SedimentWatch
from tokt.inference.reason import Reason
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN

AWAY = np.hypot(*(np.mgrid[:HEIGHT, :WIDTH] / WIDTH - 0.4))
ASIDE = np.hypot(*(np.mgrid[:HEIGHT, :WIDTH] / WIDTH - 0.2))
"""From about the middle, and from beside it, in widths of the picture."""


@lru_cache(100)
def water(number, level=40.0, snow=60):
    """Open water, brighter where the lamp shines, with snow and a camera's noise: float64."""
    rng = np.random.default_rng(number)
    light = level * (0.4 + np.exp(-4 * AWAY**2))
    bright = np.zeros((HEIGHT, WIDTH))
    bright[rng.integers(0, HEIGHT, snow), rng.integers(0, WIDTH, snow)] = 1.5
    return light * (1 + cv2.GaussianBlur(bright, (0, 0), 1.0)) + rng.normal(0, 1.0, light.shape)


def in_cloud(picture, thick, wide=0.5):
    """The same through sediment: what is behind is dimmed, and the sediment shines."""
    through = np.exp(-thick * np.exp(-((ASIDE / wide) ** 2)))
    return picture * through + 90 * (1 - through)


def pixels(picture):
    return np.clip(picture, 0, 255).astype(np.uint8)


def told(pictures, nothing_seen=True, t_s=lambda number: STEP_S * number):
    """What a watch says of pictures after a while of clear water."""
    watch = SedimentWatch()
    shown = [water(number) for number in range(LEARNT_FRAMES + 2)]
    said = [watch.take(pixels(each), True, t_s(n)) for n, each in enumerate(shown)]
    assert not any(said)
    later = enumerate(pictures, len(shown))
    return [watch.take(pixels(each), nothing_seen, t_s(number)) for number, each in later]


@given(st.integers(0, 10_000), st.floats(0.6, 3.0), st.floats(0.4, 0.9))
@settings(max_examples=scaled(20))
def test_a_cloud_is_told_and_so_is_its_end(seed, thick, wide):
    clouds = [in_cloud(water(seed + number), thick, wide) for number in range(12)]
    clear = [water(seed + 100 + number) for number in range(FRAMES + 2)]
    said = told([*clouds, *clear])
    assert [fault.reason for fault in said[:12]] == [Reason.SEDIMENT] * 12
    # A frame more than a few without it are no cloud.
    assert all(said[12 : 12 + FRAMES - 1]) and not any(said[12 + FRAMES :])


@pytest.mark.parametrize("time", [lambda number: None, {3: math.nan}.get], ids=["none", "nan"])
def test_times_are_not_needed(time):
    assert all(told([in_cloud(water(number), 1.0) for number in range(5)], t_s=time))


@pytest.mark.parametrize(
    "change",
    {
        "more light": lambda picture: 1.6 * picture,
        "less light": lambda picture: 0.5 * picture,
        "turned": lambda picture: np.roll(picture, 20, axis=1),
        "more snow": lambda picture: picture + water(5, snow=600) - water(5),
        "a textured thing": lambda picture: np.where(
            AWAY < 0.3, 90 + 20 * texture(1, 2.0)[:HEIGHT, :WIDTH], picture
        ),
        "a small cloud": lambda picture: in_cloud(picture, 1.0, 0.12),
    }.items(),
    ids=lambda change: change[0],
)
def test_what_is_no_cloud(change):
    assert not any(told([change[1](water(number)) for number in range(12)]))


def test_slow_changes_of_the_light_are_the_water():
    said = told(in_cloud(water(number), number / 400) for number in range(200))
    assert not any(said)


def test_a_lamp_that_was_turned_is_no_cloud_for_ever():
    turned = in_cloud(water(1), 0.5)
    said = told((turned + number % 2 for number in range(700)), t_s=float)
    assert all(said[:100]) and not any(said[-10:])


def test_what_is_seen_in_a_cloud_is_an_obstacle():
    assert not any(told([in_cloud(water(number), 1.0) for number in range(5)], nothing_seen=False))
    policy = MovingThings(says := Told())
    statuses = []
    for number in range(24):
        picture = water(number) if number < 12 else in_cloud(water(number), 1.0)
        says.mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        says.mask[:80, :80] = 255 * (number >= 18)
        verdict = policy.judge(frame(number, pixels(picture))).verdict
        statuses.append((verdict.status, verdict.reason))
    ok = Reason.OK
    assert statuses == [(CLEAR, ok)] * 12 + [(UNKNOWN, Reason.SEDIMENT)] * 6 + [(OBSTACLE, ok)] * 6


@pytest.mark.parametrize(
    ("reason", "becomes"),
    [
        *((Reason.DRIFT, Reason.SEDIMENT), (Reason.NOVEL, Reason.SEDIMENT)),
        *((Reason.LATE, Reason.LATE), (Reason.FRAME_RULE, Reason.FRAME_RULE)),
    ],
)
def test_why_nothing_was_judged(reason, becomes):
    policy = MovingThings(says := Told())
    for number in range(14):
        cloud = number >= 12
        says.more = {"status": UNKNOWN, "reason": reason, "health": "so"} if cloud else {}
        picture = in_cloud(water(number), 1.0) if cloud else water(number)
        verdict = policy.judge(frame(number, pixels(picture))).verdict
    assert (verdict.status, verdict.reason) == (UNKNOWN, becomes)
    assert verdict.health.endswith("so")
