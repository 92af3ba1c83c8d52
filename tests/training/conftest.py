"""What tests of training ask of the command line: that it ends well, or refuses in one line."""

import json

import cv2
import numpy as np
import pytest

from tests import calls


@pytest.fixture(scope="session")
def done():
    """`tests.calls.succeeds`."""
    return calls.succeeds


@pytest.fixture(scope="session")
def told(done):
    """Run a command that must end well; the JSON that it prints."""
    return lambda *arguments: json.loads(done(*arguments, "--json").out)


@pytest.fixture(scope="session")
def refused():
    """`tests.calls.refused`."""
    return calls.refused


@pytest.fixture(scope="session")
def cut_patches():
    """Fill a folder with ready-cut patches: of ocean, reef and unsure as many each."""

    def fill(folder, seed, count):
        rng = np.random.default_rng(seed)
        for label, spread in (("ocean", 2), ("reef", 14), ("unsure", 5)):
            (folder / label).mkdir(parents=True)
            for number in range(count):
                coarse = rng.normal(60, spread, (9, 12)).repeat(3, 0).repeat(3, 1)
                patch = rng.normal(coarse, 2).clip(0, 255).astype(np.uint8)
                cv2.imwrite(str(folder / label / f"{number}.png"), patch)
        return folder

    return fill
