"""Completion: what bash parted is put together, and names come out of the workspace."""

import sqlite3
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import pytest

from tokt.cli.completion import complete
from tokt.models.registry.names import ALIASES, REFERENCES, registered_names

TABLES = """
    CREATE TABLE registered_models (name TEXT);
    CREATE TABLE model_versions (name TEXT, version INTEGER);
    CREATE TABLE registered_model_aliases (name TEXT, alias TEXT);
    INSERT INTO registered_models VALUES ('reef');
    INSERT INTO model_versions VALUES ('reef', 1), ('reef', 2);
    INSERT INTO registered_model_aliases VALUES ('reef', 'champion');
"""


@pytest.fixture
def workspace(tmp_path, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    monkeypatch.chdir(tmp_path)
    made = tmp_path / "names"
    for name in ("tower", "reef"):
        (made / "datasets" / name).mkdir(parents=True)
        (made / "datasets" / name / "latest").touch()
    with closing(sqlite3.connect(made / "mlflow.db")) as database:
        database.executescript(TABLES)
    return made


def completed(metavar, incomplete, workspace=None):
    context = SimpleNamespace(params={} if workspace is None else {"workspace": workspace})
    return complete(context, SimpleNamespace(metavar=metavar), incomplete)


def test_names_out_of_the_workspace(workspace):
    assert completed("DATASET", "", workspace) == ["reef", "tower"]
    assert completed("DATASET", "t", workspace) == ["tower"]
    assert completed("MODEL", "reef", workspace) == ["reef", "reef/1", "reef/2", "reef@champion"]
    assert completed("MODEL...", "reef/", workspace) == ["reef/1", "reef/2"]
    assert completed("ALIAS", "", workspace) == ["champion"]
    assert completed("DATASET|MODEL", "", workspace)[:3] == ["reef", "tower", "reef/1"]
    for metavar in ("FILE", "[NAME=]DIR", "N", "FILE|STORE", "NAME=A,B"):
        assert not completed(metavar, "", workspace)


def test_the_workspace_is_the_default_one_and_files_are_models(workspace, tmp_path):
    assert not completed("MODEL", "")
    (tmp_path / "reef.tokt").touch()
    (tmp_path / "re ef.tokt").touch()
    assert completed("MODEL", "re") == ["reef.tokt"]
    workspace.rename(tmp_path / ".tokt")
    assert ".tokt" not in completed("MODEL", "")
    assert completed("DATASET", "r") == ["reef"]
    assert completed("MODEL", "reef.") == ["reef.tokt"]


def test_a_registry_that_cannot_be_read_has_no_names(workspace, monkeypatch, tmp_path):
    file = workspace / "mlflow.db"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:9")
    assert not registered_names(workspace, REFERENCES)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{file}")
    assert registered_names(tmp_path, ALIASES) == ["champion"]
    monkeypatch.delenv("MLFLOW_TRACKING_URI")
    with closing(sqlite3.connect(file)) as database:
        database.execute("BEGIN EXCLUSIVE")
        assert not registered_names(workspace, REFERENCES)
    file.write_bytes(b"no database at all, but long enough to be taken for one" * 20)
    assert not registered_names(workspace, REFERENCES)
    assert not registered_names(tmp_path / "none", REFERENCES)
    assert not (tmp_path / "none").exists()


def test_a_registry_of_mlflow_has_the_names_that_tokt_reads(trained):
    names = registered_names(Path(trained), REFERENCES)
    assert {"tiny-lbp", "tiny-lbp/1"} <= {*names}
