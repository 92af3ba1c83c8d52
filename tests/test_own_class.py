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
from tokt.labels.formats.label_csv import read_label_csv
from tokt.labels.taxonomy import load_taxonomy

pytestmark = pytest.mark.xdist_group("own_class")  # what they share is made once

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


def test_the_audit_suggests_an_own_class(chain, tmp_path):
    labels = (chain.folder / "learnt" / "labels.csv").read_text("utf-8")
    wrong = f"learnt,left,7,2,1,{label(7, 2, 1)}\n"
    assert wrong.endswith("pipeline\n") and wrong in labels
    (tmp_path / "wrong.csv").write_text(labels.replace(wrong, wrong.replace(PIPELINE, KELP)))
    chain.tokt(
        *("dataset", "build", "spoilt", "--task", "classes", *BLOCK),
        *("--mission", chain.folder / "learnt", "--labels", tmp_path / "wrong.csv"),
    )
    out = tmp_path / "audit.csv"
    worst, *_ = chain.tokt("labels", "audit", "spoilt", "--folds", 3, "-o", out)["patches"]
    found = [worst[key] for key in ("frame", "row", "col", "label", "suggested")]
    assert found == [7, 2, 1, KELP, PIPELINE]
    # A patch of a 4x4 grid is imported as one, with nothing said of the grid.
    record, *_ = read_label_csv(out, load_taxonomy(chain.workspace))
    assert (str(record.grid), record.frame, record.row, record.col) == (GRID, 7, 2, 1)


def test_without_the_taxonomy_file_it_is_said_how_to_add_the_class(chain, run_tokt, tmp_path):
    command = ("labels", "import", chain.other / "labels.csv", "--grid", GRID)
    ran = run_tokt(*command, "--workspace", tmp_path / "new")
    assert (ran.code, ran.out) == (2, "")
    (line,) = ran.err.splitlines()
    assert "unknown class 'water'" in line
    assert "[[classes]]" in line and "taxonomy.toml" in line
