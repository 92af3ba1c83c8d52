"""A real MLflow server, over http with artifacts proxied, gives what the workspace's file gives."""

import json
import os
import shutil
import signal
import subprocess
import sys
import urllib.error
import urllib.request
import zipfile
from contextlib import suppress

import pytest

from tests.calls import free_port, succeeds
from tests.waiting import until

pytestmark = pytest.mark.xdist_group("registry")  # `tiny_bundle` is there already


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """The address of an ``mlflow server`` with a sqlite backend, on a free loopback port."""
    folder = tmp_path_factory.mktemp("server")
    port = free_port()
    command = [sys.executable, "-m", "mlflow", "server", "--host", "127.0.0.1"]
    command += ["--port", str(port), "--workers", "1"]
    command += ["--backend-store-uri", f"sqlite:///{folder / 'server.db'}"]
    command += ["--artifacts-destination", str(folder / "artifacts")]
    quiet = {"MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false", "MLFLOW_DISABLE_TELEMETRY": "true"}
    environment = {**os.environ, **quiet}
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            command, env=environment, cwd=folder, stdout=log, stderr=log, start_new_session=True
        )
        try:
            _wait_for(f"http://127.0.0.1:{port}/health", process, folder / "log")
            yield f"http://127.0.0.1:{port}"
        finally:
            os.killpg(process.pid, signal.SIGTERM)  # it and its worker, of this session only
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait(10)


def _wait_for(url, process, log):
    def answers():
        assert process.poll() is None, log.read_text()
        with (
            suppress(urllib.error.URLError, ConnectionError, TimeoutError),
            urllib.request.urlopen(url, timeout=2) as answer,
        ):
            return bool(answer.status == 200)
        return False

    until(answers, log.read_text)


def _without_ids(bundle):
    """A bundle's members, with the names that MLflow drew for run and model left out."""
    with zipfile.ZipFile(bundle) as members:
        content = {name: members.read(name) for name in members.namelist()}
    manifest = json.loads(content.pop("manifest.json"))
    ids = [manifest["provenance"].pop(name) for name in ("mlflow_run_id", "mlflow_model_id")]
    assert len(set(ids)) == 2 and all(ids)
    card = content["card.md"]
    for name in ids:
        card = card.replace(name.encode(), b"ID")
    hashes = manifest.pop("members"), manifest.pop("manifest_sha256")
    assert set(hashes[0]) == set(content)
    return {**content, "card.md": card, "manifest.json": json.dumps(manifest).encode()}


def test_the_whole_way_through_a_server_gives_the_same(
    server, trained, tiny_bundle, tmp_path, monkeypatch
):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", server)
    shutil.copytree(trained / "datasets", tmp_path / ".tokt" / "datasets")
    shutil.copytree(trained / "cache", tmp_path / ".tokt" / "cache")
    where = ("--workspace", tmp_path / ".tokt")
    training = ("train", "tiny", "--extractor", "lbp", "--preset", "plain", "--folds", 3)
    ran = succeeds(*training, "--embargo", 1, "--json", *where)
    result = json.loads(ran.out)  # nothing but the result is on standard output
    assert result["model"] == {"name": "tiny-lbp", "version": "1", "aliases": ["challenger"]}
    assert not (tmp_path / ".tokt" / "mlflow.db").exists()
    assert not (tmp_path / ".tokt" / "mlartifacts").exists()
    succeeds("models", "alias", "tiny-lbp", "champion", *where)
    (listed,) = json.loads(succeeds("models", "list", "--json", *where).out)["models"]
    assert listed["aliases"] == ["challenger", "champion"]
    shown = succeeds("models", "show", "tiny-lbp@champion", *where)
    assert result["run_id"] in shown.out
    for name in ("a.tokt", "b.tokt"):
        succeeds("export", "tiny-lbp@champion", "-o", tmp_path / name, *where)
    assert (tmp_path / "a.tokt").read_bytes() == (tmp_path / "b.tokt").read_bytes()
    assert _without_ids(tmp_path / "a.tokt") == _without_ids(tiny_bundle)
