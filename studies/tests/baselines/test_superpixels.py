"""SLIC superpixels as the thesis's program cut them, and what it made of each."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from skimage.segmentation import slic

from tokt.features.common.errors import ToktError
from tokt.training.fitting.train import rendered_other_image
from tokt_studies.baselines.lab_colour import LabColour, labelled_example
from tokt_studies.baselines.slic import SlicTexture, outline_boxes, resized_bgr, superpixels
from tokt_studies.baselines.thesis_texture import GRID, describe_haralick, describe_lbp_10_5

pytestmark = pytest.mark.xdist_group("baselines")

SMALL = (90, 120, 3)


def dark_noise() -> NDArray[np.uint8]:
    """Water of a few grey levels."""
    return np.random.default_rng(2).integers(3, 9, SMALL, np.uint8)


def test_noise_of_a_dark_frame_draws_no_outlines():
    """As in the library of the thesis's time; today's, left to itself, follows the noise."""
    flat = superpixels(np.full(SMALL, 6, np.uint8))
    assert (superpixels(dark_noise()) == flat).mean() > 0.95
    today = slic(dark_noise() / 255, 100, sigma=5)
    assert (today == flat).mean() < 0.8


class _Odd:
    """A classifier that finds every second rectangle an obstacle."""

    def __init__(self) -> None:
        self.asked = 0

    def predict(self, rows: NDArray[Any]) -> NDArray[np.int64]:
        self.asked += 1
        return np.full(len(rows), self.asked % 2)


def test_a_superpixel_is_judged_by_the_whole_rectangle_around_it():
    frame = cv2.resize(rendered_other_image()[:271, :360], (360, 271))
    frame = np.dstack([frame, frame[::-1], frame[:, ::-1]])
    seen: list[NDArray[np.uint8]] = []

    def describe(patch: NDArray[np.uint8]) -> NDArray[np.float64]:
        seen.append(patch.copy())
        return np.zeros(1)

    mask = SlicTexture(describe, _Odd(), "odd").mask(frame)
    picture = resized_bgr(frame)
    cut = superpixels(picture)
    boxes = [
        box
        for number in np.unique(cut)
        for box in outline_boxes(((cut == number) * 255).astype(np.uint8))
    ]
    gray = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    expected = np.zeros_like(gray)
    for turn, (x, y, width, height) in enumerate(boxes):
        assert (seen[turn] == gray[y : y + height, x : x + width]).all()
        expected[y : y + height, x : x + width] = 255 * (turn % 2 == 0)
    assert len(seen) == len(boxes) >= 80
    assert (mask == expected).all()


def shuffled_lbp() -> Callable[[NDArray[np.uint8]], NDArray[np.float64]]:
    rng = np.random.default_rng(1)
    return lambda patch: rng.permutation(describe_lbp_10_5(patch))


@pytest.mark.parametrize("describe", [describe_lbp_10_5, describe_haralick])
def test_texture_of_superpixels_finds_the_tower(dive, finds_tower, describe):
    method = SlicTexture.train(dive.left(1), rendered_other_image(), describe, "texture")
    assert finds_tower(lambda number: method.mask(dive.left(number)))


def test_texture_with_shuffled_features_does_not(dive, finds_tower):
    broken = SlicTexture.train(dive.left(1), rendered_other_image(), shuffled_lbp(), "shuffled")
    assert not finds_tower(lambda number: broken.mask(dive.left(number)))


LEARNT = (1, 12, 14)


def test_colour_of_superpixels_finds_the_tower_only_if_truly_labelled(dive, finds_tower):
    examples = [(dive.left(n), dive.tower(n).astype(np.int8)) for n in LEARNT]
    method = LabColour.train(examples)
    assert finds_tower(lambda number: method.mask(dive.left(number)))
    false = [(frame, truth[:, ::-1]) for frame, truth in examples]
    false[0] = examples[0][0], 1 - examples[0][1]
    broken = LabColour.train(false)
    assert not finds_tower(lambda number: broken.mask(dive.left(number)))


def test_colour_examples_that_teach_nothing_are_refused():
    frame = np.full((271, 360, 3), 20, np.uint8)
    water = labelled_example(frame, np.zeros(GRID.n_patches, np.int8))
    unknown = labelled_example(frame, np.full(GRID.n_patches, -1, np.int8))
    assert (water[1][:270] == 0).all()
    with pytest.raises(ToktError, match="both obstacles and clear water"):
        LabColour.train([water, unknown])
