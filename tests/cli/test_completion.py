"""Completion: what bash parted is put together, and names come out of the workspace."""

import sqlite3
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.calls import run_python
from tokt.cli import completion
from tokt.cli.completion import complete, join_bash_words
from tokt.features.extractors.named_extractors import extractor_named
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


@pytest.mark.parametrize(
    ("parted", "whole"),
    [
        (["tokt", "evaluate", "to"], ["tokt", "evaluate", "to"]),
        (["tokt", "evaluate", "to", "@", "ch"], ["tokt", "evaluate", "to@ch"]),
        (["tokt", "evaluate", "to", "@"], ["tokt", "evaluate", "to@"]),
        (["tokt", "evaluate", "to", "@", ""], ["tokt", "evaluate", "to@"]),
        (["tokt", "train", "--preset", "=", "be"], ["tokt", "train", "--preset=be"]),
        (
            ["tokt", "run", "--udp", "v2", "@", "ship", ":", "1130"],
            ["tokt", "run", "--udp", "v2@ship:1130"],
        ),
    ],
)
def test_what_bash_parted_is_put_together(parted, whole, monkeypatch):
    monkeypatch.setattr(completion, "_parted", False)
    told = {"COMP_WORDS": "\n".join(parted), "COMP_CWORD": str(len(parted) - 1)}
    join_bash_words(told)
    assert told["COMP_WORDS"].split("\n") == whole
    assert told["COMP_CWORD"] == str(len(whole) - 1)


def test_a_word_in_the_middle_stays_the_one_that_is_completed(monkeypatch):
    monkeypatch.setattr(completion, "_parted", False)
    words = ["tokt", "compare", "a", "@", "x", "b", "c", ":", "d"]
    told = {"COMP_WORDS": "\n".join(words), "COMP_CWORD": "5"}
    join_bash_words(told)
    joined = told["COMP_WORDS"].split("\n")
    assert (
        joined == ["tokt", "compare", "a@x", "b", "c:d"] and joined[int(told["COMP_CWORD"])] == "b"
    )


def test_bash_is_told_what_takes_the_place_of_the_last_part(workspace, monkeypatch):
    assert completed("MODEL", "reef@ch", workspace) == ["reef@champion"]
    for words, put in ((["reef", "@", "ch"], "@champion"), (['"reef@ch'], "reef@champion")):
        told = {"COMP_WORDS": "\n".join(["tokt", *words]), "COMP_CWORD": str(len(words))}
        join_bash_words(told)
        assert completed("MODEL", "reef@ch", workspace) == [put]
    monkeypatch.setattr(completion, "_parted", True)
    assert completed("MODEL", "ree", workspace)[0] == "reef"


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


def test_a_workspace_on_the_line_is_asked(workspace):
    for folder, names in ((workspace, "reef\ntower"), (workspace / "none", "")):
        told = {
            **{"_TOKT_COMPLETE": "complete_bash", "COMP_CWORD": "4"},
            "COMP_WORDS": f"tokt\ntrain\n--workspace\n{folder}\n",
        }
        code = "import sys; from tokt.cli import main; sys.argv = ['tokt']; main()"
        done = run_python("-c", code, **told)
        assert (done.returncode, done.stdout.strip(), done.stderr) == (0, names, "")


def test_choices_and_extractors():
    assert completed("thesis|plain|water|best", "") == ["thesis", "plain", "water", "best"]
    assert completed("N|auto", "a") == ["auto"] and completed("v1|v2", "v") == ["v1", "v2"]
    names = completed("EXTRACTOR", "haralick+l")
    assert "haralick+lbp" in names
    for name in names:
        assert extractor_named(name).dim > 13


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
