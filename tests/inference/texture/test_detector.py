from dataclasses import replace

import numpy as np
import pytest

from tests.models.parts import SEES_ALL
from tokt.inference.frame import Frame
from tokt.inference.texture.detector import TextureDetector
from tokt.models.bundle.bundle import read_bundle


def test_a_real_bundle_is_a_scorer(bundle_file, draw_frame):
    bundle = read_bundle(bundle_file)
    picture = draw_frame([(2, 3)], seed=5)
    found = TextureDetector(bundle).detect(Frame(1, 0.0, picture, None))
    assert found.mask is not None and found.model == "noise/7"
    assert found.mask[54:81, 108:144].all() and found.mask.sum() == 255 * 27 * 36
    np.testing.assert_array_equal(found.decision_values, bundle.decision_values(picture))
    described = bundle.extractor.describe(picture, bundle.grid)
    np.testing.assert_array_equal(found.features, described)
    np.testing.assert_array_equal(bundle.model.decision_values(described), found.decision_values)
    picture[:] = draw_frame([(7, 9)], seed=6)  # as a camera does: another one in the same buffer
    again = TextureDetector(bundle).detect(Frame(2, 0.0, picture, None))
    assert again.mask.sum() == 255 * 27 * 36 and not again.mask[54:81].any()


@pytest.mark.parametrize(
    ("width", "height", "judged"),
    [
        (1360, 1024, True),
        (100, 40, True),  # learnt from, whatever its shape
        (968, 608, True),
        (1920, 1080, True),
        (576, 1024, True),  # portrait
        (256, 256, True),
        (2688, 1000, True),
        (2800, 1000, False),  # wider than what was measured
        (490, 1000, False),  # narrower
        (64, 48, False),  # small: its detail would be made up
    ],
)
def test_frames_of_other_sizes_are_judged_within_bounds(noise_scorer, width, height, judged):
    noise_scorer.frame_sizes = ((1024, 1360), (40, 100))
    frame = noisy(60, 9, height, width)
    found = TextureDetector(noise_scorer).detect(Frame(1, 0.0, frame, None))
    assert (found.mask is not None) == judged
    start = f"frames are {width}x{height}, which the model did not learn. It judges others"
    assert found.fault.startswith("" if judged else start) and bool(found.fault) != judged


def test_a_camera_that_is_turned_is_unknown_unless_both_ways_were_learnt(noise_scorer):
    frame = Frame(1, 0.0, noisy(60, 9, 1360, 1024), None)
    noise_scorer.frame_sizes = ((1024, 1360), (480, 640))
    assert "turned by a quarter" in TextureDetector(noise_scorer).detect(frame).fault
    noise_scorer.frame_sizes = ((1024, 1360), (640, 480))
    assert TextureDetector(noise_scorer).detect(frame).fault == ""


def test_a_frame_of_a_size_without_sight_is_told_where_another_size_has_it(noise_scorer):
    """As of a model that learnt from pictures and from compressed video."""
    (sharp,) = SEES_ALL
    noise_scorer.frame_sizes = ((271, 360), (542, 720))
    noise_scorer.sight = (sharp, replace(sharp, height=542, width=720, blurred=0.1))
    notes = [
        TextureDetector(noise_scorer).detect(Frame(1, 0.0, noisy(60, 1, *size), None)).note
        for size in noise_scorer.frame_sizes
    ]
    assert notes[0] == "" and "no finer detail" in notes[1]


def noisy(mean: float, sigma: float, height: int = 200, width: int = 300) -> np.ndarray:
    """Noise, and light that falls off to one side."""
    rng = np.random.default_rng(1)
    light = mean * np.linspace(0.7, 1.3, width)
    return (light + sigma * rng.standard_normal((height, width))).clip(0, 255).astype(np.uint8)
