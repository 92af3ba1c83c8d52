import cv2
import numpy as np
import pytest

from tokt.features.frames.mission import open_mission
from tokt.labels.formats.images import MissionImages
from tokt.labels.formats.options import ReadOptions, WriteOptions

from .examples import FRAMES, HEIGHT, TAXONOMY, WIDTH


@pytest.fixture(scope="session")
def dive(tmp_path_factory):
    """A stereo mission of three colour frames a camera; not to be changed."""
    folder = tmp_path_factory.mktemp("mission") / "dive"
    rng = np.random.default_rng(1)
    for side in ("Left", "Right"):
        (folder / side).mkdir(parents=True)
        for frame in FRAMES:
            image = rng.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
            cv2.imwrite(str(folder / side / f"dive_{side[0]}_{frame}.png"), image)
    return folder


@pytest.fixture(scope="session")
def images(dive):
    return MissionImages(open_mission(dive))


@pytest.fixture(scope="session")
def reading(images):
    """With the frames."""
    return ReadOptions(TAXONOMY, images=images)


@pytest.fixture(scope="session")
def writing(images):
    return WriteOptions(TAXONOMY, images)
