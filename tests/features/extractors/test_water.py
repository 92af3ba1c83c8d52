"""Features that know the water: gradients, colour, place, and what is taken away from them."""

from itertools import product

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from skimage.color import rgb2lab

from tests.calls import refuses
from tests.tiers import scaled
from tokt.features.extractors.cielab import lab_of
from tokt.features.extractors.extractor import build_extractor, extractor_named
from tokt.features.extractors.frame_pictures import FramePictures
from tokt.features.extractors.textures import Context, Join
from tokt.features.extractors.water import Colour, Gradients, PatchPlace, Relative, WaterContrast
from tokt.features.frames.grid import DEFAULT_GRID, Grid

GRID = Grid(4, 5, 180)


def sea(seed=0, cast=(200, 150, 60), height=300, width=400):
    """Water of one cast that darkens downwards, with a sensor's noise, in BGR."""
    light = np.linspace(1, 0.6, height)[:, None, None] * np.array(cast)
    noise = np.random.default_rng(seed).normal(0, 1.5, (height, width, 3))
    return np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)


def with_post(frame):
    """The same with something rust-red and grainy in the patches of row 1, columns 2 and 3."""
    frame = frame.copy()
    grain = np.random.default_rng(9).normal(0, 25, (75, 160, 3))
    frame[75:150, 160:320] = np.clip(grain + np.array([50, 60, 140]), 0, 255)
    return frame


POST = [7, 8]


def test_gradients_are_those_of_the_smoothed_picture():
    frame = with_post(sea())
    found = Gradients((1, 5)).describe(frame, GRID)
    gray = FramePictures(frame, GRID).gray16.astype(np.float64) / 256
    for place, n in ((0, 1), (3, 5)):
        smooth = cv2.blur(gray, (n, n), borderType=cv2.BORDER_REPLICATE)
        down, across = (np.gradient(smooth, axis=axis) for axis in (0, 1))
        across[:, [0, -1]] = down[[0, -1]] = 0
        cells = [GRID.cells(part).reshape(20, -1) for part in (across, down)]
        for kind, part in enumerate(cells):
            expected = np.log((part**2).mean(axis=1) + 1e-3)
            np.testing.assert_allclose(found[:, place + kind], expected, atol=0.01)
        strong = np.quantile(np.hypot(*cells), 0.95, axis=1, method="inverted_cdf")
        # Strong gradients are told to an eighth of an octave of their square.
        np.testing.assert_allclose(found[:, place + 2], np.log(strong + 0.03), atol=0.07)


@settings(max_examples=scaled(60))
@given(arrays(np.int64, (3, 5, 3), elements=st.integers(0, 255 * 256)))
def test_lab_is_that_of_scikit_image(bgr16):
    expected = rgb2lab(bgr16[..., ::-1] / (255 * 256))
    np.testing.assert_allclose(lab_of(bgr16), expected, atol=0.02)


def test_colour_is_the_mean_of_the_patch_and_its_changes():
    frame = sea(cast=(180, 150, 60))
    frame[:, 200:] = (60, 60, 180)
    found = Colour(9).describe(frame, GRID)
    left, right = found[GRID.cols : GRID.cols + 2], found[2 * GRID.cols - 1]
    assert right[1] > 30 and (left[:, 1] < 0).all()  # red, and blue green
    edge = found.reshape(4, 5, -1)[:, 2]  # the border goes through its middle
    assert (edge[:, 3] > found.reshape(4, 5, -1)[:, 0, 3] + 3).all()
    assert (edge[:, 3] > edge[:, 4] + 3).all()  # across, and not down


def test_place():
    found = PatchPlace().describe(sea(), GRID).reshape(4, 5, 2)
    np.testing.assert_allclose(found[:, 0, 0], [-1 / 2, -1 / 6, 1 / 6, 1 / 2])
    np.testing.assert_allclose(found[0, :, 1], [1 / 2, 1 / 4, 0, 1 / 4, 1 / 2])
    assert PatchPlace().describe(sea(), Grid(1, 1, 180)).tolist() == [[-0.5, 0.5]]


WATER = Relative([Gradients((1, 5)), Colour(9)], 0.3)


@pytest.mark.parametrize(
    "cast", [(200, 150, 60), (120, 170, 90), (230, 190, 150), (60, 50, 40)], ids=str
)
def test_water_of_any_cast_is_near_nothing_and_an_obstacle_is_not(cast):
    features = WATER.describe(with_post(sea(cast=cast)), GRID)
    strength = np.abs(features[:, [0, 1, 3, 4, 9, 10]]).mean(axis=1)
    assert strength[POST].min() > 2 * np.delete(strength, [*POST, 1, 2, 3, 6, 9, 12, 13]).max()


def test_relative_is_less_the_median_of_the_quietest():
    frame = with_post(sea())
    plain = np.hstack([part.describe(frame, GRID) for part in WATER.parts])
    energies = plain[:, [0, 1, 3, 4, 9, 10, 11, 12]].mean(axis=1)
    quietest = np.argsort(energies, kind="stable")[:6]
    expected = plain - np.median(plain[quietest], axis=0)
    assert np.array_equal(WATER.describe(frame, GRID), expected)
    assert not set(POST) & set(quietest.tolist())


GRAY = sea()[:, :, 0]


@pytest.mark.parametrize(
    "extractor", [Colour(9), WATER, Context(WATER, "mean"), WaterContrast(WATER.parts, 0.3, 9)]
)
def test_a_gray_frame_has_no_colour(extractor):
    assert extractor.needs_colour
    for frame in (GRAY, cv2.merge([GRAY] * 3)):
        refuses("looks at colours", extractor.describe, frame, GRID)
    almost = cv2.merge([GRAY] * 3)
    almost[1, 1, 0] ^= 1
    assert np.isfinite(extractor.describe(almost, GRID)).all()


CONTRAST = WaterContrast([Gradients((1, 5)), Colour(9, gray=True)], 0.3, 9)


def features_of(prefix, frame, grid=GRID, extractor=CONTRAST):
    """Those of an extractor whose names begin so, (rows, cols, n)."""
    kept = [index for index, name in enumerate(extractor.names) if name.startswith(prefix)]
    return extractor.describe(frame, grid)[:, kept].reshape(grid.rows, grid.cols, -1)


def test_contrast_has_the_neighbours_and_the_place_beside_what_differs_from_the_water():
    frame = with_post(sea())
    joined = Join([Context(Relative(WATER.parts, 0.3), "mean"), PatchPlace()])
    found = CONTRAST.describe(frame, GRID)
    assert CONTRAST.names[: joined.dim] == joined.names
    assert np.array_equal(found[:, : joined.dim], joined.describe(frame, GRID))
    assert build_extractor(CONTRAST.spec).spec == CONTRAST.spec
    assert len(CONTRAST.names) == CONTRAST.dim == found.shape[1]


def test_a_smooth_field_of_light_is_no_obstacle_and_a_post_is_off_it():
    y, x = np.mgrid[-1:1:300j, -1:1:400j][..., None]
    lamp = 1.1 - 0.3 * (x**2 + y**2) + 0.1 * x
    water = np.clip(np.rint(sea(height=300) * lamp), 0, 255).astype(np.uint8)
    level = features_of("relative.colour_lightness", water)
    off = features_of("field_distance", water)
    assert np.ptp(level) > 3 * np.ptp(off)
    posted = features_of("field_distance", with_post(water)).ravel()
    assert posted[POST].min() > 3 * np.delete(posted, POST).max()


def test_cells_tell_the_shape_of_colour_and_not_its_slope():
    slope, shape = (features_of(f"cells_{kind}", sea()) for kind in ("off_plane", "spread"))
    assert slope.shape == shape.shape == (4, 5, 3)
    tilted = np.linspace(60, 200, 400)[None, :, None] * np.ones((300, 1, 3))
    tilted = tilted.astype(np.uint8)
    assert features_of("cells_spread_lightness", tilted).min() > 0
    assert features_of("cells_off_plane_lightness", tilted).max() < -1
    post = features_of("cells_off_plane_a", with_post(sea())).ravel()
    bar = sea()
    bar[80:145, 190:200] = (40, 50, 150)
    assert features_of("cells_off_plane_a", bar)[1, 2, 0] > 2 + post[0]


def test_all_patches_know_how_quiet_their_frame_is():
    for frame in (sea(), with_post(sea())):
        found = features_of("frame_", frame)
        assert (found == found[0, 0]).all() and found.shape[2] == 3 * 8
    rough = np.random.default_rng(0).integers(0, 255, (300, 400, 3), np.uint8)
    assert (features_of("frame_low", rough)[0, 0] > features_of("frame_low", sea())[0, 0]).all()


def test_gray_frames_are_frames_without_colour_where_that_is_allowed():
    for extractor in (CONTRAST, extractor_named("water")):
        assert not extractor.needs_colour
        gray, merged = (extractor.describe(frame, GRID) for frame in (GRAY, cv2.merge([GRAY] * 3)))
        np.testing.assert_array_equal(gray, merged)
        names = [index for index, name in enumerate(extractor.names) if name.endswith("colour_a")]
        assert np.abs(gray[:, names]).max() < 1e-5
    for wrong in (False, 1, "yes"):
        refuses("gray is true", build_extractor, {**Colour(9, gray=True).spec, "gray": wrong})
    for cells in (0, 4, 33, 9.0, True):
        refuses("multiple of 3", build_extractor, {**CONTRAST.spec, "cells": cells})


@pytest.mark.parametrize(
    ("grid", "size"),
    [*product([Grid(1, 1, None), Grid(2, 2, 8)], [(7, 9), (8, 8)]), (DEFAULT_GRID, (31, 40))],
)
def test_frames_of_fewer_pixels_than_cells(grid, size):
    frame = np.random.default_rng(2).integers(0, 255, (*size, 3), np.uint8)
    found = Context(WATER, "mean").describe(frame, grid)
    assert found.shape == (grid.n_patches, 26) and np.isfinite(found).all()
    found = CONTRAST.describe(frame, grid)
    assert found.shape == (grid.n_patches, CONTRAST.dim) and np.isfinite(found).all()


def spec(name, **options):
    return {"name": name, "version": 1, **options}


GRADIENTS = spec("gradients", smooth=[1])
PLACE = spec("place")


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        *[
            ("rising odd numbers", spec("gradients", smooth=wrong))
            for wrong in ([], [2], [3, 1], [1, 1], [17], 3, "1", [1.0], [True], [0], None)
        ],
        *[("cells is", spec("colour", cells=wrong)) for wrong in (2, 33, 9.0, True, None, "9")],
        ("place: unknown", spec("place", cells=3)),
        *[
            ("quietest", spec("relative", parts=[GRADIENTS], quietest=wrong))
            for wrong in (0.0, 1, 1.01, -0.1, None, float("nan"), True)
        ],
        ("one other extractor", spec("relative", parts=[], quietest=0.3)),
        ("one other extractor", spec("relative", parts=GRADIENTS, quietest=0.3)),
        ("gradients or colour", spec("relative", parts=[PLACE], quietest=0.3)),
        (
            "cannot stand inside another relative",
            spec(
                "relative", parts=[spec("relative", parts=[GRADIENTS], quietest=0.3)], quietest=1.0
            ),
        ),
    ],
)
def test_refused_specs(words, wrong):
    refuses(words, build_extractor, wrong)


@pytest.mark.parametrize("name", ["water", "lite_water"])
def test_a_frame_without_colour_is_told_by_its_features(name):
    water, plain = extractor_named(name), extractor_named(f"{name}_gray")
    for frame in (sea(), with_post(sea(1)), sea(2, cast=(90, 90, 90)), np.zeros_like(sea())):
        gray = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        for one, is_gray in ((frame, not frame.any()), (gray, True), (cv2.merge([gray] * 3), True)):
            told = water.is_gray(water.describe(one, DEFAULT_GRID))
            assert told.shape == (100,) and set(told.tolist()) == {is_gray}
        assert not plain.is_gray(plain.describe(gray, DEFAULT_GRID)).any()


@pytest.mark.parametrize("name", ["water", "lite_water"])
@pytest.mark.parametrize("size", [(480, 640), (1080, 1920), (2160, 3840)])
@pytest.mark.parametrize("noise", [1, 4])
def test_even_water_in_colour_is_not_gray(name, size, noise):
    """However little its colours differ from place to place."""
    water, rng = extractor_named(name), np.random.default_rng(noise)
    light = np.linspace(1, 0.9, size[0])[:, None, None] * np.array((135, 108, 54))
    frame = np.clip(light + rng.normal(0, noise, (*size, 3)), 0, 255).astype(np.uint8)
    assert not water.is_gray(water.describe(frame, DEFAULT_GRID)).any()
