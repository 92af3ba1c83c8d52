"""SIGKILL at any moment of a command: what was there still loads, and the command can be repeated.

A host process imports everything once and forks a child for each command, so that the kills fall
into the work and not into a second of imports.
"""

import os
import random
import shutil
import signal
import subprocess
import time
from contextlib import closing, suppress

import pytest

from tests.forking import ForkHost
from tests.waiting import MAX_S
from tokt.features.frames.grid import Grid
from tokt.labels.formats.label_csv import read_label_csv
from tokt.labels.store.store import LabelStore
from tokt.labels.taxonomy import Taxonomy
from tokt.models.bundle.bundle import read_bundle
from tokt.models.registry.registry import Registry
from tokt.models.store.store import Store
from tokt.training.datasets.dataset import list_datasets, open_dataset

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
TRIALS = 3

NEW_REGISTRY = "new registry"  # what no command does alone: makes one in the folder that follows
PROGRAM = f"""
import os, sys
from pathlib import Path
from tokt.cli import main
from tokt.models.registry.registry import Registry
try:
    main() if sys.argv[1] != {NEW_REGISTRY!r} else Registry(Path(sys.argv[2]), create=True)
except SystemExit as ended:
    sys.stderr.flush()
    os._exit(ended.code or 0)
os._exit(0)
"""
"""Ends at once, so that no kill falls into what Python does at its end."""


class Commands(ForkHost):
    def run(self, *command, kill_after_s=None, begun=lambda: True):
        """Exit code, or minus the signal that ended it: so long after `begun` became true."""
        child = self.start(*command)
        if kill_after_s is not None:
            give_up = time.monotonic() + MAX_S
            while not begun() and time.monotonic() < give_up:
                time.sleep(0.0002)
            with suppress(subprocess.TimeoutExpired):
                child.wait(kill_after_s)
            child.kill()
        with child.stdout, child.stderr:
            code = child.wait(MAX_S)
            assert code in (0, -signal.SIGKILL), child.stderr.read()
        return code


@pytest.fixture(scope="module")
def host(preload):
    with closing(Commands(preload, PROGRAM)) as made:
        yield made


def moments(rng, duration_s, trials):
    """Seeded moments all over a command's duration; then ever earlier ones, as long as asked.

    A machine that was busier while the duration was measured lets the later kills miss.
    """
    for trial in range(trials):
        yield duration_s * (trial + rng.random()) / trials
    for again in range(30):
        yield duration_s * rng.random() / (2 + again)


def kill_until_hit(host, command, sound, rng, duration_s, trials=TRIALS, hits=1):
    for trial, moment in enumerate(moments(rng, duration_s, trials)):
        if trial >= trials and hits <= 0:
            return
        hits -= host.run(*command, kill_after_s=moment) == -signal.SIGKILL
        sound()
    assert hits <= 0, "the kills come too late; the test proves nothing"


def took_s(host, *command):
    begun = time.monotonic()
    assert host.run(*command) == 0
    return time.monotonic() - begun


def kill_often(host, command, sound, trials=TRIALS):
    """Run once whole for its duration, then kill it at seeded moments, then run it whole again."""
    duration_s = took_s(host, *command)
    kill_until_hit(host, command, sound, random.Random(1), duration_s, trials)
    assert host.run(*command) == 0
    sound()


@pytest.fixture
def registry_sound(workspace, tiny_bundle):
    """Everything listed exports, and version 1 to the very bytes of before."""
    original = tiny_bundle.read_bytes()

    def check():
        registry = Registry(workspace)
        for version in registry.versions():
            assert registry.bundle(version.label).label == version.label
        assert registry.bundle("tiny-lbp/1").data == original

    return check


def test_dataset_build(host, workspace, tiny):
    root = workspace / "datasets"
    before = open_dataset("tiny", root).hash
    seen = set()

    def sound():
        for dataset in list_datasets(root):
            dataset.check()
            for index in range(len(dataset.frames)):
                dataset.read_frame(index)
            seen.add(dataset.label)
        open_dataset("tiny", root).check()
        assert open_dataset(f"tiny@{before}", root).hash == before

    # Another block size than it has: otherwise the content is there and little is written.
    command = ("dataset", "build", "tiny", "--mission", tiny.path, "--labels", tiny.labels)
    named = (*command, "--block", 3, "--workspace", workspace)
    duration_s = took_s(host, *named[:2], "timing", *named[3:])
    kill_until_hit(host, named, sound, random.Random(3), duration_s)
    assert host.run(*named) == 0
    sound()
    assert len(seen) == 3  # tiny with both block sizes, and the one for timing


def test_train(host, workspace, registry_sound):
    def sound():
        registry_sound()
        shutil.rmtree(workspace / "cache")  # so that kills fall into the features too

    shutil.rmtree(workspace / "cache")
    command = ("train", "tiny", "--extractor", "lbp", "--preset", "plain", "--folds", 3)
    whole = (*command, "--embargo", 1, "--workspace", workspace)
    kill_often(host, whole, sound)
    assert len(Registry(workspace).versions()) >= 3


def test_first_use_of_a_registry(host, tmp_path):
    """Killed while MLflow makes its tables: they are all there or not at all."""
    duration_s, workspace = took_s(host, NEW_REGISTRY, tmp_path / "whole"), tmp_path / "killed"

    def sound():
        if (workspace / "mlflow.db").exists():
            assert Registry(workspace).versions() == []
            (workspace / "mlflow.db").unlink()

    command = (NEW_REGISTRY, workspace)
    kill_until_hit(host, command, sound, random.Random(4), duration_s)
    assert Registry(workspace, create=True).versions() == []  # beside what the kills left


def test_alias(host, workspace, registry_sound):
    command = ("models", "alias", "tiny-lbp/1", "champion", "--workspace", workspace)

    def sound():
        assert Registry(workspace).find("tiny-lbp@champion").version == "1"

    kill_often(host, command, sound)
    registry_sound()


def test_export(host, workspace, tiny_bundle, tmp_path):
    target = tmp_path / "out" / "m.tokt"

    def sound():
        assert target.read_bytes() == tiny_bundle.read_bytes()

    command = ("export", "tiny-lbp", "-o", target, "--workspace", workspace)
    kill_often(host, command, sound, trials=2)


def test_export_while_the_file_is_written(host, workspace, tmp_path):
    rng = random.Random(2)
    for trial in range(TRIALS):
        target = tmp_path / str(trial) / "m.tokt"
        target.parent.mkdir()
        command = ("export", "tiny-lbp", "-o", target, "--workspace", workspace)
        moment = rng.uniform(0, 0.004)
        host.run(*command, kill_after_s=moment, begun=lambda: any(target.parent.iterdir()))  # noqa: B023
        assert not target.exists() or read_bundle(target).label == "tiny-lbp/1"
    assert host.run(*command) == 0
    assert read_bundle(target).label == "tiny-lbp/1"


def test_deploy(host, tiny_bundle, tmp_path):
    place = tmp_path / "store"
    command = ("deploy", tiny_bundle, place, "--reason", "kill test")

    def sound():
        store = Store(place)
        assert store.active().label == "tiny-lbp/1"
        numbers = [entry.number for entry in store.history()]
        assert numbers == list(range(1, len(numbers) + 1))

    kill_often(host, command, sound)


def test_labels_import(host, workspace, tiny):
    expected = len(read_label_csv(tiny.labels, Taxonomy.load()))
    command = ("labels", "import", tiny.labels, "--workspace", workspace)
    rng = random.Random(3)
    for trial in range(TRIALS):
        host.run(*command, "--annotator", f"p{trial}", kill_after_s=rng.uniform(0, 0.3))
        if (workspace / "labels.db").exists():
            with LabelStore(workspace / "labels.db", create=False) as store:
                counts = [len(store.current(annotator=who)) for who in store.annotators()]
            assert set(counts) <= {expected}  # all of a file, or nothing
    assert host.run(*command) == 0
    with LabelStore(workspace / "labels.db", create=False) as store:
        assert len(store.current(annotator="labels", grid=Grid())) == expected
