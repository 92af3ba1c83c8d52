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
    ("width", "height", "fit"),
    [
        (1360, 1024, True),
        (1360, 1030, True),
        (1360, 980, False),  # another aspect ratio
        (1024, 771, True),
        (1000, 753, False),  # under 0.75 of the training frames' width
        (1800, 1355, True),
        (1820, 1370, False),  # over 1.33 of it
        (64, 48, False),
    ],
)
def test_frames_unlike_the_training_frames_are_unknown(noise_scorer, width, height, fit):
    noise_scorer.frame_sizes = ((480, 640), (1024, 1360))
    found = TextureDetector(noise_scorer).detect(Frame(1, 0.0, noisy(60, 9, height, width), None))
    assert (found.mask is not None) == fit
    fault = f"frames are {width}x{height}, the model learnt from 640x480 or 1360x1024"
    assert found.fault == ("" if fit else fault)


def test_frames_narrower_than_the_grid_are_unknown_unless_learnt_from(noise_scorer):
    frame = Frame(1, 0.0, noisy(60, 9, 240, 320), None)
    noise_scorer.frame_sizes = ((300, 400),)
    assert "320x240" in TextureDetector(noise_scorer).detect(frame).fault
    noise_scorer.frame_sizes = ((240, 320),)
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
