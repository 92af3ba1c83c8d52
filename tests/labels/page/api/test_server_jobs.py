"""Other commands of tokt, started from the page; what a whole job brings is seen in a browser."""

import os
import signal
import subprocess

import pytest

from tests.waiting import MAX_S, until
from tokt.labels.store.store import LabelStore


def job(server):
    return server.get("/api/job")["job"]


def processes(*columns):
    """These columns of the table of processes, as whole numbers and words."""
    command = ["ps", "-eo", ",".join(f"{column}=" for column in columns)]
    told = subprocess.run(command, capture_output=True, text=True, check=True)
    return [line.split() for line in told.stdout.splitlines()]


def commands_of(server):
    """Processes that the server started and that still run."""
    rows = processes("ppid", "pid")
    return [int(child) for parent, child in rows if int(parent) == server.process.pid]


def group(leader):
    """Processes of a group that still run."""
    rows = processes("pgid", "stat")
    return [row for row in rows if int(row[0]) == leader and not row[1].startswith("Z")]


def test_what_a_command_says_is_the_error(page_server):
    server = page_server("--annotator", "anna")
    assert job(server) is None
    assert server.send("/api/job", {"what": "rm"}).status == 400
    server.post("/api/job", what="model")
    failed = until(lambda: (found := job(server))["state"] != "running" and found)
    assert failed["state"] == "failed" and "label" in failed["error"]


@pytest.mark.skipif(os.name != "posix", reason="needs ps")
def test_a_job_that_is_cancelled_or_left_by_the_server_leaves_nothing(page_server, tiny):
    server = page_server("--annotator", "anna")
    headers = {"Content-Type": "application/octet-stream"}
    target = "/api/import?name=anna.csv&apply=1"
    assert server.request("POST", target, tiny.labels.read_bytes(), headers).status == 200
    with LabelStore(server.workspace / "labels.db") as store:
        labels = len(store.current())
    server.post("/api/job", what="model")
    answer = server.send("/api/job", {"what": "audit"})
    assert answer.status == 409 and "running already" in answer.json["error"]
    until(lambda: job(server)["step"] == 2 and job(server)["progress"])
    (training,) = commands_of(server)
    for _ in range(2):
        assert server.post("/api/job/cancel")["job"]["state"] == "cancelled"
    until(lambda: not commands_of(server))
    assert server.get("/api/mission")["model"] is None
    server.post("/api/job", what="audit")
    (building,) = until(lambda: commands_of(server))
    server.process.send_signal(signal.SIGINT)
    assert (server.process.wait(MAX_S), server.process.stderr.read()) == (0, "")
    until(lambda: not group(training) and not group(building))
    assert not list(server.workspace.rglob(".partial-*"))
    assert not (server.workspace / "models").exists()
    with LabelStore(server.workspace / "labels.db") as store:
        assert len(store.current()) == labels
