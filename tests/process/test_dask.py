"""A real dask cluster: a scheduler and worker processes, each a program of its own, on loopback."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, suppress
from functools import partial

import numpy as np
import pytest
from distributed import Client

from tests.calls import free_port, succeeds
from tests.waiting import MAX_S, until
from tokt.cli.output import progress
from tokt.features.extractors.extractor import extractor_named
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import open_mission
from tokt.labels.taxonomy import Taxonomy
from tokt.models.registry.registry import Registry
from tokt.training.datasets.dataset import open_dataset, write_dataset
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.mission_source import LabelledMission, plan_from_missions, read_labels
from tokt.training.fitting.presets import settings_named
from tokt.training.parallel import mapped

SPACE = f"""
format = 1
penalties = {list(settings_named("plain").penalties)}
class_weights = ["none"]

[extractors]
better = "lbp"
worse = "lbp_10_5_frame"
"""


class Cluster:
    """A scheduler with two workers of one thread, killed at the end."""

    def __init__(self, folder, stack):
        self._folder, self._stack = folder, stack
        self.address = f"tcp://127.0.0.1:{(port := free_port())}"
        self._start("scheduler", "scheduler", "--port", str(port))
        options = ("--nthreads", "1", "--no-nanny", "--memory-limit", "1GB")
        join = ("worker", self.address, *options)
        self.workers = [self._start(name, *join) for name in ("one", "two")]
        until(self._complete, lambda: [log.read_text() for log in folder.glob("*.log")])

    def _start(self, name, *arguments):
        """A dask program; its log is ``NAME.log``."""
        command = [sys.executable, "-m", "dask", *arguments, "--host", "127.0.0.1"]
        where = {"env": {**os.environ, "DASK_TEMPORARY_DIRECTORY": str(self._folder)}}
        where["cwd"] = self._folder
        with (self._folder / f"{name}.log").open("wb") as log:
            process = subprocess.Popen(
                [*command, "--no-dashboard"], stdout=log, stderr=log, **where
            )
        self._stack.enter_context(process)
        self._stack.callback(process.kill)
        return process

    def _complete(self):
        with suppress(OSError), Client(self.address, timeout=2, set_as_default=False) as client:
            client.wait_for_workers(len(self.workers), timeout=MAX_S)
            return True


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    with ExitStack() as stack:
        yield Cluster(tmp_path_factory.mktemp("dask"), stack)


@pytest.fixture
def fresh(workspace):
    """A workspace with the tiny dataset and its model, and no features computed yet."""
    shutil.rmtree(workspace / "cache")
    return workspace


def test_a_worker_builds_the_same_dataset(cluster, tiny, trained, tmp_path):
    taxonomy = Taxonomy.load()
    records = read_labels([tiny.labels], taxonomy, DEFAULT_GRID)
    mission = LabelledMission(open_mission(tiny.path), records)
    plan, _ = plan_from_missions("tiny", "binary", [mission], taxonomy, block_frames=4)
    build = partial(write_dataset, root=tmp_path / "datasets", progress=progress)
    (there,) = mapped(build, [plan], dask=cluster.address)
    assert there.path.is_relative_to(tmp_path)
    assert there.hash == open_dataset("tiny", trained / "datasets").hash


def test_a_search_on_a_cluster_finds_the_same(cluster, fresh, trained, tmp_path):
    """Its winner is the very model that `tokt train` makes in one process."""
    (tmp_path / "space.toml").write_text(SPACE)
    asked = ("search", "tiny", "--space", tmp_path / "space.toml", "--name", "found", "--folds", 3)
    where = ("--dask", cluster.address, "--workspace", fresh)
    result = json.loads(succeeds(*asked, "--embargo", 1, "--json", *where).out)
    assert {rank["extractor"] for rank in result["ranks"]} == {"better", "worse"}
    assert result["winner"]["extractor"] == "better"
    here, there = (Registry(trained).bundle("tiny-lbp"), Registry(fresh).bundle("found"))
    assert there.model.weights.tobytes() == here.model.weights.tobytes()
    assert there.model.bias.tobytes() == here.model.bias.tobytes()
    assert there.content.metrics["patch"] == here.content.metrics["patch"]
    assert there.operating_point == here.operating_point


def test_features_are_the_same_when_a_worker_dies_at_its_work(
    cluster, trained, tmp_path, no_progress
):
    dataset = open_dataset("tiny", trained / "datasets")
    spec = extractor_named("haralick").spec
    here = cached_features(dataset, spec, tmp_path / "here", no_progress, jobs=1)
    doomed = cluster.workers.pop()
    doomed.send_signal(signal.SIGSTOP)  # takes its tasks and never ends them
    began = time.monotonic()
    threading.Timer(1.0, doomed.kill).start()
    there = cached_features(dataset, spec, tmp_path / "there", no_progress, dask=cluster.address)
    assert time.monotonic() - began >= 1.0  # it had tasks, and they were waited for
    assert np.array_equal(here, there)


@pytest.mark.parametrize("command", ["train", "search"])
def test_no_scheduler_is_one_line_within_seconds(fresh, tmp_path, run_tokt, command):
    (tmp_path / "space.toml").write_text(SPACE)
    options = {"train": ("--extractor", "lbp"), "search": ("--space", tmp_path / "space.toml")}
    address = f"tcp://127.0.0.1:{free_port()}"
    asked = ("--dask", address, "--folds", 3, "--embargo", 1, "--workspace", fresh)
    ran = run_tokt(command, "tiny", *options[command], *asked)
    assert ran.code == 2 and ran.out == ""
    errors = [line for line in ran.err.splitlines() if "error" in line]
    assert len(errors) == 1
    assert errors[0].startswith(f"tokt: error: the dask scheduler {address} cannot be reached")
