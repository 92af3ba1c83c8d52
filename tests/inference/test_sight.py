"""What is seen of a frame: faults of every kind on drawn water of a camera, and untouched water."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import refuses
from tests.inference.test_faults import hold_row
from tests.tiers import scaled
from tokt.features.extractors.patch_detail import MEASURES, patch_detail
from tokt.inference.frame import Frame, shape_fault
from tokt.inference.reason import Reason
from tokt.inference.sight import SightMap, SightMeter, stereo_meter
from tokt.models.sight import (
    SightLimits,
    joined_sight,
    measure_sight,
    sight_from_json,
    sight_to_json,
)

HEIGHT, WIDTH = 480, 640
SIGMA_PX = WIDTH / 68


@cache
def layers(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Noise as demosaicing leaves it, and what water shows: unevenness and specks."""
    rng = np.random.default_rng(seed)
    noise, uneven = (rng.normal(0, 1, (HEIGHT, WIDTH, 3)) for _ in range(2))
    specks = rng.random((HEIGHT, WIDTH, 1)) < 0.002
    seen = cv2.GaussianBlur(uneven, (0, 0), 5) * 6 + cv2.GaussianBlur(
        specks * np.full(3, 40.0), (0, 0), 1.5
    )
    return cv2.GaussianBlur(noise, (0, 0), 0.8) * 1.5, seen


def fall_of_light() -> np.ndarray:
    y, x = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j]
    return (60 - 15 * (x**2 + y**2))[..., None]


def rounded(picture: np.ndarray) -> np.ndarray:
    return np.asarray(picture.round().clip(0, 255), np.uint8)


def water(seed: int = 0) -> np.ndarray:
    """Open water as a camera gives it."""
    noise, seen = layers(seed)
    return rounded(fall_of_light() + seen + noise)


@cache
def limits() -> tuple[SightLimits, ...]:
    return measure_sight(water(seed) for seed in range(20))


def look(picture: np.ndarray) -> SightMap:
    return SightMeter(limits()).measure(picture)


def white(seed: int, sigma: float) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, sigma, (HEIGHT, WIDTH, 3))


def part(change):
    """The same in the left two thirds alone."""

    def changed(picture: np.ndarray) -> np.ndarray:
        picture = picture.copy()
        picture[:, : 2 * WIDTH // 3] = change(picture)[:, : 2 * WIDTH // 3]
        return picture

    return changed


def blurred(picture: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), SIGMA_PX))


def stretched(picture: np.ndarray, axis: int = 0) -> np.ndarray:
    picture = np.swapaxes(picture, 0, axis).copy()
    picture[len(picture) // 3 :] = picture[len(picture) // 3]
    return np.ascontiguousarray(np.swapaxes(picture, 0, axis))


def combed(picture: np.ndarray) -> np.ndarray:
    picture = picture.copy()
    picture[1::2] = np.roll(picture, 40, axis=1)[1::2]
    return picture


NOISE = {Reason.BLANK, Reason.DAMAGED}
FAULTS = {
    "grease on the port": (part(blurred), Reason.BLURRED),
    "out of focus": (blurred, Reason.BLURRED),
    "fog, with the camera's own light kept": (
        lambda picture: rounded(fall_of_light() + white(3, 1.5)),
        Reason.BLANK,
    ),
    "fog that noise lies on": (
        part(lambda picture: rounded(blurred(picture) + white(4, 1.2))),
        NOISE,
    ),
    "a row that goes on to the end": (stretched, Reason.DAMAGED),
    "the same under noise": (lambda picture: rounded(stretched(picture) + white(5, 1.2)), NOISE),
    "a column that goes on to the end": (
        lambda picture: stretched(picture, axis=1),
        Reason.DAMAGED,
    ),
    "moved while exposed": (
        lambda picture: rounded(cv2.blur(picture, (31, 1)) + white(6, 1.2)),
        NOISE,
    ),
    "moved while exposed, without noise": (
        lambda picture: cv2.blur(picture, (31, 31)),
        Reason.BLURRED,
    ),
    "rows of two moments": (combed, Reason.DAMAGED),
    "half the contrast under noise": (
        lambda picture: rounded((picture - 50.0) * 0.5 + 50 + white(7, 1.2)),
        NOISE,
    ),
    "enlarged": (
        lambda picture: cv2.resize(picture, None, fx=2, fy=2)[:HEIGHT, :WIDTH],
        Reason.BLURRED,
    ),
    "black": (np.zeros_like, Reason.DARK),
    "the lamps are out": (lambda picture: rounded(1 + white(8, 1)), Reason.DARK),
    "white": (lambda picture: np.full_like(picture, 255), Reason.SATURATED),
    "noise hides that it is white": (lambda picture: rounded(262 + white(9, 15)), Reason.SATURATED),
    "one grey": (lambda picture: np.full_like(picture, 90), Reason.BLANK),
    "a part of one grey": (part(lambda picture: np.full_like(picture, 90)), Reason.BLANK),
    "snow instead of a picture": (lambda picture: rounded(128 + white(10, 40)), Reason.BLANK),
    "haze": (lambda picture: rounded(picture * 0.3 + 60), Reason.BLURRED),
}


@pytest.mark.parametrize("seed", range(20, 40))
def test_untouched_water_is_seen(seed):
    found = look(water(seed))
    assert found.share >= 0.98 and found.fault == ""


@pytest.mark.parametrize("fault", FAULTS)
def test_what_hides_a_view_is_told_with_its_cause_and_its_place(fault):
    change, reason = FAULTS[fault]
    found = look(change(water(50)))
    reasons = reason if isinstance(reason, set) else {reason}
    assert found.fault.reason in reasons, found.fault
    assert found.share < 0.6
    at_the_left = (
        change(water(50))[:, -WIDTH // 4 :].tolist() == water(50)[:, -WIDTH // 4 :].tolist()
    )
    assert ("at the left" in found.fault) == at_the_left


@pytest.mark.parametrize("fault", ["one grey", "black", "white", "snow instead of a picture"])
def test_where_there_is_no_picture_nothing_is_found_either(fault):
    assert look(FAULTS[fault][0](water(50))).is_blind
    assert not look(FAULTS["out of focus"][0](water(50))).is_blind


def test_things_with_texture_are_seen():
    picture = water(60)
    rng = np.random.default_rng(1)
    for top in range(0, HEIGHT, 120):
        thing = cv2.resize(rng.uniform(20, 200, (20, 30, 3)), (150, 110))
        picture[top : top + 110, 200:350] = rounded(thing + layers(61)[0][:110, :150])
    assert look(picture).fault == ""


def test_few_and_scattered_patches_are_allowed_to_be_unseen():
    def fault(*cells: tuple[int, int]) -> str:
        causes = np.zeros((10, 10), np.uint8)
        for cell in cells:
            causes[cell] = 5
        return SightMap(causes).fault

    scattered = [(row, 9 - row) for row in range(10)]
    assert fault() == fault((0, 0)) == fault(*scattered[:3], *scattered[7:]) == ""
    together = [(0, column) for column in range(6)]
    assert fault(*together[:5]) == ""
    assert "blurred: 6 of 100 patches are not seen, 6 of them together, above" in fault(*together)
    assert "11 of 100" in fault(
        *scattered[:3], *scattered[7:], (0, 0), (2, 2), (7, 7), (9, 9), (0, 5)
    )
    middle = [(4, 4), (5, 5), (4, 6), (6, 4)]
    assert fault(*middle[:3]) == "" and fault(*middle)


def test_a_verdict_has_the_share_and_the_largest_group():
    causes = np.zeros((10, 10), np.uint8)
    causes[2:4, 5:9] = causes[9, 0] = 3
    assert SightMap(causes).to_fields() == {"seen": (0.91,), "blind": (0.5, 0.2, 0.4, 0.2)}
    assert SightMap(np.zeros((10, 10), np.uint8)).to_fields() == {"seen": (1.0,)}


def test_a_picture_is_looked_at_once_for_all_detectors():
    meter, picture = SightMeter(limits()), water(70)
    frame = Frame(1, 0.0, picture, picture)
    assert meter.of(frame) is meter.of(replace(frame, missed=3))
    assert meter.of(frame) is not meter.of(frame, "right")
    assert meter.of(replace(frame, left=picture.copy())) is not meter.of(frame)


def test_the_next_picture_may_come_in_the_same_memory():
    meter, picture = SightMeter(limits()), water(71)
    assert meter.of(Frame(1, 0.0, picture, None)).fault == ""
    picture[:] = blurred(picture)
    assert meter.of(Frame(2, 0.1, picture, None)).fault.reason is Reason.BLURRED


@given(
    st.tuples(st.integers(1, 300), st.integers(1, 300)),
    st.sampled_from([(), (3,)]),
    st.integers(0, 255),
)
@settings(max_examples=scaled(60))
def test_any_picture_has_a_map(size, channels, level):
    picture = np.full((*size, *channels), level, np.uint8)
    for meter in (SightMeter(), SightMeter(limits()), stereo_meter()):
        found = meter.measure(picture)
        assert found.causes.shape == (10, 10)
        assert found.fault == "" or found.fault.reason in (
            *(Reason.DARK, Reason.SATURATED, Reason.BLANK),
        )


@pytest.mark.parametrize("shape", [(1, 4000), (3, 4000, 3), (400_000, 400)])
def test_a_picture_of_no_camera_s_shape_is_not_measured(shape):
    assert patch_detail(np.zeros(shape, np.uint8)) is None
    assert not SightMeter().measure(np.zeros(shape, np.uint8)).causes.any()


def test_what_is_no_picture_of_8_bits_cannot_be_judged():
    for shape, kind in (((200, 300), "u2"), ((0, 300), "u1"), ((200, 300, 4), "u1")):
        assert "8 bits" in shape_fault(np.zeros(shape, kind))


def test_training_frames_without_fine_detail_make_a_model_blind():
    """What compression of a video leaves."""
    smooth = [cv2.GaussianBlur(water(seed), (0, 0), 6) for seed in range(80, 86)]
    (compressed,), (sharp,) = measure_sight(smooth), limits()
    assert compressed.blind and not sharp.blind and sharp.blurred > 0.99


def test_each_size_of_the_training_frames_has_its_limits():
    small = [cv2.resize(water(seed), (320, 240)) for seed in range(3)]
    found = measure_sight([*small, water(0), np.zeros((8, 8), np.uint8)])
    assert [(each.width, each.height) for each in found] == [(320, 240), (640, 480)]
    assert sight_from_json(sight_to_json(found)) == found


def test_limits_of_further_frames_replace_those_of_their_size():
    """What passes the higher limits of two cameras may pass neither's own."""
    known = measure_sight(map(water, range(24)))
    small = [cv2.resize(water(seed), (320, 240)) for seed in range(24)]
    measured = measure_sight(small)
    assert joined_sight(known, measured) == (*measured, *known)
    dim = measure_sight([np.asarray(water(seed) * 0.8, np.uint8) for seed in range(24)])
    assert joined_sight((*measured, *known), dim) == (*measured, *dim)
    assert joined_sight((), measured) == measured and joined_sight(known, ()) == known


def test_of_few_frames_the_least_contrast_is_that_of_the_model():
    known = measure_sight(map(water, range(24)))
    few = measure_sight([water(seed) for seed in range(3)])
    assert few[0].least_contrast == 0 < known[0].least_contrast
    (found,) = joined_sight(known, few)
    assert found == replace(few[0], least_contrast=found.least_contrast)
    assert 0 < found.least_contrast <= known[0].least_contrast
    murky = measure_sight([rounded(40 + 0.3 * (water(seed) - 40.0)) for seed in range(3)])
    (found,) = joined_sight(known, murky)
    assert 0 < found.least_contrast < murky[0].contrast


def test_numbers_of_sight_that_are_none_are_refused():
    good = sight_to_json(limits())
    (size,) = good["sizes"]
    for odd, words in (
        ({"format": 3, "sizes": []}, "format 3"),
        ({"format": 2, "sizes": [{**size, "least_contrast": 9.0}]}, "contrast"),
        ({"format": 2, "sizes": [{**size, "contrast": float("inf")}]}, "contrast"),
        ({"format": 1}, "other entries"),
        ({"format": 1, "sizes": [{}]}, "other entries"),
        ({"format": 1, "sizes": [{**size, "limits": {}}]}, "other entries"),
        ({"format": 1, "sizes": [{**size, "darkest": 300}]}, "level"),
        ({"format": 1, "sizes": [{**size, "darkest": "4"}]}, "numbers"),
        ({"format": 1, "sizes": [{**size, "width": 0}]}, "size"),
        ({"format": 1, "sizes": [{**size, "blurred": float("nan")}]}, "numbers"),
        ([], "other entries"),
    ):
        refuses(words, sight_from_json, odd)
    assert set(size["limits"]) == set(MEASURES)


def test_numbers_of_the_first_format_have_no_contrast():
    """What bundles of before hold."""
    value = sight_to_json(limits())
    (size,) = value["sizes"]
    old = {name: size[name] for name in size if name not in ("contrast", "least_contrast")}
    (found,) = sight_from_json({"format": 1, "sizes": [old]})
    assert found == replace(limits()[0], contrast=0.0, least_contrast=0.0)
    meter = SightMeter([found])
    assert "visibility" not in meter.of(Frame(1, 0.0, water(1), None)).to_fields()


def turbid(picture: np.ndarray, part: float, seed: int) -> np.ndarray:
    """Water that lets a part of the contrast through, with the camera's own noise on it."""
    noise, _ = layers(seed)
    light = fall_of_light()
    return rounded(light + (picture - light) * part + noise * np.sqrt(1 - part**2))


def visibilities(change, meter: SightMeter | None = None) -> list[SightMap]:
    meter = meter or SightMeter(limits())
    return [
        meter.of(Frame(seed, float(seed), change(water(seed), seed), None))
        for seed in range(100, 120)
    ]


def test_rows_of_two_moments_are_not_clear():
    found = [look(combed(water(seed))).fault for seed in range(120, 126)]
    assert {fault.reason for fault in found} == {Reason.DAMAGED}
    hold_row(
        "interlaced: every other row is of another moment", "unknown `damaged`", "frames by reason"
    )


def test_a_torn_picture_shows_what_two_moments_show():
    """One edge alone hides nothing."""
    for seed in range(126, 132):
        torn = water(seed)
        torn[HEIGHT // 3 :] = water(seed + 1)[HEIGHT // 3 :]
        assert not look(torn).fault
    hold_row(
        "a torn picture: its lower rows are of the frame before",
        "as without it, or an obstacle at its edge",
        "nothing",
    )


GAMMA_HALF = np.rint(255 * (np.arange(256) / 255) ** 0.5).astype(np.uint8)
LOW_CONTRAST = {
    "water that lets half of the contrast through": (
        lambda one, seed: turbid(one, 0.5, seed),
        ["visibility", "damaged", "blank"],
    ),
    "another tone curve (gamma 0.5)": (
        lambda one, seed: cv2.LUT(one, GAMMA_HALF),
        ["visibility", "blurred"],
    ),
}


@pytest.mark.parametrize("fault", LOW_CONTRAST)
def test_low_contrast_is_told_and_not_clear(fault):
    change, reasons = LOW_CONTRAST[fault]
    usual, low = visibilities(lambda one, seed: one), visibilities(change)
    assert all(0.9 < one.visibility < 1.1 and not one.fault for one in usual)
    assert all(one.visibility < 0.7 for one in low)
    assert {one.fault.reason for one in low} <= set(reasons)
    assert all(one.to_fields()["visibility"] == (round(one.visibility, 2),) for one in low)
    *first, last = (f"`{reason}`" for reason in reasons)
    said = f"unknown {', '.join(first)} or {last}"
    hold_row(fault, said, "frames by reason; `visibility`")


def gamma(power: float):
    levels = np.rint(255 * (np.arange(256) / 255) ** power).astype(np.uint8)
    return lambda one, seed: cv2.LUT(one, levels)


def test_low_contrast_alone_is_not_clear():
    """Where each patch has detail enough for its noise."""
    low = visibilities(gamma(0.7))
    assert {one.fault.reason for one in low} == {Reason.VISIBILITY}
    assert "contrast is 0.73 of the training frames'" in low[-1].fault


def test_visibility_is_that_of_the_last_frames():
    meter = SightMeter(limits())
    visibilities(lambda one, seed: one, meter)
    last = visibilities(gamma(0.7), meter)
    assert last[0].visibility > 0.95 and last[-1].visibility < 0.75
    assert not last[0].fault and last[-1].fault.reason is Reason.VISIBILITY
    # A lamp that is out says nothing of the water.
    dark = meter.of(Frame(200, 200.0, np.zeros((HEIGHT, WIDTH, 3), np.uint8), None))
    assert dark.fault.reason is Reason.DARK and dark.visibility == last[-1].visibility


def test_a_model_that_learnt_in_turbid_water_may_judge_there():
    (clear,) = limits()
    few = measure_sight([water(seed) for seed in range(5)])
    for known in ([replace(clear, least_contrast=0.5 * clear.contrast)], few):
        found = visibilities(gamma(0.7), SightMeter(known))
        assert not any(one.fault.reason is Reason.VISIBILITY for one in found)
        assert all(one.visibility < 0.8 for one in found), "told all the same"
    murky = [rounded(40 + 0.3 * (water(seed) - 40.0)) for seed in range(20)]
    both = measure_sight([*murky, *(cv2.resize(water(seed), (320, 240)) for seed in range(20))])
    assert len({one.least_contrast for one in both}) == 1
    assert 0 < both[0].least_contrast < 0.5 * clear.least_contrast
