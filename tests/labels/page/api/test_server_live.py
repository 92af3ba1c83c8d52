"""Open pages hear of what anybody does, in this process or another one."""

import sys
from pathlib import Path

import pytest

from tests.waiting import until
from tokt.features.frames.grid import Grid
from tokt.labels.page.api.app import LOOK_S
from tokt.labels.record import LabelRecord, utc_now
from tokt.labels.store.store import FILE_NAME, LabelStore


@pytest.fixture(scope="module")
def server(page_server):
    return page_server("--annotator", "anna")


def test_two_people_hear_of_each_other(server):
    with server.events(who="anna") as anna, server.events(who="ben") as ben:
        setup = server.get("/api/mission", who="anna")["setup"]
        status = {"fault": "", "model": None, "settings": {}, "blind": False}
        status |= {"setup": setup, "job": None}
        assert anna.next("status") == ben.next("status") == status
        done = server.paint("two-1", 1, [3], "ocean", who="anna")
        for stream, letter, n in ((anna, "p", 1), (ben, "u", 0)):
            heard = stream.next("change")
            assert heard["event"] == done["event"]
            assert (heard["frames"], heard["by"]) == ([["left", 1]], ["anna"])
            assert heard["states"] == {"left": {"1": letter}}
            assert heard["given"] == {"left": {"1": ["ocean"] * n}}
            assert heard["counts"]["ocean"] == n
            assert (heard["undo"]["undo"] is not None) == (n == 1)


def test_another_process_writes(server):
    record = LabelRecord("tiny", "left", 9, Grid(), 2, 5, "reef", "import", utc_now())
    with server.events(who="anna") as stream:
        stream.next("status")
        with LabelStore(server.workspace / FILE_NAME) as store:
            store.add([record])
        heard = stream.next("change")
    assert LOOK_S < 1  # and so soon
    assert (heard["frames"], heard["by"]) == ([["left", 9]], ["import"])
    found = server.get("/api/labels", camera="left", frames=9, who="anna")["frames"][0]
    assert found["others"]["import"][25] == "reef"


def test_a_setting_of_the_mission_is_everybodys_also_after_a_restart(server):
    def refused(**wrong):
        body = {"who": "anna", "name": "obstacle_as", "value": "reef", **wrong}
        return server.send("/api/settings", body).status

    with server.events(who="ben") as ben:
        assert ben.next("status")["settings"] == {}
        server.post("/api/settings", who="anna", name="obstacle_as", value="reef")
        assert ben.next("status")["settings"] == {"obstacle_as": "reef"}
        with LabelStore(server.workspace / FILE_NAME) as store:  # another server's
            store.set_setting("tiny", "obstacle_as", "sand", "carl", utc_now())
        assert until(lambda: ben.next("status")["settings"] == {"obstacle_as": "sand"})
    wrong = "ocean", "unsure", "reef,ocean", "reef,", "", "reef," * 1000
    assert {refused(name="font"), *(refused(value=value) for value in wrong)} == {400}
    assert refused(value="reef,sand") == 200
    server.interrupt()
    server.start()
    assert server.get("/api/mission")["settings"] == {"obstacle_as": "reef,sand"}


def test_an_idle_stream_says_it_is_alive(server):
    with server.events(who="anna") as stream:
        stream.next("status")
        stream.next("")  # at once: the stream is open
        stream.next("")  # and again and again


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_pages_that_went_away_leave_nothing(server):
    files = Path(f"/proc/{server.process.pid}/fd")
    before = len(list(files.iterdir()))
    for _ in range(20):
        with server.events(who="anna") as stream:
            stream.next("status")
    until(lambda: len(list(files.iterdir())) <= before + 2)  # the store's own come and go
