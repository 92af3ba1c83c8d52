"""Labels, actions, undo and what is answered when something is wrong with them."""

import json
import resource
import sys
from contextlib import closing
from urllib.parse import quote

import psutil
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tests.waiting import until
from tokt.features.frames.grid import Grid
from tokt.labels.record import LabelRecord
from tokt.labels.store.store import FILE_NAME, LabelStore

TIME = "2016-04-20T10:00:00Z"
COUNTS = dict.fromkeys(("ocean", "other", "sand", "reef", "subsea_installation", "unsure"), 0)


@pytest.fixture(scope="module")
def server(page_server):
    return page_server("--annotator", "anna")


def _frame(server, frame, who="anna"):
    return server.get("/api/labels", camera="left", frames=frame, who=who)["frames"][0]


def _mine(server, frame, who="anna"):
    return _frame(server, frame, who)["mine"]


def _is_refused(answer, *statuses):
    """The answer is one line with a reason."""
    assert answer.status in statuses, answer.body
    assert list(answer.json) == ["error"] and "\n" not in answer.json["error"]


def test_mission(server):
    mission = server.get("/api/mission")
    assert (mission["mission"], mission["annotator"], mission["fault"]) == ("tiny", "anna", "")
    assert mission["grid"] == {"rows": 10, "cols": 10, "width": 360}
    assert mission["cameras"] == {"left": {"ranges": [[1, 40]], "count": 40}}
    assert mission["given"] == {} and mission["single_pictures"] is False
    assert len(mission["states"]["left"]) == 40 and mission["model"] is None
    assert [known["name"] for known in mission["classes"]] == list(COUNTS)
    unsure = {"name": "unsure", "obstacle": None, "color": "#e6e6e6", "key": "u"}
    described = {**unsure, "description": "Looked at, and could not be decided."}
    assert mission["classes"][-1] == described
    assert mission["undo"] == {"undo": None, "redo": None}
    nobody = server.get("/api/queue", n=3)
    assert nobody["frames"] == [] and "--model" in nobody["why_not"]


def test_an_action_and_its_undo(server):
    done = server.paint("act-1", 1, [0, 1, 99], "ocean", who="dora")
    head = {"key": "act-1", "kind": "paint", "camera": "left", "frame": 1}
    head |= {"changed": 3, "frames": 1}
    assert done == {
        **{"key": "act-1", "event": done["event"], "changed": 3, "repeated": False},
        **{
            "conflicts": [],
            "masked": 0,
            "states": {"left": {"1": "p"}},
            "counts": {**COUNTS, "ocean": 3},
        },
        "given": {"left": {"1": ["ocean"]}},
        "undo": {"undo": head, "redo": None},
    }
    mine = _mine(server, 1, "dora")
    assert [cell for cell, label in enumerate(mine) if label] == [0, 1, 99]
    again = server.paint("act-1", 1, [0, 1, 99], "ocean", who="dora")
    assert again == {**done, "repeated": True}

    step = {"who": "dora", "time": TIME}
    undone = server.post("/api/undo", key="undo-1", target="act-1", **step)
    assert (undone["kind"], undone["frames"], undone["changed"]) == ("paint", [["left", 1]], 3)
    assert undone["undo"] == {"undo": None, "redo": head}
    assert undone["given"] == {"left": {"1": []}}
    assert undone["states"] == {"left": {"1": "u"}} and undone["counts"] == COUNTS
    assert _mine(server, 1, "dora") == [None] * 100
    assert server.post("/api/undo", key="undo-2", **step) == {"nothing": True}
    redone = server.post("/api/redo", key="redo-1", **step)
    assert redone["undo"] == {"undo": head, "redo": None} and redone["counts"]["ocean"] == 3
    other = server.send("/api/undo", {"key": "undo-3", "target": "act-0", **step})
    assert other.status == 409 and "\n" not in other.json["error"]


def test_two_annotators_settle(server):
    server.paint("two-1", 6, [0, 1, 2], "ocean", who="anna")
    server.paint("two-2", 6, [0, 1, 3], "reef", who="ben")
    server.paint("two-3", 6, [1], "ocean", who="ben", base="reef")
    found = server.get("/api/agreement", a="anna", b="ben")
    assert (found["n_both"], found["confusion"]) == (2, [[1, 1], [0, 0]])
    conflict = {"camera": "left", "frame": 6, "cell": 0, "a": "ocean", "b": "reef", "sure": True}
    assert found["conflicts"] == [{**conflict, "settled": None, "settled_by": None}]
    done = server.paint("two-4", 6, [0], "reef", who="carl", source="settled", kind="settle")
    assert done["states"] == {"left": {"6": "u"}}
    settled = server.get("/api/agreement", a="anna", b="ben")["conflicts"]
    assert settled == [{**conflict, "settled": "reef", "settled_by": "carl"}]
    frame = _frame(server, 6)
    assert frame["mine"][0] == "ocean" and frame["others"]["ben"][0] == "reef"
    assert frame["settled"][0] == "reef" and "carl" not in frame["others"]
    for a, b, status in (("anna", "anna", 400), ("anna", "eve", 404)):
        assert server.request("GET", f"/api/agreement?a={a}&b={b}").status == status
    server.paint("two-5", 7, [0], "ocean", who="zoe")
    assert server.request("GET", "/api/agreement?a=zoe&b=ben").status == 409


SAID = {0: ("ocean", "ocean"), 1: ("reef", "kelp"), 2: ("kelp", "kelp"), 3: ("kelp", "sand")}


def test_conflicts_of_a_class_that_left_the_taxonomy_are_told_and_settled(page_server, tmp_path):
    with LabelStore(tmp_path / FILE_NAME) as store:
        store.add(
            LabelRecord("tiny", "left", 10, Grid(), 0, cell, label, who, TIME)
            for cell, labels in SAID.items()
            for who, label in zip(("anna", "ben"), labels, strict=True)
        )
    server = page_server("--annotator", "anna", workspace=tmp_path)
    found = server.get("/api/agreement", a="anna", b="ben")
    assert found["unknown"] == ["kelp"] and "kelp" in found["labels"]
    conflicts = [(one["cell"], one["a"], one["b"]) for one in found["conflicts"]]
    assert conflicts == [(1, "reef", "kelp"), (3, "kelp", "sand")]
    server.paint("kelp-1", 10, [1, 3], "sand", kind="settle", source="settled")
    found = server.get("/api/agreement", a="anna", b="ben")
    assert [one["settled"] for one in found["conflicts"]] == ["sand", "sand"]


def test_seen_frames_and_frames_of_somebody(server):
    seen = {"who": "anna", "camera": "left", "frame": 30}
    assert server.post("/api/seen", **seen) == {"states": {"left": {"30": "s"}}}
    assert server.get("/api/mission", who="anna")["states"]["left"][29] == "s"
    assert server.get("/api/mission", who="ben")["states"]["left"][29] == "u"
    server.paint("of-1", 31, [0], "ocean", who="fay")
    server.paint("of-2", 33, [0], "ocean", who="fay")
    assert server.get("/api/labelled", of="fay") == {"of": "fay", "cameras": {"left": [31, 33]}}
    assert server.request("GET", "/api/labelled?of=nobody").status == 404


def test_frames_with_a_class_are_those_of_one_person_as_they_are_now(server):
    def found(who, label, **more):
        query = {"who": who, "class": label, **more}
        return server.get("/api/frames_with", **query)["cameras"]["left"]

    assert found("gus", "sand") == []
    server.paint("with-1", 9, [3, 4], "sand", who="gus")
    server.paint("with-2", 2, [0], "sand", who="gus")
    server.paint("with-3", 2, [1], "reef", who="gus")
    server.paint("with-4", 5, [0], "sand", who="hal")
    assert found("gus", "sand") == [2, 9]
    assert (found("gus", "reef"), found("hal", "sand"), found("hal", "reef")) == ([2], [5], [])
    assert found("gus", "no such class") == found("nobody", "sand") == []
    server.paint("with-5", 9, [3], None, base="sand", who="gus")
    assert found("gus", "sand") == [2, 9]
    server.paint("with-6", 9, [4], "reef", base="sand", who="gus")
    assert found("gus", "sand") == [2] and found("gus", "reef") == [2, 9]
    assert server.request("GET", "/api/frames_with?who=gus").status == 400


def test_an_action_for_another_mission_is_not_taken(server):
    change = {"camera": "left", "frame": 8, "label": "reef", "cells": [7], "base": [None]}
    body = {"who": "anna", "kind": "paint", "time": TIME, "changes": [change]}
    grid = {"rows": 10, "cols": 10, "width": 360}
    for n, other in enumerate(({"mission": "other"}, {"grid": {**grid, "width": 720}})):
        answer = server.send("/api/actions", {**body, "key": f"other-{n}", **other})
        assert answer.status == 421
        assert ("mission tiny;", "grid 10x10@360;")[n] in answer.json["error"]
        undo = {"key": f"o-{n}", "who": "anna", "time": TIME, **other}
        assert server.send("/api/undo", undo).status == 421
    own = {**body, "key": "own", "mission": "tiny", "grid": grid}
    assert server.send("/api/actions", own).status == 200


CHANGE = {"camera": "left", "frame": 9, "label": "ocean", "cells": [0], "base": [None]}
ACTION = {"key": "bad", "who": "anna", "kind": "paint", "time": TIME, "changes": [CHANGE]}


@pytest.mark.parametrize(
    ("change", "status"),
    [
        *(({"camera": "right"}, 404), ({"frame": 41}, 404), ({"camera": "../left"}, 400)),
        *(({"frame": frame}, 400) for frame in (-1, True, "9", 10**400)),
        *(({"label": label}, 400) for label in ("kelp", "", 1)),
        *(({"cells": cells}, 400) for cells in ([100], [-1], [0, 1], 0, [0.0])),
        ({"cells": [0, 0], "base": [None, None]}, 400),
        *(({"base": ["\ud800"]}, 400), ({"model": " x"}, 400)),
        *(({"more": 1}, 400), ({"\ud800": 1}, 400)),
    ],
)
def test_wrong_changes_are_refused(server, change, status):
    answer = server.send("/api/actions", {**ACTION, "changes": [{**CHANGE, **change}]})
    _is_refused(answer, status)
    assert _mine(server, 9) == [None] * 100


@pytest.mark.parametrize(
    "wrong",
    [
        *({"key": ""}, {"key": "a\nb"}, {"key": "k" * 300}, {"who": " anna"}, {"who": None}),
        *({"kind": "undo"}, {"time": "yesterday"}, {"time": "2016-04-20T10:00:00"}),
        *({"source": "model"}, {"changes": []}, {"changes": {}}, {"blind": 2}, {"grid": [10]}),
    ],
)
def test_wrong_actions_are_refused(server, wrong):
    answer = server.send("/api/actions", {**ACTION, **wrong})
    _is_refused(answer, 400, 403)
    assert _mine(server, 9) == [None] * 100


@pytest.mark.parametrize(
    "body", [b"", b"{", b"null", b"[]", b"\xff", b"[" * 100_000, b'{"frame": NaN}', b"1e999"]
)
def test_what_is_not_json_is_refused(server, body):
    for path in ("/api/actions", "/api/undo", "/api/seen"):
        answer = server.request("POST", path, body, {"Content-Type": "application/json"})
        assert answer.status == 400, (path, answer.body)
        assert list(answer.json) == ["error"]


_odd = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
    | st.sampled_from([*ACTION.values(), *CHANGE.values(), "settled", "ocean", 10**30]),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.sampled_from([*ACTION, *CHANGE, "target", "blind"]), inner, max_size=4),
    max_leaves=8,
)  # fmt: skip
_bodies = st.one_of(
    _odd,
    st.builds(lambda more: {**ACTION, **more}, st.dictionaries(st.sampled_from([*ACTION]), _odd)),
    st.builds(
        lambda more: {**ACTION, "changes": [{**CHANGE, **more}]},
        st.dictionaries(st.sampled_from([*CHANGE]), _odd),
    ),
)


def test_no_json_is_a_fault_of_the_server(server):
    with closing(server.connect()) as connection:

        @settings(max_examples=scaled(60))
        @given(st.sampled_from(["/api/actions", "/api/undo", "/api/redo", "/api/seen"]), _bodies)
        def send(path, body):
            headers = {**server.authority, "Content-Type": "application/json"}
            connection.request("POST", path, json.dumps(body), headers)
            answer = connection.getresponse()
            text = answer.read()
            assert answer.status < 500, (body, text)
            if answer.status != 200:
                assert list(json.loads(text)) == ["error"]

        send()


@pytest.mark.parametrize(
    "query",
    [
        *("labels?camera=left", "labels?camera=up&frames=1"),
        *(f"labels?camera=left&frames={n}" for n in ("", "1-2-3", "1-999999999999", "1-61")),
        "labels?camera=left&frames=1&suggest=maybe",
        *("mission?who=", "mission?who=" + "x" * 300),
        *("events?since=-1", "events?since=9999999999999999999"),
        *("queue?n=0", "queue?n=99999", "picture/left/1?enhance=101", "picture/left/1?enhance=-1"),
        *("thumb/left/1?width=0", "patches?cells=left:1:0&size=7"),
        *(f"patches?cells=left:1:0&margin={margin}" for margin in (-0.1, 1.1)),
        *("patches", "patches?cells=", "patches?cells=left:1", "patches?cells=left:1:0,"),
        *("patches?cells=left:1:0&size=100000", "patches?cells=left:1:0&margin=nan"),
        "patches?cells=" + ",".join(["left:1:0"] * 401),
    ],
)
def test_wrong_queries_are_refused(server, query):
    _is_refused(server.request("GET", f"/api/{query}"), 400)


def test_ranges_of_millions_of_frames_are_not_listed(server):
    process = psutil.Process(server.process.pid)
    begin = process.cpu_times().user
    ranges = ",".join(f"{n}0000000 - {n}9999999" for n in range(1, 4))
    answer = server.request("GET", f"/api/labels?camera=left&frames={quote(ranges)}")
    assert answer.status == 400 and "10000000 frames at once" in answer.json["error"]
    assert process.cpu_times().user - begin < 1


def test_pictures(server):
    own = next((server.mission / "Left").glob("*_3.png")).read_bytes()
    assert server.request("GET", "/api/picture/left/3").body == own
    for path in ("picture/left/3?enhance=60", "thumb/left/3", "patches?cells=left:3:5,left:4:99"):
        answer = server.request("GET", f"/api/{path}")
        assert answer.status == 200 and answer.headers["Content-Type"] == "image/jpeg"
        assert answer.body.startswith(b"\xff\xd8")


def test_unreadable_frame(page_server, own_tiny):
    next((own_tiny.path / "Left").glob("*_3.png")).write_bytes(b"not a picture")
    server = page_server(mission=own_tiny.path)
    for path in ("picture/left/3", "picture/left/3?enhance=60", "thumb/left/3"):
        answer = server.request("GET", f"/api/{path}")
        assert answer.status == 422 and "3" in answer.json["error"]
        assert answer.headers["Cache-Control"] == "no-store"
    assert server.request("GET", "/api/patches?cells=left:3:5,left:4:5").status == 200


def test_acknowledged_means_kept(page_server):
    server = page_server()
    for n in range(5):
        server.paint(f"kept-{n}", 1 + n, list(range(100)), "ocean")
    server.kill()
    with LabelStore(server.workspace / FILE_NAME, create=False) as store:
        assert len(store.current("tiny", "anna")) == 500
    server.start()
    assert server.get("/api/mission", who="anna")["states"]["left"].startswith("dddddu")
    assert server.paint("kept-4", 5, list(range(100)), "ocean")["repeated"]


@pytest.mark.skipif(sys.platform != "linux", reason="needs prlimit")
def test_full_disk_is_said_at_once_and_passes(page_server):
    server = page_server()
    server.paint("full-0", 1, [0], "ocean")
    limit = resource.prlimit(server.process.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(server.process.pid, resource.RLIMIT_FSIZE, (0, limit[1]))
    body = {**ACTION, "key": "full-1"}
    answer = server.send("/api/actions", body)
    assert answer.status == 507 and str(server.workspace / FILE_NAME) in answer.json["error"]
    assert _mine(server, 9) == [None] * 100
    assert server.get("/api/mission", who="anna")["fault"] == answer.json["error"]
    resource.prlimit(server.process.pid, resource.RLIMIT_FSIZE, limit)
    assert server.send("/api/actions", body).json["changed"] == 1
    until(lambda: not server.get("/api/mission", who="anna")["fault"])
