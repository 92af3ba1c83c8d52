"""What tests of training ask of the command line: that it ends well, or refuses in one line."""

import json
import shutil
from itertools import product
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tests import calls
from tests.fixtures import draw_tiny_frame, tiny_label, write_labels


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
    return calls.refused


@pytest.fixture(scope="session")
def begun(trained):
    """Make a workspace whose registry has its tables, which take seconds to make anew."""

    def begin(workspace):
        workspace.mkdir(parents=True)
        shutil.copy(trained / "mlflow.db", workspace)
        return workspace

    return begin


@pytest.fixture(scope="session")
def tiny_dive():
    """Draw frames as the tiny mission's, in other light, as a dive of its own; its label file."""

    def draw(folder, frames, gain=1.0, labelled=None):
        (folder / "Left").mkdir(parents=True)
        for frame in frames:
            image = draw_tiny_frame(frame)
            lit = cv2.convertScaleAbs(image, alpha=gain, beta=9 * (gain - 1))
            cv2.imwrite(str(folder / "Left" / f"{folder.name}_L_{frame}.png"), lit)
        patches = product(labelled or frames, range(10), range(10))
        rows = [[folder.name, "left", *patch, tiny_label(*patch)] for patch in patches]
        return write_labels(folder / "labels.csv", rows)

    return draw


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


@pytest.fixture(scope="session")
def cut(begun, cut_patches, done, shared_folder):
    """A workspace with dataset `cut` and its model `cut-lbp`, and what people were told of both."""

    def train(folder):
        patches, where = cut_patches(folder / "patches", 1, 20), begun(folder / ".tokt")
        built = done("dataset", "build", "cut", "--patches", patches, "--workspace", where)
        model = ("--extractor", "lbp", "--preset", "plain")
        trained = done("train", "cut", *model, "--workspace", where)
        (folder / "told.json").write_text(json.dumps([built.out, trained.out]))

    folder = shared_folder("cut", train)
    built, trained = json.loads((folder / "told.json").read_text())
    where = {"workspace": folder / ".tokt", "patches": folder / "patches"}
    return SimpleNamespace(**where, built=built, trained=trained)
