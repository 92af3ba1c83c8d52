"""A user's own MLflow runs in a workspace's registry: where their files are kept."""

import shutil
import sqlite3
import subprocess
import sys
import tempfile
from contextlib import closing
from pathlib import Path

import mlflow
import pytest

from tests.calls import run_python
from tests.inference.test_faults import hold_row
from tokt.models.registry.registry import Registry

LOG = """
import mlflow
mlflow.set_tracking_uri("sqlite:///.tokt/mlflow.db")
with mlflow.start_run(run_name="mine"):
    mlflow.log_text("mine", "a.txt")
"""


def log(workspace, *names):
    """Log runs, as a user's program does that knows nothing of tokt."""
    mlflow.set_tracking_uri(f"sqlite:///{workspace / 'mlflow.db'}")
    for name in names:
        with mlflow.start_run(run_name=name):
            mlflow.log_text(name, "a.txt")


def files(workspace):
    """Each of the user's runs with its files as MLflow shows them, below the workspace."""
    registry = Registry(workspace)
    runs = mlflow.search_runs(["0"], output_format="list")
    assert all(
        run.info.artifact_uri.startswith(registry.workspace.resolve().as_uri()) for run in runs
    )
    return {
        run.info.run_name: [
            file.path for file in mlflow.artifacts.list_artifacts(run_id=run.info.run_id)
        ]
        for run in runs
    }


def content(workspace):
    with closing(sqlite3.connect(workspace / "mlflow.db")) as database:
        return list(database.iterdump())


@pytest.fixture
def old(tmp_path):
    """A workspace as an earlier tokt made it, with two runs, and the place of their files."""
    workspace, place = tmp_path / ".tokt", Path(tempfile.mkdtemp()) / "0"
    Registry(workspace, create=True).experiment_id()
    with closing(sqlite3.connect(workspace / "mlflow.db")) as database, database:
        where = "UPDATE experiments SET artifact_location = ? WHERE name = 'Default'"
        database.execute(where, [place.as_uri()])
    place.parent.rmdir()
    log(workspace, "first", "second")
    assert len(list(place.rglob("a.txt"))) == 2
    yield workspace, place
    shutil.rmtree(place.parent, ignore_errors=True)


def test_runs_of_a_new_workspace_stay_in_it(tmp_path, capfd):
    workspace = tmp_path / ".tokt"
    Registry(workspace, create=True)
    done = run_python("-c", LOG, folder=tmp_path, MLFLOW_DISABLE_TELEMETRY="true")
    assert not done.returncode, done.stderr
    before = content(workspace)
    assert files(workspace) == {"mine": ["a.txt"]}
    assert capfd.readouterr().err == "" and content(workspace) == before
    Registry(workspace).experiment_id()
    moved = tmp_path / "moved" / ".tokt"
    moved.parent.mkdir()
    workspace.rename(moved)
    Registry(moved).experiment_id()  # as `tokt train`
    log(moved, "later")
    assert files(moved) == {"mine": ["a.txt"], "later": ["a.txt"]}
    assert not workspace.exists()


def test_runs_in_a_temporary_folder_are_moved(old, run_tokt):
    workspace, place = old
    ran = run_tokt("models", "list", "--workspace", workspace)
    assert ran.code == 0 and str(place) in ran.err and "lost: none" in ran.err
    shutil.rmtree(place.parent)
    log(workspace, "third")
    assert files(workspace) == {name: ["a.txt"] for name in ("first", "second", "third")}
    assert run_tokt("models", "list", "--workspace", workspace).err == ""
    hold_row(
        "a user's own MLflow runs whose files lie in a temporary folder, as an earlier tokt had it",
        "moved into `mlartifacts` at the next command; a warning says that none is lost",
        "nothing",
    )


@pytest.mark.parametrize("gone", ["all", "one"])
def test_what_a_temporary_folder_has_lost_is_said_once(old, run_tokt, gone):
    workspace, place = old
    runs = {path.read_text(): path.parent.parent for path in place.rglob("a.txt")}
    shutil.rmtree(place.parent if gone == "all" else runs["second"])
    ran = run_tokt("models", "list", "--workspace", workspace)
    names = ran.err.rpartition("lost: ")[2].strip().split(", ")
    assert ran.code == 0 and set(names) == ({*runs} if gone == "all" else {"second"})
    assert run_tokt("models", "list", "--workspace", workspace).err == ""
    log(workspace, "third")
    kept = [] if gone == "all" else ["a.txt"]
    assert files(workspace) == {"first": kept, "second": [], "third": ["a.txt"]}
    hold_row(
        "a user's own MLflow runs whose files lay in a temporary folder that is gone",
        "new ones go into `mlartifacts`; a warning names, once, the runs without files",
        "nothing",
    )


def test_no_word_where_nobody_logged(old, run_tokt):
    workspace, place = old
    with closing(sqlite3.connect(workspace / "mlflow.db")) as database, database:
        database.execute("DELETE FROM runs")
    assert run_tokt("models", "list", "--workspace", workspace).err == ""
    location = mlflow.get_experiment("0").artifact_location
    assert location == (workspace / "mlartifacts/0").as_uri() and place.exists()


@pytest.mark.skipif(sys.platform != "linux", reason="mounts a file system")
def test_a_workspace_that_may_only_be_read(old):
    workspace, place = old
    shell = 'mount --bind "$1" "$1" && mount -o remount,ro,bind "$1" && shift && exec "$@"'
    mount = ["unshare", "-m", "sh", "-c", shell, "sh", workspace]
    command = [sys.executable, "-m", "tokt", "models", "list", "--workspace", workspace]
    done = subprocess.run([*mount, *command], capture_output=True, text=True, check=False)
    if done.returncode and "tokt" not in done.stderr:
        pytest.skip(f"no file system can be mounted here: {done.stderr.strip()[-80:]}")
    assert done.returncode == 0 and done.stderr.count("\n") == 1
    assert "they cannot be moved" in done.stderr and "Read-only file system" in done.stderr
    assert len(list(place.rglob("a.txt"))) == 2
    assert not list(workspace.rglob(".partial-*"))


def test_doctor_says_and_changes_nothing_of_it(old, run_tokt, monkeypatch):
    workspace, place = old
    before = content(workspace)
    for uri in (None, f"sqlite:///{workspace / 'mlflow.db'}"):
        if uri:
            monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
        assert "WARNING" not in run_tokt("doctor", "--workspace", workspace).err
    assert content(workspace) == before and place.exists()
    assert not (workspace / "mlartifacts/0").exists()


def test_a_copy_that_fails_is_said_and_made_later(old, monkeypatch, run_tokt):
    workspace, _ = old
    with monkeypatch.context() as broken:
        broken.setattr("os.fsync", _refuse)
        ran = run_tokt("models", "list", "--workspace", workspace)
    assert ran.code == 0 and "they cannot be moved" in ran.err
    assert not (workspace / "mlartifacts/0").exists()
    assert "lost: none" in run_tokt("models", "list", "--workspace", workspace).err


def _refuse(handle):
    raise OSError(28, "No space left on device")
