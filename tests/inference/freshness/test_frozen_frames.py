from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tokt.features.frames.mission import LEFT, RIGHT, open_mission
from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.freshness.frozen_frames import REMEMBERED, StuckFrameDetector
from tokt.inference.reason import Reason

from ..still_water import (
    RNG,
    dithered,
    filtered_in_time,
    flickering,
    jpeg,
    light,
    moved,
    water,
    with_bit,
    with_clock,
)

START = RNG.bit_generator.state
HEIGHT, WIDTH = 270, 480
LIGHT = light(60, 20, HEIGHT, WIDTH)


@pytest.fixture(autouse=True)
def the_same_noise_whatever_was_tested_before():
    RNG.bit_generator.state = START


def noise() -> NDArray[np.uint8]:
    return RNG.integers(0, 255, (100, 60), np.uint8)


def faults(pictures) -> list[str]:
    watch = StuckFrameDetector(Limits())
    seen = [watch.remove(Frame(number, 0.0, one, None)) for number, one in enumerate(pictures)]
    assert all((frame.left is None) == bool(frame.left_fault) for frame in seen)
    return [str(frame.left_fault) for frame in seen]


def test_a_picture_that_is_repeated_too_often_is_taken_away():
    watch, same = StuckFrameDetector(Limits(frozen_repeats=5)), noise()
    seen = [watch.remove(Frame(number, 0.0, same.copy(), None)) for number in range(8)]
    assert [frame.left is None for frame in seen] == [False] * 6 + [True] * 2
    assert seen[6].left_fault.reason is Reason.FROZEN and "6 times" in seen[6].left_fault
    moved = watch.remove(Frame(9, 0.0, noise(), None))
    assert moved.left is not None and not moved.left_fault


def test_a_picture_is_no_younger_for_being_repeated():
    watch, same = StuckFrameDetector(Limits(stale_s=0.5)), noise()
    times = (10.0, 10.3, 10.5, 10.6)
    seen = [watch.remove(Frame(1, 0.0, same.copy(), None, timed=True, arrived=t)) for t in times]
    assert [frame.left is None for frame in seen] == [False, False, False, True]
    untimed = StuckFrameDetector(Limits(stale_s=0.5))
    kept = [untimed.remove(Frame(1, 0.0, same, None, arrived=t)) for t in times]
    assert all(frame.left is not None for frame in kept)


@pytest.mark.parametrize("side", ["left", "right"])
def test_each_camera_freezes_for_itself(side):
    watch, same = StuckFrameDetector(Limits(frozen_repeats=1)), noise()
    for _ in range(4):
        left, right = (same, noise()) if side == "left" else (noise(), same)
        frame = watch.remove(Frame(1, 0.0, left, right))
    other = "right" if side == "left" else "left"
    assert getattr(frame, side) is None and getattr(frame, other) is not None
    assert side in getattr(frame, f"{side}_fault")


@pytest.mark.parametrize("buffers", [2, 4, 8, 16, REMEMBERED])
def test_buffers_that_go_round_are_told_from_the_first_that_comes_again(buffers):
    ring = [water(LIGHT) for _ in range(buffers)]
    told = faults([ring[number % buffers] for number in range(3 * buffers)])
    assert not any(told[:buffers]) and all("again" in one for one in told[buffers:])
    assert not faults([*ring, ring[0], water(LIGHT)])[-1]  # and it is over with a new picture


@pytest.mark.parametrize("buffers", [2, 4, 20])
@pytest.mark.parametrize("change", ["dithered", "compressed otherwise each time"])
def test_buffers_that_go_round_are_told_where_each_picture_is_changed_as_well(buffers, change):
    before, ring = ([water(LIGHT, 1.5) for _ in range(n)] for n in (4, buffers))
    pictures = [AT_ONCE[change](ring[number % buffers], number) for number in range(3 * buffers)]
    told = faults([*before, *pictures, water(LIGHT, 1.5)])
    assert not any(told[: 4 + buffers]) and all(told[4 + buffers : -1]) and not told[-1]


@pytest.mark.parametrize(
    ("gain", "change"), [(0.3, "one bit"), (0.5, "one bit"), (0.7, "zoomed"), (0.85, "zoomed")]
)
def test_a_camera_that_filters_its_noise_in_time_is_not_frozen_and_then_is(gain, change):
    pictures = filtered_in_time((water(LIGHT, 1.5) for _ in range(40)), gain)
    told = faults([*pictures, *(AT_ONCE[change](pictures[-1], number) for number in (1, 2, 3))])
    assert not any(told[:40]) and all(told[40:])


@pytest.mark.parametrize("length", [100, REMEMBERED])
@pytest.mark.parametrize("change", ["dithered", "with grain"])
def test_a_loop_is_told_where_each_picture_of_it_gets_fresh_noise(length, change):
    loop = [water(LIGHT, 1.5) for _ in range(length)]
    again = [AT_ONCE[change](loop[number], number) for number in range(12)]
    told = faults([*loop, *again])
    assert not any(told[:length]) and all(told[length:])


@cache
def roughness(number) -> NDArray[np.float64]:
    """Of a finely textured wall, twice as rough as noise."""
    rough = np.random.default_rng(number).normal(0, 1, (HEIGHT + 60, WIDTH + 60))
    smooth = cv2.GaussianBlur(rough, (0, 0), 0.7)
    return 2.0 / smooth.std() * smooth


def wall(number, moved_px, share=1.0) -> NDArray[np.uint8]:
    """A wall, of which a share is in the picture."""
    shift = np.float64([[1, 0, -moved_px], [0, 1, -moved_px / 2]])
    seen = cv2.warpAffine(roughness(number), shift, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    return water(LIGHT + share * seen)


@pytest.mark.parametrize("number", range(2))
@pytest.mark.parametrize(
    ("slows", "rest_px"), [(0.0, 0.1), (0.5, 0.1), (0.5, 0.0), (0.75, 0.1), (0.75, 0.0)]
)
def test_a_wall_before_a_vehicle_on_station_is_no_frozen_picture(number, slows, rest_px):
    """It comes into view; the vehicle stops at once or slowly, then drifts a little or not."""
    places = np.cumsum([2.5] * 10 + [rest_px + 2.5 * slows**n for n in range(1, 30)])
    before = [water(LIGHT) for _ in range(12)]
    pictures = [wall(number, at, min(n / 10, 1.0)) for n, at in enumerate(places)]
    told = faults([*before, *pictures, pictures[-3], pictures[-2]])
    assert not any(told[:-2]) and all("earlier picture again" in words for words in told[-2:])


LAMP = np.where(
    light(1, 0, HEIGHT, WIDTH) > 0.825, 40.0, -20.0
)  # a quarter of the picture is lit, the rest black


@pytest.mark.parametrize(
    ("part", "rough"),
    [
        (np.s_[: HEIGHT // 3], 0.5),
        (np.s_[:, : WIDTH // 4], 0.3),
        (np.s_[: HEIGHT // 3, : WIDTH // 2], 0.5),
    ],
)
def test_a_part_of_the_view_that_is_as_fine_as_noise_is_no_frozen_picture(part, rough):
    """A vehicle hovers in a current before what a part of its view shows now and then."""
    there = np.zeros(LIGHT.shape)
    there[part] = rough * roughness(0)[:HEIGHT, :WIDTH][part]
    pictures = [water(LIGHT + there * (number % 9 > 5)) for number in range(60)]
    pictures += [water(LIGHT) for _ in range(10)]
    told = faults([*pictures, *(dithered(pictures[-1]) for _ in range(4))])
    assert not any(told[:70]) and all(told[70:])


@pytest.mark.parametrize("speed_px", [25.0, 5.0])
def test_a_wall_that_moves_fast_and_then_not_at_all_is_no_frozen_picture(speed_px):
    places = np.cumsum([speed_px / 10] * 8 + [speed_px / 5] * 4 + [0.1] * 10)
    assert not any(faults(wall(0, at) for at in places))


@pytest.mark.parametrize("quieter", [LIGHT, LAMP])
@pytest.mark.parametrize("seen", [LIGHT, LAMP])
@pytest.mark.parametrize("change", ["dithered", "compressed otherwise each time"])
def test_one_quieter_picture_of_before_hides_no_frozen_one(quieter, seen, change):
    first = jpeg(water(quieter, 1.5), 80)
    before, ring = ([water(seen, 1.5) for _ in range(n)] for n in (11, 4))
    pictures = [AT_ONCE[change](one, number) for number, one in enumerate(before)]
    again = [AT_ONCE[change](ring[number % 4], number) for number in range(12)]
    told = faults([first, *pictures, *again])
    assert not any(told[:16]) and all(told[16:])


def test_a_picture_repeated_within_the_limits_is_no_ring():
    pictures = [water(LIGHT) for _ in range(20)]
    assert not any(faults([one for one in pictures for _ in range(1 + Limits().frozen_repeats)]))


AT_ONCE = {
    "one bit": with_bit,
    "a clock in the corner": with_clock,
    "a clock, compressed": lambda picture, number: jpeg(with_clock(picture, number), 90),
    "compressed otherwise each time": lambda picture, number: jpeg(
        picture, (95, 90, 85, 80)[number % 4]
    ),
    "dithered": lambda picture, number: dithered(picture),
    "dithered and compressed": lambda picture, number: jpeg(dithered(picture), 90),
    "flickering": flickering,
    "rolling down": lambda picture, number: np.roll(picture, number, 0),
    "rolling sideways": lambda picture, number: np.roll(picture, number, 1),
    "panned by parts of a pixel": lambda picture, number: moved(picture, 0.3 * number, number / 9),
    "panned on and on": lambda picture, number: moved(picture, 7.3 * number, -2.6 * number),
    "zoomed": lambda picture, number: moved(picture, zoom=1 + 0.003 * number),
    "stabilised": lambda picture, number: moved(picture, *RNG.normal(0, 2, 2), RNG.normal(0, 0.05)),
    "with grain": lambda picture, number: water(picture.astype(np.float64), 3.0),
    "panned, with grain": lambda picture, number: water(
        moved(picture, 0.3 * number, 0.1 * number).astype(np.float64)
    ),
    "its lower half": lambda picture, number: np.vstack([water(LIGHT)[:135], picture[135:]]),
    "its left half": lambda picture, number: np.hstack([picture[:, :240], water(LIGHT)[:, 240:]]),
    "nine tenths of it": lambda picture, number: np.vstack([water(LIGHT)[:27], picture[27:]]),
    "a row of tiles": lambda picture, number: np.vstack(
        [water(LIGHT)[:81], picture[81:108], water(LIGHT)[108:]]
    ),
}


@pytest.mark.parametrize(
    ("change", "colour"),
    [*((change, False) for change in AT_ONCE), ("dithered", True), ("rolling down", True)],
)
def test_a_frozen_picture_that_is_changed_is_told_at_once(change, colour):
    before = [water(LIGHT, 1.5) for _ in range(4)]
    pictures = before + [AT_ONCE[change](before[-1], number) for number in range(1, 13)]
    if colour:
        pictures = [np.dstack([one, one, one]) for one in pictures]
    told = faults([*pictures, *(water(LIGHT, 1.5) for _ in range(2 * (not colour)))])
    assert not any(told[:4]) and all(told[4:16]), told
    assert not any(told[16:])


def test_what_cannot_be_told_from_a_new_picture():
    """The limits that the module names, so that nobody takes them for something that is seen."""
    before = [water(LIGHT) for _ in range(4)]
    noisy = [water(before[-1].astype(np.float64), 40.0) for _ in range(6)]
    ring = [water(LIGHT) for _ in range(REMEMBERED + 1)]
    assert not any(faults(before + noisy)) and not any(faults(ring * 2))


@pytest.mark.parametrize("shape", [(1, 1), (1, 400), (400, 1), (3, 5, 3), (40, 50, 3)])
def test_pictures_of_any_size_are_looked_at(shape):
    pictures = [RNG.integers(0, 255, shape, np.uint8) for _ in range(3)]
    assert faults([*pictures, pictures[-1], *[noise()] * 8])[-1]


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("place", [np.s_[HEIGHT // 2], np.s_[:, WIDTH // 2]])
def test_a_line_drawn_through_the_middle_of_each_picture_is_no_picture_that_moved(place, colour):
    pictures = [water(LIGHT) for _ in range(6)]
    for picture in pictures:
        picture[place] = 255
    if colour:
        pictures = [np.dstack([one, one, one]) for one in pictures]
    assert not any(faults(pictures))


def test_what_is_no_picture_is_left_to_others():
    for odd in (np.zeros((4, 4), np.float32), np.zeros((9, 9, 1), np.uint8)):
        assert not any(faults([odd] * 9))


@pytest.mark.study
@pytest.mark.parametrize("sigma", [0.7, 3.0])
def test_thousands_of_pictures_of_still_water_are_all_new(sigma):
    rng, still = np.random.default_rng(5), light(40, 6, 120, 160)
    pictures = (water(still, sigma, rng) for _ in range(2_500))
    assert not any(faults(pictures))


@pytest.mark.study
@pytest.mark.parametrize("quality", [75, 85, 95])
@pytest.mark.parametrize("levels", [(60, 20), (12, 2)])
@pytest.mark.parametrize("sigma", [0.7, 1.5, 3.0])
def test_compressed_still_water_is_new_each_time(quality, levels, sigma):
    still, rng = light(*levels, 271, 360), np.random.default_rng(6)
    assert not any(faults(jpeg(water(still, sigma, rng), quality) for _ in range(40)))


@pytest.mark.mission
@pytest.mark.study
@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_all_frames_of_the_real_mission_are_new_and_frozen_ones_are_not(mission, side):
    dive = open_mission(mission)
    pictures = [dive.read(number, side) for number in dive.frames(side)]
    assert len(pictures) == 246 and not any(faults(pictures))
    before, frozen = pictures[150:160], pictures[159]
    for change in ("one bit", "a clock in the corner", "dithered", "flickering", "rolling down"):
        told = faults([*before, *(AT_ONCE[change](frozen, number) for number in range(1, 5))])
        assert not any(told[:10]) and all(told[10:]), change
    qualities = (95, 75, 90, 85, 78, 93)
    assert all(faults([*before, *(jpeg(frozen, quality) for quality in qualities)])[10:])
