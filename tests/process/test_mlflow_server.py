"""A real MLflow server, and PostgreSQL alone, give what the workspace's file gives."""

import json
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import mlflow
import pytest

from tests.calls import call_tokt, refused, succeeds
from tests.fixtures import TRAIN_TINY, draw_tiny_frame
from tests.forking import ForkHost
from tests.models.parts import unpack
from tests.models.registry.serving import mlflow_serves
from tests.process.postgres import PASSWORD, connect, create_database, postgres, waits_for_a_lock
from tests.waiting import MAX_S, until
from tokt.models.registry.registry import Registry

TRAIN = ("train", "tiny", "--extractor", "lbp", "--preset", "plain", *TRAIN_TINY)


@pytest.fixture(scope="module")
def database():
    with postgres() as uri:
        yield uri


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """The address of an ``mlflow server``, artifacts proxied."""
    folder = tmp_path_factory.mktemp("server")
    places = ("--backend-store-uri", f"sqlite:///{folder / 'server.db'}")
    places += ("--artifacts-destination", folder / "artifacts")
    quiet = {"MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
    with mlflow_serves(folder, "/health", "server", "--workers", 1, *places, **quiet) as url:
        yield url


def _without_ids(bundle):
    """A bundle's members, with the names that MLflow drew for run and model left out."""
    content = unpack(bundle.read_bytes())
    manifest = json.loads(content.pop("manifest.json"))
    ids = [manifest["provenance"].pop(name) for name in ("mlflow_run_id", "mlflow_model_id")]
    assert len(set(ids)) == 2 and all(ids)
    card = content["card.md"]
    for name in ids:
        card = card.replace(name.encode(), b"ID")
    hashes = manifest.pop("members"), manifest.pop("manifest_sha256")
    assert set(hashes[0]) == set(content)
    return {**content, "card.md": card, "manifest.json": json.dumps(manifest).encode()}


@pytest.fixture
def elsewhere(trained, tmp_path):
    for part in ("datasets", "cache"):
        shutil.copytree(trained / part, tmp_path / ".tokt" / part)
    return tmp_path / ".tokt"


def test_the_whole_way_through_a_server_gives_the_same(
    server, elsewhere, tiny_bundle, tmp_path, monkeypatch
):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", server)
    the_whole_way(elsewhere, tiny_bundle, tmp_path)
    assert not (elsewhere / "mlartifacts").exists()


def test_the_whole_way_on_postgresql_alone(database, elsewhere, tiny_bundle, tmp_path, monkeypatch):
    """No server has a place for artifacts: they are in the workspace, wherever it is called."""
    (tmp_path / "somewhere").mkdir()
    monkeypatch.chdir(tmp_path / "somewhere")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", create_database(database, "alone"))
    the_whole_way(elsewhere, tiny_bundle, tmp_path)
    assert len(list((elsewhere / "mlartifacts" / "models").glob("*/artifacts/data/*.tokt"))) == 2
    assert list((tmp_path / "somewhere").iterdir()) == []


def test_two_trainings_at_once(database, elsewhere, preload, monkeypatch):
    """Of a model that is not there yet: each gets a number, and has it in its bundle."""
    uri = create_database(database, "shared")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    assert succeeds("models", "list", "--workspace", elsewhere).out == ""  # makes the tables
    with closing(ForkHost(preload)) as host:
        both = [host.start(*TRAIN, "--workspace", elsewhere) for _ in range(2)]
        ended = [process.wait(MAX_S) for process in both]
        assert ended == [0, 0], [process.stderr.read() for process in both]
    registry = Registry(elsewhere)
    versions = registry.versions()
    assert len(versions) == 2
    for version in versions:
        assert registry.bundle(version.label).label == version.label
        loaded = mlflow.pyfunc.load_model(f"models:/{version.label}")
        assert loaded.get_raw_model().label == version.label
    an_alias_is_set_at_the_same_time(uri, registry, versions)


def an_alias_is_set_at_the_same_time(uri, registry, versions):
    """Another process has inserted the alias, and commits while tokt waits to insert its own."""
    with closing(connect(uri)) as other, ThreadPoolExecutor(1) as pool:
        other.cursor().execute(
            "INSERT INTO registered_model_aliases (workspace, name, alias, version) "
            "SELECT workspace, name, 'champion', version FROM model_versions WHERE version = %s",
            (versions[1].version,),
        )
        setting = pool.submit(registry.set_alias, versions[0].label, "champion")
        with closing(connect(uri)) as looking:
            until(lambda: waits_for_a_lock(looking), setting.done)
        other.commit()
        assert "champion" in setting.result(MAX_S).aliases


def test_an_error_shows_no_password(database, elsewhere, monkeypatch):
    begun = time.monotonic()
    for uri, words in (
        (f"{database}_of_nobody", "does not exist"),
        (database.replace("tokt:", "nobody:"), "password authentication failed"),
        (database.replace("psycopg2", "pg8000"), "No module named 'pg8000'"),
    ):
        monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
        said = refused("the model registry at postgres", "models", "list", "--workspace", elsewhere)
        assert PASSWORD not in said and words in said
        assert PASSWORD not in call_tokt("doctor", "--json", "--workspace", elsewhere).out
    assert time.monotonic() - begun < MAX_S  # MLflow by itself would try for minutes


def the_whole_way(workspace, tiny_bundle, tmp_path):
    """Train, alias, export, promote, and load as MLflow does."""
    where = ("--workspace", workspace)
    ran = succeeds(*TRAIN, "--json", *where)
    result = json.loads(ran.out)  # nothing but the result is on standard output
    assert result["model"] == {"name": "tiny-lbp", "version": "1", "aliases": ["challenger"]}
    assert not (workspace / "mlflow.db").exists()
    succeeds("models", "alias", "tiny-lbp", "champion", *where)
    (listed,) = json.loads(succeeds("models", "list", "--json", *where).out)["models"]
    assert listed["aliases"] == ["challenger", "champion"]
    shown = succeeds("models", "show", "tiny-lbp@champion", *where)
    assert result["run_id"] in shown.out
    for name in ("a.tokt", "b.tokt"):
        succeeds("export", "tiny-lbp@champion", "-o", tmp_path / name, *where)
    assert (tmp_path / "a.tokt").read_bytes() == (tmp_path / "b.tokt").read_bytes()
    assert _without_ids(tmp_path / "a.tokt") == _without_ids(tiny_bundle)
    assert succeeds(*TRAIN, "--json", *where)
    ran = succeeds("models", "promote", "tiny-lbp", "--max-ms", 60_000, *where)
    assert "tiny-lbp/2 is now tiny-lbp@champion" in ran.out
    (workspace.parent / "compare").mkdir()
    models = ("tiny-lbp/1", "tiny-lbp/2")
    ran = succeeds("compare", *models, "-o", workspace.parent / "compare" / "c.html", *where)
    assert "MLflow run: " in ran.err
    for name in ("tiny-lbp/1", "tiny-lbp@champion"):
        succeeds("export", name, "-o", tmp_path / "c.tokt", *where)
        loaded = mlflow.pyfunc.load_model(f"models:/{name}")
        assert loaded.get_raw_model().data == (tmp_path / "c.tokt").read_bytes()
    assert loaded.get_raw_model().label == "tiny-lbp/2"
    assert loaded.predict(draw_tiny_frame(5)).status[0] == 1
