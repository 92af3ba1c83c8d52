from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tokt.features.image_file import read_image
from tokt.inference.detector import GridDetector
from tokt.inference.frame_check import frame_fault
from tokt.inference.sources import Frame
from tokt.models.bundle import read_bundle


def test_the_mask_is_the_grid_painted(
    noise_scorer: Any, draw_frame: Callable[..., np.ndarray]
) -> None:
    picture = draw_frame([(2, 3), (7, 9)])
    found = GridDetector(noise_scorer).detect(Frame(1, 0.0, picture, None))
    obstacle = np.zeros((10, 10), bool)
    obstacle[2, 3] = obstacle[7, 9] = True
    assert found.mask is not None
    np.testing.assert_array_equal(found.mask, noise_scorer.grid.paint(obstacle, 271, 360))
    assert found.model == "noise/1" and found.fault == ""


def test_a_real_bundle_is_a_scorer(
    bundle_file: Path, draw_frame: Callable[..., np.ndarray]
) -> None:
    bundle = read_bundle(bundle_file)
    picture = draw_frame([(2, 3)], seed=5)
    found = GridDetector(bundle).detect(Frame(1, 0.0, picture, None))
    assert found.mask is not None and found.model == "noise/7"
    assert found.mask[54:81, 108:144].all() and found.mask.sum() == 255 * 27 * 36
    np.testing.assert_array_equal(found.decision_values, bundle.decision_values(picture))


def test_no_frame_is_unknown_with_the_source_s_reason(noise_scorer: Any) -> None:
    found = GridDetector(noise_scorer).detect(Frame(1, 0.0, None, None, "a.jpg is truncated"))
    assert found.mask is None and found.fault == "a.jpg is truncated"


def test_values_that_are_not_finite_are_unknown(
    noise_scorer: Any, draw_frame: Callable[..., np.ndarray]
) -> None:
    noise_scorer.decision_values = lambda frame: np.full((100, 1), np.nan)
    found = GridDetector(noise_scorer).detect(Frame(1, 0.0, draw_frame([]), None))
    assert found.mask is None and "not finite" in found.fault


def noisy(mean: float, sigma: float) -> np.ndarray:
    rng = np.random.default_rng(1)
    return (mean + sigma * rng.standard_normal((200, 300))).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("picture", "word"),
    [
        (np.zeros((200, 300), np.uint8), "dark"),
        (noisy(1, 1.5), "dark"),
        (np.full((200, 300, 3), 128, np.uint8), "blank"),
        (
            np.where(np.arange(300) < 160, 255, 40).astype(np.uint8)[None].repeat(200, 0),
            "saturated",
        ),
        (np.zeros((200, 300), np.uint16), "8-bit"),
        (np.zeros((0, 300), np.uint8), "8-bit"),
    ],
)
def test_frames_that_cannot_be_judged(picture: np.ndarray, word: str) -> None:
    assert word in frame_fault(picture)


def test_a_dim_frame_can_be_judged() -> None:
    assert frame_fault(noisy(12, 3)) == ""


@pytest.mark.mission
@pytest.mark.slow
def test_every_frame_of_the_sea_trial_can_be_judged(mission: Path) -> None:
    paths = sorted(mission.glob("*/*.jpg"))
    assert len(paths) == 492
    assert {frame_fault(read_image(path)) for path in paths} == {""}
