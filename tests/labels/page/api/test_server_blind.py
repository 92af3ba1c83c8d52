"""Who labels blind gets nothing that tells what others say: not in any field of any answer."""

import json
from urllib.parse import urlencode

import pytest

from tests.fixtures import taxonomy_toml
from tests.waiting import until
from tokt.labels.record import utc_now
from tokt.labels.store.store import FILE_NAME, LabelStore

OTHERS = "benedikt"
THEIRS = "reef"
ONLY_THEIRS = "kelp_forest"
MODEL = "tiny-lbp/1"


@pytest.fixture(scope="module")
def server(page_server, tiny_bundle, tmp_path_factory):
    """Frame 1: both said something; 2: only the other; 3: both, and it is settled."""
    folder = tmp_path_factory.mktemp("blind") / ".tokt"
    folder.mkdir()
    known = {"ocean": False, THEIRS: True}
    (folder / "taxonomy.toml").write_text(taxonomy_toml(**known, **{ONLY_THEIRS: True}))
    server = page_server("--model", tiny_bundle, "--annotator", "anna", workspace=folder)
    server.paint("b1", 1, [0, 1], THEIRS, who=OTHERS)
    server.paint("b2", 2, [0], ONLY_THEIRS, who=OTHERS)
    server.paint("b3", 3, [0], THEIRS, who=OTHERS)
    _see(server, blind=True)
    server.paint("a1", 1, [0, 2], "ocean")
    server.paint("a3", 3, [0], "ocean", blind=True)
    server.paint("s3", 3, [0], THEIRS, who="carl", source="settled")
    server.interrupt()
    # The class that only the other one used is in no taxonomy any more.
    (folder / "taxonomy.toml").write_text(taxonomy_toml(**known))
    return server.start()


def _see(server, *, blind, who="anna"):
    assert server.post("/api/blind", who=who, blind=blind) == {"blind": blind}
    return server


def _texts(value):
    """Every string and key in a JSON value."""
    if isinstance(value, dict):
        return set(value) | set().union(*map(_texts, value.values()), set())
    if isinstance(value, list):
        return set().union(*map(_texts, value), set())
    return {value} if isinstance(value, str) else set()


def _check(answer):
    text = json.dumps(answer)
    for secret in (OTHERS, "carl", ONLY_THEIRS, "tiny-lbp"):
        assert secret not in text, secret


def test_mission(server):
    seeing = _see(server, blind=False).get("/api/mission", who="anna")
    assert seeing["states"]["left"][:3] == "xup"  # the third one is settled
    assert OTHERS in seeing["annotators"] and seeing["model"]["label"] == MODEL
    assert ONLY_THEIRS in _texts(seeing["classes"])
    blind = _see(server, blind=True).get("/api/mission", who="anna")
    _check(blind)
    assert blind["states"]["left"][:3] == "pup"
    assert blind["given"] == seeing["given"] and set(blind["given"]["left"]) == {"1", "3"}
    assert blind["annotators"] == ["anna"] and blind["model"] is None
    assert blind["counts"] == {**dict.fromkeys(blind["counts"], 0), "ocean": 3}
    assert {known["name"] for known in blind["classes"]} == {"ocean", THEIRS, "unsure"}


def test_labels(server):
    query = {"camera": "left", "frames": "1-3", "who": "anna", "suggest": 1}
    seeing = _see(server, blind=False).get("/api/labels", **query)["frames"]
    assert [list(frame["others"]) for frame in seeing] == [[OTHERS]] * 3
    assert seeing[2]["settled"][0] == THEIRS
    assert all(len(frame["suggestions"]["classes"]) == 100 for frame in seeing)
    blind = _see(server, blind=True).get("/api/labels", **query)["frames"]
    _check(blind)
    for frame in blind:
        assert frame["others"] == {} and frame["suggestions"] is None
        assert frame["settled"] == [None] * 100 and frame["models"] == {}
    assert [frame["mine"][0] for frame in blind] == ["ocean", None, "ocean"]
    assert _texts([frame["mine"] for frame in blind]) == {"ocean"}


def test_what_is_only_for_the_seeing_is_refused(server):
    for query in (f"agreement?a=anna&b={OTHERS}", "audits?"):
        answer = _see(server, blind=True).request("GET", f"/api/{query}&who=anna&blind=0")
        assert answer.status == 403
        _check(answer.json)
        seeing = _see(server, blind=False)
        assert seeing.request("GET", f"/api/{query}&who=anna&blind=1").status == 200
    queue = _see(server, blind=True).get("/api/queue", who="anna")
    assert queue["frames"] == [] and queue["done"] == queue["total"] == 0 and queue["why_not"]
    assert _see(server, blind=False).get("/api/queue", who="anna")["total"] == 40


def test_the_sheet_holds_only_ones_own(server):
    _see(server, blind=True)
    for label, total in (("ocean", 3), (THEIRS, 0)):
        sheet = server.get("/api/sheet", **{"class": label}, who="anna")
        assert sheet["total"] == total
        _check(sheet)


def test_a_class_that_only_others_used_is_one_that_is_not_there(server):
    for label in (ONLY_THEIRS, "kelp"):
        target = f"/api/sheet?class={label}&who=anna"
        answer = _see(server, blind=True).request("GET", target)
        assert (answer.status, answer.json) == (404, {"error": f"no class {label!r}"})
    _see(server, blind=False).get("/api/sheet", **{"class": ONLY_THEIRS}, who="anna")


def test_classes_are_counted_by_ones_own_labels_and_only_looks_are_changed(server):
    counts = server.get("/api/mission", who="anna")["counts"]
    listed = _see(server, blind=False).get("/api/classes", who="anna")["classes"]
    assert {one["name"]: one["labels"] for one in listed}[THEIRS] > counts[THEIRS]
    known = _see(server, blind=True).get("/api/classes", who="anna")
    for one in known["classes"]:
        assert one.pop("labels") == counts[one["name"]]
        del one["given"]
    clear, reef = known["classes"]
    swapped = [{**clear, "obstacle": True}, {**reef, "obstacle": False}]
    for wrong in ([clear, {**reef, "name": "rock"}], swapped):
        body = {"who": "anna", "setup": known["setup"], "classes": wrong}
        answer = server.send("/api/classes", body)
        assert answer.status == 409 and "labelling blind" in answer.json["error"]


def test_a_file_is_taken_only_with_ones_own_labels(server):
    def status(data, **query):
        query |= {"name": "x.csv", "who": "anna", "map": f"{ONLY_THEIRS}="}
        target = f"/api/import?{urlencode(query)}"
        headers = {"Content-Type": "application/octet-stream"}
        return server.request("POST", target, data, headers).status

    row = f"mission,camera,frame,row,col,label\ntiny,left,1,0,0,{THEIRS}\n".encode()
    everything = server.request("GET", "/api/export?format=csv&full=1&who=dora").body
    hers = server.request("GET", "/api/export?format=csv&full=1&only=anna&who=anna").body
    for blind, wrong in ((False, 200), (True, 403)):
        _see(server, blind=blind)
        assert status(row) == status(row, annotator=OTHERS) == status(everything) == wrong
        assert status(row, annotator="anna") == status(hers) == 200


def test_an_export_without_labels_names_nobody(server):
    for blind in (True, False):
        _see(server, blind=blind, who="zoe")
        answer = server.request("GET", "/api/export?format=csv&only=zoe&who=zoe")
        assert (answer.status, answer.json) == (409, {"error": "no such labels"})


def test_jobs_settings_and_the_store_are_for_the_seeing(server):
    server.post("/api/settings", who="dora", name="obstacle_as", value=THEIRS)
    server.post("/api/job", who="dora", what="audit")
    server.post("/api/job/cancel", who="dora")
    posts = (("/api/job", {"what": "audit"}), ("/api/job/cancel", {}))
    setting = {"who": "anna", "name": "obstacle_as", "value": THEIRS}
    _see(server, blind=True)
    with server.events(who="anna") as stream:
        for told in (stream.next("status"), server.get("/api/mission", who="anna")):
            assert told["job"] is None and told["settings"] == {}
    assert server.post("/api/settings", **setting) == {}
    for path in ("/api/job", "/api/backup"):
        assert server.request("GET", f"{path}?who=anna").status == 403
    for path, body in posts:
        assert server.send(path, {**body, "who": "anna"}).status == 403
    seeing = _see(server, blind=False).get("/api/mission", who="anna")
    assert seeing["job"] is not None and seeing["settings"] == {"obstacle_as": THEIRS}
    assert server.request("GET", "/api/backup?who=anna").status == 200


def test_an_error_names_no_class_that_only_others_used(server):
    change = {"camera": "left", "frame": 9, "label": "kelp", "cells": [0], "base": [None]}
    body = {"key": "e9", "who": "anna", "kind": "paint", "time": "2016-04-20T10:00:00Z"}
    answer = _see(server, blind=True).send("/api/actions", {**body, "changes": [change]})
    assert answer.status == 400
    _check(answer.json)


def test_actions_undo_and_seen(server):
    base = {"who": "anna", "time": "2016-04-20T10:00:00Z"}
    done = _see(server, blind=True).paint("a4", 1, [1], "ocean")
    assert done["changed"] == 1 and done["states"] == {"left": {"1": "p"}}
    undone = server.post("/api/undo", key="u4", **base)
    redone = server.post("/api/redo", key="r4", **base)
    undone_again = server.post("/api/undo", key="u5", **base)
    seen = server.post("/api/seen", who="anna", camera="left", frame=2)
    assert seen == {"states": {"left": {"2": "s"}}}
    for answer in (done, undone, redone, undone_again, seen):
        _check(answer)
    _see(server, blind=False)
    seen = server.post("/api/seen", who="anna", camera="left", frame=1)
    assert seen["states"]["left"] == {"1": "x"}


def test_events(server):
    _see(server, blind=True)
    with server.events(who="anna") as blind, server.events(who="dora") as seeing:
        assert blind.next("status")["model"] is None
        assert seeing.next("status")["model"]["total"] == 40
        server.paint("e1", 5, [0], THEIRS, who=OTHERS)
        server.paint("e2", 5, [1], THEIRS, who="carl", source="settled")
        server.paint("e3", 6, [0], "ocean", who="anna")
        heard = [blind.next("change")]
        frames = [tuple(frame) for frame in heard[0]["frames"]]
        assert frames == [("left", 6)] and heard[0]["by"] == []
        assert heard[0]["states"] == {"left": {"6": "p"}}
        _check(heard)
        told = seeing.next("change")
        assert (told["frames"], told["by"]) == ([["left", 5]], [OTHERS])
        server.process.send_signal(2)
        for name, data in blind.rest():
            _check(data)
            assert name == "status", data
    server.interrupt()
    server.start()


def test_events_since(server):
    before = server.get("/api/mission", who="anna")["event"]
    server.paint("f1", 7, [0], THEIRS, who=OTHERS)
    server.paint("f2", 8, [0], "ocean", who="anna")
    with _see(server, blind=True).events(who="anna", since=before) as blind:
        heard = blind.next("change")
        assert heard["frames"] == [["left", 8]] and heard["by"] == []
        _check(heard)
    with _see(server, blind=False).events(who="anna", since=before) as seeing:
        heard = seeing.next("change")
        assert heard["frames"] == [["left", 7], ["left", 8]]
        assert heard["by"] == ["anna", OTHERS]


def test_undoing_a_settlement_does_not_tell_who_settled_since(server):
    _see(server, blind=False)
    server.paint("b6", 6, [0, 1], THEIRS, who=OTHERS)
    server.paint("a6", 6, [2], "ocean")
    server.paint("s6", 6, [2], "ocean", source="settled")
    server.paint("s6-again", 6, [2], THEIRS, base="ocean", who="carl", source="settled")
    time = "2016-04-20T10:00:00Z"
    _see(server, blind=True)
    undone = server.post("/api/undo", key="u6", who="anna", time=time, target="s6")
    (conflict,) = undone["conflicts"]
    assert (conflict["cell"], conflict["theirs"]) == (2, "ocean")
    assert THEIRS not in _texts(undone["conflicts"])


def test_who_is_blind_is_so_everywhere_and_after_a_restart_whatever_a_page_says(server):
    _see(server, blind=False, who="anna")
    with server.events(who="anna") as anna, server.events(who="dora") as dora:
        assert not anna.next("status")["blind"] and not dora.next("status")["blind"]
        _see(server, blind=True)
        # One that was on its way before may come first.
        told = until(lambda: (said := anna.next("status"))["blind"] and said)
        assert told["model"] is None
        with LabelStore(server.workspace / FILE_NAME) as store:  # another server's page
            store.set_blind("tiny", "dora", blind=True, time=utc_now())
        assert until(lambda: dora.next("status")["blind"])
    server.interrupt()
    server.start()
    for who in ("anna", "dora"):
        found = server.get("/api/mission", who=who, blind=0)
        assert found["blind"] and found["model"] is None and OTHERS not in found["annotators"]
    assert not server.get("/api/mission", who="eva")["blind"]
    settle = {"camera": "left", "frame": 1, "label": THEIRS, "cells": [0], "base": [None]}
    body = {"key": "s", "who": "anna", "kind": "settle", "time": utc_now(), "source": "settled"}
    assert server.send("/api/actions", {**body, "changes": [settle]}).status == 409
    _see(server, blind=False, who="dora")


def test_a_kept_action_is_taken_and_is_blind_as_the_page_that_made_it_says(server):
    _see(server, blind=False)
    server.paint("y1", 9, [0], "ocean", blind=True)
    server.paint("y2", 9, [1], "ocean", blind=False)
    _see(server, blind=True)
    server.paint("y3", 9, [2], "ocean", blind=False)
    server.post("/api/undo", key="y4", who="anna", time=utc_now(), target="y3", blind=False)
    server.post("/api/redo", key="y5", who="anna", time=utc_now(), blind=True)
    with LabelStore(server.workspace / FILE_NAME) as store:
        said = store.current("tiny", "anna", frame=9)
    assert [(one.col, one.blind) for one in said] == [(0, True), (1, False), (2, False)]


@pytest.mark.parametrize(
    "body", [{"who": "anna"}, {"who": "anna", "blind": "yes"}, {"who": "", "blind": True}]
)
def test_wrong_wishes_are_refused(server, body):
    assert server.send("/api/blind", body).status == 400
