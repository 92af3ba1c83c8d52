"""A user's mistake is one line on stderr and exit code 2; nothing is written, nothing changes."""

import io
import json
import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.calls import run_python
from tests.fixtures import tiny_labels, write_labels
from tests.models.parts import pack, rehash, unpack


@dataclass(frozen=True)
class World:
    """What a case can spoil: a workspace, a mission, a label file, a bundle, a store."""

    folder: Path
    mission: Path
    labels: Path
    bundle: Path
    store: Path


@pytest.fixture(scope="module")
def sound_world(trained, tiny, tiny_bundle, tmp_path_factory):
    """Not to be changed: what no command changes serves all that spoil nothing."""
    folder = tmp_path_factory.mktemp("world")
    shutil.copytree(trained, folder / ".tokt")
    shutil.copytree(tiny.path, folder / "tiny")
    shutil.copy(tiny_bundle, folder / "m.tokt")
    return folder


@pytest.fixture
def world(sound_world, tmp_path):
    """A copy that a test may change."""
    return world_in(shutil.copytree(sound_world, tmp_path / "world"))


def world_in(folder):
    mission = folder / "tiny"
    return World(folder, mission, mission / "labels.csv", folder / "m.tokt", folder / "store")


def listing(folder):
    """Every file with its size and time; SQLite's own side files come and go."""
    return {
        str(path.relative_to(folder)): (path.stat().st_size, path.stat().st_mtime_ns)
        for path in folder.rglob("*")
        if path.is_file() and not path.name.endswith(("-wal", "-shm", "-journal"))
    }


BUILD = "dataset build new --mission tiny --labels tiny/labels.csv"
TRAIN = "train tiny --extractor lbp"
EVALUATE = "evaluate m.tokt --mission tiny --labels tiny/labels.csv"
FRAME = "tiny/Left/tiny_L_20.png"

# --- ways to spoil something -------------------------------------------------------------------


def nothing(world):
    pass


def empty_mission(world):
    shutil.rmtree(world.mission / "Left")


def changed(name, change):
    """A file with other bytes."""

    def spoil(world):
        path = world.folder / name
        path.write_bytes(change(path.read_bytes()))

    return spoil


def label_text(old, new):
    def spoil(world):
        text = world.labels.read_text("utf-8")
        assert old in text
        world.labels.write_text(text.replace(old, new, 1), "utf-8")

    return spoil


def only_rows(keep):
    def spoil(world):
        write_labels(world.labels, [row for row in tiny_labels() if keep(row)])

    return spoil


def rewritten(change):
    """The bundle with other members; their hashes are made to fit where `change` says so."""

    def spoil(world):
        members = unpack(world.bundle.read_bytes())
        change(members)
        world.bundle.write_bytes(pack(members))

    return spoil


def edit_card(members):
    members["card.md"] += b"better than it is\n"


def newer_format(members):
    manifest = json.loads(members["manifest.json"])
    members["manifest.json"] = json.dumps({**manifest, "format_version": 99}).encode()


def golden_mismatch(members):
    """Weights changed by somebody who knows how to make every hash fit."""
    with np.load(io.BytesIO(members["weights.npz"])) as file:
        arrays = {name: file[name] for name in file.files}
    arrays["bias"] = arrays["bias"] + 1e-6
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    members["weights.npz"] = buffer.getvalue()
    members.update(unpack(rehash(members)))


def store_without_model(world):
    world.store.mkdir()


def store_is_a_file(world):
    world.store.write_text("not a folder")


def workspace_is_a_file(world):
    shutil.rmtree(world.folder / ".tokt")
    (world.folder / ".tokt").write_text("not a folder")


def label_store_empty(world):
    assert not (world.folder / ".tokt" / "labels.db").exists()


CASES = {
    # missions
    "mission missing": (nothing, f"{BUILD} --mission nowhere", "mission nowhere does not exist"),
    "mission empty": (empty_mission, BUILD, "mission tiny has no frames"),
    "frame gone": (
        *(lambda w: (w.folder / FRAME).unlink(), BUILD),
        "no left frame 20, which is labelled",
    ),
    # label files
    "labels missing": (lambda w: w.labels.unlink(), BUILD, "labels.csv does not exist"),
    "labels: unknown class": (
        *(label_text("left,1,0,3,ocean", "left,1,0,3,wreck"), BUILD),
        "labels.csv line 5: unknown class 'wreck'",
    ),
    "labels: of another mission": (
        *(nothing, f"{BUILD} --mission tiny/Left"),
        "no labels for mission 'Left'",
    ),
    "labels: none in a label store": (
        *(label_store_empty, "dataset build new --mission tiny"),
        "labels.db",
    ),
    "frames that are none": (nothing, f"{BUILD} --frames 9-1", "not a list of frames"),
    "grid that is none": (nothing, f"{BUILD} --grid ten", "not a grid: 'ten'"),
    # datasets
    "one class only": (
        *(only_rows(lambda row: row[-1] == "ocean"), BUILD),
        r"one class only: every patch is clear \(ocean\); .* that has obstacle patches too",
    ),
    "dataset name": (nothing, BUILD.replace("new", "a/b"), "use letters"),
    "neither mission nor patches": (
        *(nothing, "dataset build new"),
        "give either --mission DIR or --patches",
    ),
    "patches missing": (
        *(nothing, "dataset build x --patches none"),
        "folder of patches none does not exist",
    ),
    "dataset unknown": (nothing, "dataset show x", r"no dataset 'x' \(there are: tiny\)"),
    # training
    "train on nothing": (nothing, "train x --extractor lbp", "no dataset 'x'"),
    "fewer blocks than folds": (nothing, f"{TRAIN} --folds 12", "11 blocks.*too few for 12"),
    "unknown extractor": (nothing, f"{TRAIN} --extractor sift", "unknown extractor 'sift'"),
    "model name": (nothing, f"{TRAIN} --name a/b", "model name 'a/b'"),
    "thesis image missing": (
        *(nothing, f"{TRAIN} --preset thesis --ocean x.png --folds 3"),
        "x.png: No such file",
    ),
    "folds no number": (nothing, f"{TRAIN} --folds many", "--folds"),
    # models
    "model unknown": (nothing, "models show x", r"no model 'x' .* \(there are: tiny-lbp"),
    "alias of nothing": (nothing, "models alias x champion", "no model 'x'"),
    "export name": (nothing, "export tiny-lbp -o x.zip", "ends in .tokt"),
    "export over a folder": (
        *(lambda w: (w.folder / "d.tokt").mkdir(), "export m.tokt -o d.tokt"),
        "Is a directory",
    ),
    # bundles
    **{
        f"bundle {name}: deploy": (spoil, "deploy m.tokt store", message)
        for name, spoil, message in (
            ("missing", lambda w: w.bundle.unlink(), "bundle m.tokt: No such file"),
            ("empty", changed("m.tokt", lambda d: b""), "truncated|not a tokt bundle"),
            ("truncated", changed("m.tokt", lambda d: d[:9999]), "truncated|not a tokt bundle"),
            ("edited", rewritten(edit_card), "card.md in the bundle has been edited"),
            ("newer", rewritten(newer_format), "has format 99, newer than this tokt reads"),
            ("golden", rewritten(golden_mismatch), "golden frame 0 gives decision values"),
        )
    },
    "bundle golden: evaluate": (rewritten(golden_mismatch), EVALUATE, "golden frame 0 gives"),
    "bundle golden: models show": (
        *(rewritten(golden_mismatch), "models show m.tokt"),
        "golden frame 0 gives",
    ),
    # stores
    "store missing": (nothing, "store store", "store store does not exist"),
    "rollback without a store": (nothing, "rollback store", "store store does not exist"),
    "rollback without a model": (store_without_model, "rollback store", "no earlier model"),
    "deploy into a file": (store_is_a_file, "deploy m.tokt store", "Not a directory|exist"),
    # elsewhere
    "workspace is a file": (workspace_is_a_file, BUILD, "Not a directory|File exists"),
    "taxonomy missing": (nothing, f"{BUILD} --taxonomy x.toml", "taxonomy x.toml: No such"),
    "unknown option": (nothing, f"{BUILD} --colour red", "No such option.*--colour"),
    "unknown command": (nothing, "sail", "No such command 'sail'"),
    "evaluate other frames": (nothing, f"{EVALUATE} --frames 900", "has frames 1-40, not 900"),
}

# Lines that may stand before the error: progress of work that had begun.
PROGRESS = re.compile(r"(reading frames|scoring|features|cross-validation): \d+/\d+")


def check(code, out, err, message):
    lines = err.splitlines()
    assert code == 2, err
    assert out == ""
    assert lines[-1].startswith("tokt: error: "), err
    assert re.search(message, lines[-1]), lines[-1]
    assert all(PROGRESS.fullmatch(line) for line in lines[:-1]), err
    assert "Traceback" not in err


@pytest.mark.parametrize("case", CASES)
def test_one_line_exit_2_and_nothing_written(case, sound_world, request, run_tokt, monkeypatch):
    spoil, command, message = CASES[case]
    whole = spoil is nothing
    world = world_in(sound_world) if whole else request.getfixturevalue("world")
    spoil(world)
    monkeypatch.chdir(world.folder)
    before = listing(world.folder)
    ran = run_tokt(*command.split())
    check(ran.code, ran.out, ran.err, message)
    after = listing(world.folder)
    before.pop(".tokt/mlflow.db", None), after.pop(".tokt/mlflow.db", None)
    assert after == before


@pytest.mark.process
@pytest.mark.parametrize("case", ["labels: unknown class", "store missing"])
def test_the_same_through_a_real_process(case, world):
    spoil, command, message = CASES[case]
    spoil(world)
    before = listing(world.folder)
    ran = run_python("-m", "tokt", *command.split(), folder=world.folder)
    check(ran.returncode, ran.stdout, ran.stderr, message)
    assert listing(world.folder) == before


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_may_not_be_written(world, run_tokt, monkeypatch):
    monkeypatch.chdir(world.folder)
    locked = world.folder / "locked"
    locked.mkdir(mode=0o500)
    for command in ("export m.tokt -o locked/x.tokt", "deploy m.tokt locked/s"):
        ran = run_tokt(*command.split())
        check(ran.code, ran.out, ran.err, r"Permission denied")
    assert list(locked.iterdir()) == []


@pytest.mark.parametrize(
    ("module", "command"),
    [
        ("mlflow", "models list"),
        ("mlflow", "deploy tiny-lbp store"),
        ("pandas", "dataset list"),
        ("sklearn", TRAIN),
    ],
)
@pytest.mark.process
def test_a_missing_extra_is_named(module, command, world, tokt_without):
    """On the ship's PC, with the slim install, a training command says what to install."""
    ran = tokt_without([module], world.folder, *command.split())
    check(ran.returncode, ran.stdout, ran.stderr, r"needs .*: install the extra 'train'")


@pytest.mark.process
def test_a_file_is_deployed_without_any_extra(world, tokt_without):
    """The way aboard: bundle file and store need neither MLflow nor pandas nor scikit-learn."""
    blocked = ("mlflow", "pandas", "sklearn", "joblib", "matplotlib")
    ran = tokt_without(blocked, world.folder, "deploy", "m.tokt", "store", "--json")
    assert ran.returncode == 0, ran.stderr
    assert json.loads(ran.stdout)["name"] == "tiny-lbp"
