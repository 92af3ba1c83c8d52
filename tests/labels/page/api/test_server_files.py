"""Label files through the page: what is downloaded and taken is what the command line writes."""

import io
import signal
import sqlite3
import zipfile
from contextlib import closing
from urllib.parse import urlencode

import pytest

from tests.calls import succeeds
from tests.waiting import MAX_S
from tokt.labels.formats import NAMES
from tokt.labels.page.api.access import MAX_UPLOAD
from tokt.labels.store.store import LabelStore

BINARY = {"Content-Type": "application/octet-stream"}


@pytest.fixture
def server(page_server, tmp_path):
    """Anna and ben labelled some patches of one frame."""
    server = page_server("--annotator", "anna", workspace=tmp_path / "w")
    server.paint("f-1", 1, [0, 1], "ocean")
    server.paint("f-2", 1, [1], "reef", base="ocean")
    server.paint("f-3", 1, [2], "sand", who="ben")
    return server


def upload(server, data, **query):
    return server.request("POST", f"/api/import?{urlencode(query, True)}", data, BINARY)


def stored(server):
    with LabelStore(server.workspace / "labels.db") as store:
        return {(one.annotator, one.row, one.col): one.label for one in store.current()}


def test_each_format_is_what_the_command_line_writes(server, tmp_path):
    for name in NAMES:
        query = {"format": name, "full": 1}
        answer = server.request("GET", f"/api/export?{urlencode(query)}")
        assert answer.status == 200, answer.body
        assert answer.headers["Content-Type"] == "application/octet-stream"
        told = server.get("/api/export", check=1, **query)
        assert told["labels"] == 3 and told["file"] in answer.headers["Content-Disposition"]
        assert "1 earlier label left out: files hold those in force" in told["lost"]
        here = tmp_path / f"by-command-{name}"
        options = ("--format", name, "--full", "--mission-dir", server.mission)
        succeeds("labels", "export", here, *options, "--workspace", server.workspace)
        if here.is_dir():
            with zipfile.ZipFile(io.BytesIO(answer.body)) as packed:
                found = {file: packed.read(file) for file in packed.namelist() if file[-1] != "/"}
            files = [file for file in here.rglob("*") if file.is_file()]
            assert found == {str(file.relative_to(here)): file.read_bytes() for file in files}
        else:
            assert answer.body == here.read_bytes(), name
    assert not list((server.workspace / "cache").iterdir())  # what was made for it is gone


def test_only_hers_and_what_cannot_be_exported(server):
    hers = server.request("GET", "/api/export?format=csv&only=anna").body.decode().splitlines()
    assert hers[1:] == ["tiny,left,1,0,0,ocean", "tiny,left,1,0,1,reef"]
    server.post("/api/blind", who="carl", blind=True)
    for query, status in (
        ({"format": "nothing"}, 400),
        ({"format": "csv"}, 409),  # six columns cannot tell two people apart
        ({"format": "csv", "only": "carl"}, 409),
        ({"format": "coco", "who": "carl"}, 403),
    ):
        answer = server.request("GET", f"/api/export?{urlencode(query)}")
        assert answer.status == status and list(answer.json) == ["error"], query
    server.post("/api/blind", who="anna", blind=True)
    assert server.request("GET", "/api/export?format=csv&only=anna&who=anna").status == 200
    assert server.request("GET", "/api/export?format=csv&only=ben&who=anna").status == 403
    server.post("/api/blind", who="anna", blind=False)


def test_an_import_is_tried_first_and_then_told_to_all(server):
    lines = ["mission,camera,frame,row,col,label", "tiny,left,1,0,1,sand", "tiny,left,2,3,4,kelp"]
    data, before = "\n".join(lines).encode(), stored(server)
    name = "C:\\fakepath\\carl.csv"
    assert upload(server, data, name=name).json == {
        **{"file": "carl.csv", "format": "csv", "applied": False, "unknown": ["kelp"]}
    }
    assert upload(server, data, name=name, apply=1).status == 409
    query = {"name": name, "map": ["kelp=reef"]}
    tried = upload(server, data, **query).json
    counts = {"new": 2, "changed": 0, "unchanged": 0, "suggestions": 0, "settled": 0}
    assert counts.items() <= tried.items() and not tried["applied"]
    assert (tried["labels"], tried["here"], tried["annotators"]) == (2, 2, ["carl"])
    assert stored(server) == before
    with server.events(who="anna") as stream:
        stream.next("status")
        done = upload(server, data, apply=1, **query).json
        assert done == {**tried, "applied": True}
        assert stream.next("change")["frames"] == [["left", 1], ["left", 2]]
    assert stored(server) == before | {("carl", 0, 1): "sand", ("carl", 3, 4): "reef"}
    again = upload(server, data, annotator="carl", **query).json
    assert (again["new"], again["unchanged"]) == (0, 2)


def test_what_comes_back_is_what_went_out(server, page_server, tmp_path):
    for name, file in (("csv", "a.csv"), ("coco", "a.json"), ("viame", "a.csv")):
        data = server.request("GET", f"/api/export?format={name}&full=1").body
        other = page_server(workspace=tmp_path / name)
        assert upload(other, data, name=file, apply=1).status == 200
        assert stored(other) == stored(server)
        other.kill()


def test_files_that_are_wrong_write_nothing(server):
    before = stored(server)
    good = b"mission,camera,frame,row,col,label\ntiny,left,3,0,0,ocean\n"
    for data, name, said in (
        (good.replace(b"0,0,ocean", b"0,99,ocean"), "x.csv", "x.csv line 2: row 0 col 99"),
        (b"\xff\xfe\x00", "x.csv", "x.csv"),
        (b"[1, 2", "x.json", "x.json"),
        (good, "x.exe", "label files end in"),
        (b"", "x.csv", "the file is empty"),
    ):
        answer = upload(server, data, name=name, apply=1)
        assert answer.status == 409 and said in answer.json["error"], answer.body
        assert str(server.workspace) not in answer.json["error"]
    for name in ("..", "", "a/..", "a\n.csv"):
        assert upload(server, good, name=name).status == 400
    assert upload(server, good, name="x.csv", format="nothing").status == 400
    assert stored(server) == before
    query = "/api/import?name=x.csv&apply=1"
    assert server.request("POST", query, good, {"Content-Type": "text/csv"}).status == 415
    length = {**BINARY, "Content-Length": str(MAX_UPLOAD + 1)}
    assert server.request("POST", query, b"", length).status == 413
    cross = {**BINARY, "Origin": "http://attacker.example"}
    assert server.request("POST", query, good, cross).status == 403
    assert server.request("POST", query, good, {**BINARY, "Authorization": ""}).status == 401
    with closing(server.connect()) as connection:  # one that breaks off
        connection.putrequest("POST", query)
        for header, value in {**server.authority, **BINARY, "Content-Length": "1000"}.items():
            connection.putheader(header, value)
        connection.endheaders(good)
    assert upload(server, b"x" * 2_000_000, name="long.csv").status == 409
    assert stored(server) == before
    server.process.send_signal(signal.SIGINT)
    assert (server.process.wait(MAX_S), server.process.stderr.read()) == (0, "")


def test_a_backup_is_a_store(server, tmp_path):
    answer = server.request("GET", "/api/backup")
    assert answer.status == 200 and ".db" in answer.headers["Content-Disposition"]
    copy = tmp_path / "copy" / "labels.db"
    copy.parent.mkdir()
    copy.write_bytes(answer.body)
    with closing(sqlite3.connect(copy)) as found:
        assert found.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    with LabelStore(copy, create=False) as store:
        assert len(store.current()) == 3
