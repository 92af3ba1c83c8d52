"""Other commands of tokt, started from the page: real ones, on a mission with labels."""

import os
import signal
import subprocess

import pytest

from tests.waiting import MAX_S, until
from tokt.labels.store.store import LabelStore
from tokt.models.bundle.bundle import read_bundle


@pytest.fixture
def server(page_server, tiny, tmp_path):
    """All of the tiny mission is labelled, by anna."""
    return labelled(page_server("--annotator", "anna", workspace=tmp_path / "w"), tiny)


def labelled(server, tiny):
    headers = {"Content-Type": "application/octet-stream"}
    target = "/api/import?name=anna.csv&apply=1"
    assert server.request("POST", target, tiny.labels.read_bytes(), headers).status == 200
    return server


def job(server):
    return server.get("/api/job")["job"]


def ended(server):
    return until(lambda: (found := job(server))["state"] != "running" and found)


def commands_of(server):
    """Processes that the server started and that still run."""
    tree = subprocess.run(
        ["ps", "-eo", "ppid=,pid="], capture_output=True, text=True, check=True
    ).stdout
    pairs = [line.split() for line in tree.splitlines()]
    return [int(child) for parent, child in pairs if int(parent) == server.process.pid]


def test_a_model_suggests_without_a_restart(page_server, tiny, tiny_bundle, tmp_path):
    server = labelled(page_server("--model", tiny_bundle, workspace=tmp_path / "w"), tiny)
    assert job(server) is None
    with server.events(who="anna") as stream:
        before = stream.next("status")
        assert before["job"] is None and before["model"] is not None
        assert server.post("/api/job", what="model")["job"]["state"] == "running"
        answer = server.send("/api/job", {"what": "audit"})
        assert answer.status == 409 and "running already" in answer.json["error"]
        told = [before]
        while (told[-1]["job"] or {"state": "running"})["state"] == "running":
            told.append(stream.next("status"))
    done = ended(server)
    assert (done["state"], done["step"], done["error"]) == ("done", 3, ""), done
    steps = [one["job"]["progress"] for one in told if one["job"] and one["job"]["progress"]]
    assert {"features", "cross-validation"} & {step["what"] for step in steps}
    assert all(0 <= step["done"] <= step["total"] for step in steps)
    assert told[-1]["setup"] != before["setup"]
    bundle = read_bundle(server.workspace / "models" / "tiny.tokt")
    assert server.get("/api/mission")["model"]["label"] == bundle.label == "tiny/1"
    found = server.get("/api/labels", camera="left", frames="3", suggest=1)["frames"][0]
    assert found["suggestions"]["model"] == "tiny/1"
    assert server.interrupt() == 0


def test_an_audit(server):
    server.post("/api/job", what="audit")
    done = ended(server)
    assert (done["state"], done["step"], done["steps"]) == ("done", 2, 2), done
    assert any("labels contradicted" in line for line in done["lines"])
    assert [path.name.partition("@")[0] for path in (server.workspace / "audits").iterdir()] == [
        "tiny"
    ]


def test_what_a_command_says_is_the_error(page_server, server, tmp_path, monkeypatch):
    empty = page_server(workspace=tmp_path / "empty")
    empty.post("/api/job", what="model")
    assert ended(empty)["state"] == "failed" and "label" in job(empty)["error"]
    (tmp_path / "path" / "mlflow").mkdir(parents=True)
    (tmp_path / "path" / "mlflow" / "__init__.py").write_text(
        'raise ModuleNotFoundError("No module named \'mlflow\'", name="mlflow")\n'
    )
    shadowed = [str(tmp_path / "path"), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(shadowed))
    server.kill()
    server.start().post("/api/job", what="model")
    assert ended(server)["error"] == "this command needs mlflow: install the extra 'train'"
    assert server.send("/api/job", {"what": "rm"}).status == 400


@pytest.mark.skipif(os.name != "posix", reason="needs ps")
@pytest.mark.parametrize("how", ["cancel", "end"])
def test_a_job_that_is_cancelled_leaves_nothing(server, how):
    server.post("/api/job", what="model")
    until(lambda: job(server)["step"] == 2 and job(server)["progress"])
    (command,) = commands_of(server)
    with LabelStore(server.workspace / "labels.db") as store:
        labels = len(store.current())
    if how == "cancel":
        assert server.post("/api/job/cancel")["job"]["state"] == "cancelled"
        assert server.post("/api/job/cancel")["job"]["state"] == "cancelled"
        until(lambda: not commands_of(server))
        assert server.get("/api/mission")["model"] is None
    server.process.send_signal(signal.SIGINT)
    assert (server.process.wait(MAX_S), server.process.stderr.read()) == (0, "")
    until(lambda: not group(command))
    assert not list(server.workspace.rglob(".partial-*"))
    assert not (server.workspace / "models").exists()
    with LabelStore(server.workspace / "labels.db") as store:
        assert len(store.current()) == labels


def group(leader):
    """Processes of a group that still run."""
    told = subprocess.run(["ps", "-eo", "pgid=,stat="], capture_output=True, text=True, check=True)
    rows = [line.split() for line in told.stdout.splitlines()]
    return [row for row in rows if int(row[0]) == leader and not row[1].startswith("Z")]
