"""Other commands of tokt, started from the page; what a whole job brings is seen in a browser."""

import os
import signal
import subprocess

import psutil
import pytest

from tests.waiting import MAX_S, until
from tokt.labels.store.store import LabelStore


def heard(server, true):
    """The job when something is true of it, as a page hears of it."""
    with server.events(who="anna") as stream:
        while not true(job := stream.next("status")["job"]):
            pass
    return job


def commands_of(server):
    """Processes that the server started and that still run."""
    return [child.pid for child in psutil.Process(server.process.pid).children()]


def group(leader):
    """Processes of a group that still run."""
    command = ["ps", "-eo", "pgid=,stat="]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return [row for row in told.splitlines() if int(row.split()[0]) == leader and "Z" not in row]


def test_what_a_command_says_is_the_error(page_server):
    server = page_server("--annotator", "anna")
    assert server.get("/api/job")["job"] is None
    assert server.send("/api/job", {"what": "rm"}).status == 400
    server.post("/api/job", what="model")
    failed = heard(server, lambda job: job["state"] != "running")
    assert failed.items() <= server.get("/api/job")["job"].items()
    assert failed["state"] == "failed" and "label" in failed["error"]


@pytest.mark.skipif(os.name != "posix", reason="needs ps")
def test_a_job_that_is_cancelled_or_left_by_the_server_leaves_nothing(
    page_server, tiny_truth, tmp_path
):
    rows = [row for row in tiny_truth.labels() if row[2] % 4 == 0]
    file = tiny_truth.write_labels(tmp_path / "anna.csv", rows)
    server = page_server("--annotator", "anna")
    headers = {"Content-Type": "application/octet-stream"}
    target = "/api/import?name=anna.csv&apply=1"
    assert server.request("POST", target, file.read_bytes(), headers).status == 200
    with LabelStore(server.workspace / "labels.db") as store:
        labels = len(store.current())
    server.post("/api/job", what="model")
    answer = server.send("/api/job", {"what": "audit"})
    assert answer.status == 409 and "running already" in answer.json["error"]
    heard(server, lambda job: job["step"] == 2 and job["progress"])
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
