"""A class that nobody programmed, from a taxonomy file to the verdict, and what is said without it.

A rendered dive of small frames: water, kelp in the left half of some frames, and a pipeline, which
only the taxonomy file knows, across others.
"""

import json
import shutil
import socket
from itertools import product
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tests.calls import succeeds
from tests.fixtures import taxonomy_toml, write_labels

GRID, WIDTH, HEIGHT, CELLS = "4x4@96", 96, 72, 4
WATER, KELP, PIPELINE = "water", "kelp", "pipeline"
CLASSES = [WATER, KELP, PIPELINE]
FRAMES = range(1, 37)
BLOCK = ("--grid", GRID, "--block", 3)
TRAIN = ("--extractor", "haralick+lbp", "--preset", "plain", "--folds", 3, "--embargo", 1)


def shown(frame):
    """What a frame shows: three frames of each in turn."""
    return CLASSES[frame // 3 % 3]


def label(frame, row, col):
    if shown(frame) == KELP and col < 2:
        return KELP
    return PIPELINE if shown(frame) == PIPELINE and row == 2 else WATER


def draw(frame, dive):
    rng = np.random.default_rng([dive, frame])
    image = rng.normal(70, 3, (HEIGHT, WIDTH))
    if shown(frame) == KELP:
        image[:, : WIDTH // 2] += rng.normal(0, 25, (24, 16)).repeat(3, 0).repeat(3, 1)
    if shown(frame) == PIPELINE:
        image[36:54] += 30 * np.sin(np.arange(18) / 2)[:, None]
    return np.asarray(image.clip(0, 255), np.uint8)


def render(folder, dive):
    """A mission with its label file."""
    (folder / "Left").mkdir(parents=True)
    for frame in FRAMES:
        cv2.imwrite(str(folder / "Left" / f"dive_L_{frame}.png"), draw(frame, dive))
    patches = product(FRAMES, range(CELLS), range(CELLS))
    rows = [[folder.name, "left", *patch, label(*patch)] for patch in patches]
    write_labels(folder / "labels.csv", rows)
    return folder


@pytest.fixture(scope="module")
def chain(trained, tmp_path_factory):
    """Label import, dataset, training: a workspace whose taxonomy file has the own class."""
    folder = tmp_path_factory.mktemp("own_class")
    workspace = folder / ".tokt"
    workspace.mkdir()
    shutil.copy(trained / "mlflow.db", workspace)  # making its tables takes seconds
    (workspace / "taxonomy.toml").write_text(taxonomy_toml(water=False, kelp=True, pipeline=True))

    def tokt(*arguments):
        return json.loads(succeeds(*arguments, "--workspace", workspace, "--json").out)

    learnt, other = render(folder / "learnt", 1), render(folder / "other", 2)
    tokt("labels", "import", learnt / "labels.csv", "--grid", GRID)
    build = ("dataset", "build", "own", "--task", "classes", *BLOCK)
    dataset = tokt(*build, "--mission", learnt)
    model = tokt("train", "own", "--name", "own", *TRAIN)
    made = {"other": other, "dataset": dataset, "model": model}
    return SimpleNamespace(folder=folder, workspace=workspace, tokt=tokt, **made)


@pytest.fixture
def receiver():
    """A UDP port of this machine that nobody else gets the datagrams of."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        yield f"127.0.0.1:{own.getsockname()[1]}"


def statuses(chain, udp, store):
    """What the runtime says of the other dive's frames, by what they show."""
    log = store.parent / f"{store.name}.jsonl"
    command = ("run", "--store", store, "--source", chain.other, "--policy", "texture")
    succeeds(*command, "--udp", udp, "--log", log)
    found = {name: [] for name in CLASSES}
    for frame, line in zip(FRAMES, log.read_text("utf-8").splitlines(), strict=True):
        found[shown(frame)].append(json.loads(line)["status"])
    return {name: (sum(s == 1 for s in said), len(said)) for name, said in found.items()}


def test_an_own_class_is_learnt_evaluated_and_judged_at_run_time(chain, receiver):
    assert chain.dataset["labels"] == {"kelp": 96, "pipeline": 48, "water": 432}
    assert list(chain.model["cv"]["patch"]["per_class"]) == CLASSES
    assert chain.model["cv"]["patch"]["macro_f1"] > 0.9
    dive = ("--mission", chain.other, "--labels", chain.other / "labels.csv")
    score = chain.tokt("evaluate", "own", *dive)
    assert score["patch"]["per_class"][PIPELINE]["f1"] > 0.9
    assert score["patch"]["per_class"][PIPELINE]["n"] == 48
    bundle = chain.folder / "own.tokt"
    chain.tokt("export", "own", "-o", bundle)
    store = chain.folder / "store"
    succeeds("deploy", bundle, store)
    found = statuses(chain, receiver, store)
    assert found[WATER][0] == 0
    assert found[PIPELINE][0] >= 8 and found[KELP][0] >= 8


def test_the_taxonomy_given_at_deployment_says_what_is_an_obstacle(chain, receiver):
    harmless = chain.folder / "kelp_is_soft.toml"
    harmless.write_text(taxonomy_toml(water=False, kelp=False, pipeline=True))
    store = chain.folder / "store_soft"
    succeeds("deploy", "own", store, "--taxonomy", harmless, "--workspace", chain.workspace)
    found = statuses(chain, receiver, store)
    assert found[WATER][0] == 0 and found[PIPELINE][0] >= 8
    assert found[KELP][0] <= 1
