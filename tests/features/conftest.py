"""Pictures drawn for the tests, and the real mission."""

import cv2
import numpy as np
import pytest


@pytest.fixture(scope="session")
def mission(mission_dir):
    return mission_dir


@pytest.fixture(scope="session")
def colour():
    """A 120x160 BGR picture with a ramp, a disc, dark water and noise."""
    rng = np.random.default_rng(7)
    ramp = np.add.outer(np.linspace(0, 90, 120), np.linspace(0, 120, 160))
    picture = np.repeat(ramp[:, :, None], 3, axis=2) * (1.0, 0.8, 0.5)
    picture[60:, 80:] += rng.normal(0, 25, (60, 80, 3))
    picture[:30, :40] = 0
    drawn = np.clip(picture, 0, 255).astype(np.uint8)
    cv2.circle(drawn, (110, 40), 22, (40, 160, 230), -1)
    return drawn


@pytest.fixture(scope="session")
def gray(colour):
    return np.asarray(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY), np.uint8)
