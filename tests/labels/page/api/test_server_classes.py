"""The workspace's classes, read and written through the page."""

import errno
import os
import tomllib

import pytest

from tests.calls import refuses
from tests.inference.test_faults import hold_row
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import FolderMission
from tokt.labels.page.api.class_routes import ClassesBody, post_classes
from tokt.labels.page.state.session import open_session
from tokt.labels.taxonomy import load_taxonomy

NEW = {"name": "stony coral", "obstacle": True, "color": "#aa0011", "key": "6", "parent": "reef"}


@pytest.fixture
def server(page_server, tmp_path):
    return page_server("--annotator", "anna", workspace=tmp_path / "w")


def change(server, classes, setup=None):
    body = {"setup": setup or server.get("/api/classes")["setup"], "classes": classes}
    return server.send("/api/classes", body)


def plain(server):
    found = server.get("/api/classes")["classes"]
    told = {"labels", "given"}
    return [{key: said for key, said in one.items() if key not in told} for one in found]


def test_classes_are_added_ordered_and_told(server):
    before = server.get("/api/mission")
    assert before["setup"] == server.get("/api/classes")["setup"]
    classes = plain(server)
    with server.events(who="anna") as stream:
        assert stream.next("status")["setup"] == before["setup"]
        answer = change(server, [classes[0], NEW, *reversed(classes[1:])])
        assert answer.status == 200, answer.body
        assert stream.next("status")["setup"] == answer.json["setup"] != before["setup"]
    names = ["ocean", "stony coral", "subsea_installation", "reef", "sand", "other"]
    mission = server.get("/api/mission")
    assert [one["name"] for one in mission["classes"]] == [*names, "unsure"]
    assert mission["classes"][1]["parent"] == "reef" and mission["setup"] == answer.json["setup"]
    server.paint("c-1", 1, [3], "stony coral")
    file = tomllib.loads((server.workspace / "taxonomy.toml").read_text("utf-8"))
    assert file["format"] == 2 and [one["name"] for one in file["classes"]] == names
    server.kill()
    server.start()  # and so it is tomorrow
    assert server.get("/api/mission")["classes"] == mission["classes"]
    assert change(server, classes, before["setup"]).status == 409  # looked at before the change


def test_a_class_with_labels_stays_what_it_is(server):
    server.paint("c-1", 1, [1, 2], "sand")
    server.paint("c-2", 1, [3], "reef")
    server.paint("c-3", 1, [3], "ocean", base="reef")
    classes = plain(server)
    known = server.get("/api/classes")["classes"]
    assert {one["name"] for one in known if one["given"]} == {"ocean", "sand", "reef"}
    without = [one for one in classes if one["name"] != "sand"]
    clear = [{**one, "obstacle": one["obstacle"] and one["name"] != "sand"} for one in classes]
    (reef,) = (one for one in classes if one["name"] == "reef")
    before = [one for one in classes if one != reef]  # an undo brings it back
    for wrong, said in (
        (without, "2 patches are labelled sand, so it stays"),
        (clear, "2 patches are labelled sand, so it stays an obstacle"),
        (before, "reef was given before, so it stays"),
        ([*before, {**reef, "obstacle": False}], "reef was given before, so it stays an"),
    ):
        answer = change(server, wrong)
        assert answer.status == 409 and said in answer.json["error"]
    assert not (server.workspace / "taxonomy.toml").exists()
    undone = server.post("/api/undo", key="u", who="anna", time="2016-04-20T10:00:00Z")
    assert undone["counts"]["reef"] == 1
    assert change(server, [one for one in classes if one["name"] != "other"]).status == 200
    assert "other" not in [one["name"] for one in server.get("/api/mission", who="anna")["classes"]]
    gone = {"camera": "left", "frame": 1, "label": "other", "cells": [9], "base": [None]}
    action = {"key": "c-4", "who": "anna", "kind": "paint", "time": "2016-04-20T10:00:00Z"}
    answer = server.send("/api/actions", {**action, "changes": [gone]})
    assert answer.status == 400 and "unknown class 'other'" in answer.json["error"]
    (other,) = (one for one in classes if one["name"] == "other")
    assert change(server, [*plain(server), other]).status == 200
    server.paint("c-5", 1, [9], "other")


def test_what_is_no_taxonomy_is_refused_in_a_sentence(server):
    for wrong, said in (
        ({"key": "1"}, "two classes have the key '1'"),
        ({"key": "u"}, "is kept for 'unsure'"),
        ({"name": "<b>"}, "a name is a letter"),
        ({"obstacle": False}, "is clear, its parent 'reef' is not"),
        ({"parent": 3}, "parent must be text"),
        ({"description": "\ud800"}, ""),
    ):
        answer = change(server, [*plain(server), {**NEW, **wrong}])
        assert answer.status == 400 and said in answer.json["error"], answer.body
    assert not (server.workspace / "taxonomy.toml").exists()


def test_classes_that_were_given_are_not_changed_here(page_server, server, tmp_path):
    change(server, plain(server))
    given = server.workspace / "taxonomy.toml"
    other = page_server("--taxonomy", given, workspace=tmp_path / "o")
    assert str(given) in other.get("/api/classes")["fixed"]
    assert change(other, plain(other)).status == 409


@pytest.mark.skipif(os.name == "nt", reason="syncs no folder")
def test_classes_whose_folder_cannot_be_synced_are_in_force_as_the_file_has_them(
    tiny, tmp_path, monkeypatch
):
    session = open_session(FolderMission(tiny.path), tmp_path, Grid(), "anna", "test")
    classes, real = session.taxonomy.to_json()["classes"], os.fsync
    more = [
        {**NEW, "name": name, "key": "x", "parent": ""} for name in ("stony coral", "soft coral")
    ]

    def fsync(handle):
        if os.path.samestat(os.fstat(handle), tmp_path.stat()):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        real(handle)

    def refuse_rename(old, new):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    for call, broken, words in (
        ("fsync", fsync, " as folder .* was synced; .* in place, but a power cut may undo it"),
        ("replace", refuse_rename, ""),
    ):
        body = ClassesBody(setup=session.setup, classes=[*classes, more.pop(0)])
        with monkeypatch.context() as disk:
            disk.setattr(os, call, broken)
            refuses(f"taxonomy.toml: Input/output error{words}$", post_classes, session, body)
        known = load_taxonomy(tmp_path).names
        assert session.taxonomy.names == known and known[-1] == "stony coral"
    session.store.close()
    hold_row(
        "the disk fails as the page writes the workspace's classes",
        "the page says so; the classes in force are those of the file",
        "nothing",
    )
