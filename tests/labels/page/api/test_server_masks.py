"""The mask of a dive through the page's server: kept beside the frames, shown to all, respected."""

import shutil

import cv2
import numpy as np
import pytest

from tests.fixtures import write_video
from tests.labels.page.conftest import TIME
from tests.waiting import until
from tokt.features.frames.grid import Grid
from tokt.features.frames.mask_file import mask_file
from tokt.features.frames.mission import open_mission
from tokt.features.frames.view_mask import CameraMasks, ViewMask, read_masks, write_masks
from tokt.labels.formats.audit_csv import Audit, AuditedPatch, write_audit
from tokt.labels.store.store import FILE_NAME, LabelStore

GRID = Grid()
SIZE = GRID.resized(272, 360)
CLOCK = [7, 8, 9]


@pytest.fixture
def dive(tiny, tmp_path):
    """A copy of the tiny mission whose folder may be written into."""
    return shutil.copytree(tiny.path, tmp_path / "tiny")


@pytest.fixture
def server(page_server, dive):
    return page_server("--annotator", "anna", mission=dive)


def mask(server, cells, camera="left"):
    return server.send("/api/mask", {"who": "anna", "camera": camera, "cells": list(cells)})


def masked(dive):
    """The masked patches by the file beside the frames."""
    return np.flatnonzero(read_masks(dive).patches("left", GRID, 272, 360)).tolist()


def frame_of(server, frame, who="anna", **more):
    query = {"camera": "left", "frames": frame, "who": who, **more}
    return server.get("/api/labels", **query)["frames"][0]


def state(server, frame, who="anna"):
    return server.get("/api/mission", who=who)["states"]["left"][frame - 1]


def stored(server, frame, who="anna"):
    with LabelStore(server.workspace / FILE_NAME) as store:
        found = store.current("tiny", who, GRID, frame=frame)
        return {one.row * GRID.cols + one.col for one in found}


def test_a_mask_is_kept_beside_the_frames_and_other_pages_hear_of_it(server, dive):
    assert server.get("/api/mission")["masked"] == {"left": []}
    corner = [*CLOCK, 90, 99]
    with server.events(who="ben") as ben:
        before = ben.next("status")["setup"]
        assert mask(server, corner).status == 200
        heard = ben.next("status")["setup"]
    mission = server.get("/api/mission", who="ben")
    assert before != heard == mission["setup"]
    assert mission["masked"] == {"left": corner} and masked(dive) == corner
    server.interrupt()
    server.start()
    assert server.get("/api/mission")["masked"] == {"left": corner}
    assert mask(server, []).status == 200
    assert masked(dive) == [] and not mask_file(dive).exists()


def test_a_masked_patch_takes_no_label_and_nothing_waits_for_it(server):
    server.paint("a0", 1, [8, 20], "reef")
    server.paint("b0", 1, [8, 20], "sand", who="ben")
    mask(server, CLOCK)
    found = frame_of(server, 1)
    assert (found["mine"][8], found["mine"][20], found["hidden"]) == (None, "reef", 1)
    assert found["others"]["ben"][8] is None
    assert server.get("/api/mission")["counts"]["reef"] == 1
    conflicts = server.get("/api/agreement", a="anna", b="ben")["conflicts"]
    assert [one["cell"] for one in conflicts] == [20]
    assert [one["cell"] for one in server.get("/api/sheet", **{"class": "reef"})["patches"]] == [20]
    done = server.paint("a1", 2, [*range(100)], "ocean")
    assert (done["changed"], done["masked"]) == (97, 3)
    assert done["states"] == {"left": {"2": "d"}} and state(server, 2) == "d"
    assert stored(server, 2) == {*range(100)} - {*CLOCK}
    only = server.paint("a2", 3, CLOCK, "ocean")
    assert (only["changed"], only["masked"]) == (0, 3) and only["conflicts"] == []
    assert server.paint("a2", 3, CLOCK, "ocean")["repeated"]
    assert server.paint("a3", 3, [50], "ocean")["undo"]["undo"]["key"] == "a3"
    # What was said before is in the store all along, and seen again where nothing is masked.
    assert stored(server, 1) == {8, 20}
    mask(server, [])
    found = frame_of(server, 1)
    assert (found["mine"][8], found["others"]["ben"][8], found["hidden"]) == ("reef", "sand", 0)
    assert state(server, 2) == "p"


def test_a_disagreement_on_a_masked_patch_is_none(server):
    server.paint("a0", 5, [8], "reef")
    server.paint("b0", 5, [8], "sand", who="ben")
    assert state(server, 5) == "x"
    mask(server, CLOCK)
    assert state(server, 5) == "u"
    server.paint("b1", 6, [1], "sand", who="ben")
    assert server.get("/api/labelled", of="ben")["cameras"] == {"left": [6]}


def test_a_mask_of_too_much_is_refused_and_nothing_is_written(server, dive):
    mask(server, CLOCK)
    answer = mask(server, range(80))
    assert answer.status == 409 and "of the view" in answer.json["error"]
    assert masked(dive) == CLOCK and server.get("/api/mission")["masked"] == {"left": CLOCK}
    assert mask(server, [100]).status == 400
    assert mask(server, [1], camera="right").status == 404
    assert server.send("/api/fixed_marks", {"camera": "right"}).status == 404
    assert server.get("/api/mission")["fault"] == ""


def test_a_mask_that_cannot_be_written_is_one_sentence(server, dive):
    mask_file(dive).mkdir()
    answer = mask(server, CLOCK)
    assert answer.status == 409 and str(mask_file(dive)) in answer.json["error"]
    mission = server.get("/api/mission")
    assert (mission["fault"], mission["masked"]) == ("", {"left": []})


def test_boxes_of_a_finer_mask_stay_unless_a_patch_in_them_is_freed(server, dive):
    server.interrupt()
    clock, rim = (0.705, 0.01, 0.29, 0.07), (0.0, 0.0, 0.005, 1.0)
    write_masks(dive, CameraMasks(left=ViewMask((clock, rim))))
    assert masked(dive) == CLOCK
    server.start()
    mask(server, CLOCK)
    assert read_masks(dive).left.boxes == (clock, rim)
    mask(server, [*CLOCK, 50])
    assert read_masks(dive).left.boxes[:2] == (clock, rim) and masked(dive) == [*CLOCK, 50]
    mask(server, [8, 9, 50])
    assert rim in read_masks(dive).left.boxes and clock not in read_masks(dive).left.boxes
    assert masked(dive) == [8, 9, 50]


def test_suggestions_are_of_covered_frames_and_not_of_masked_patches(
    page_server, tiny_bundle, dive
):
    server = page_server("--annotator", "anna", "--model", tiny_bundle, mission=dive)
    whole = frame_of(server, 8, suggest=1)["suggestions"]
    tower = [cell for cell, which in enumerate(whole["classes"]) if which != whole["classes"][0]]
    mask(server, tower[:2])
    shown = frame_of(server, 8, suggest=1)["suggestions"]["values"]
    assert [cell for cell, value in enumerate(shown) if value is None] == tower[:2]
    # The texture of a neighbour's border is that of the covered picture.
    assert shown != whole["values"] and server.get("/api/mission")["model"]
    until(lambda: server.get("/api/queue")["ready"])
    assert server.get("/api/queue", n=3)["frames"][0]["score"] > 0
    # The picture that is shown is the camera's own.
    picture = server.request("GET", "/api/picture/left/8").body
    assert picture == open_mission(dive).encoded(8)[0]


def test_a_clock_that_never_moves_is_found_and_nothing_is_written(server, dive):
    def search(server):
        server.post("/api/fixed_marks", camera="left")
        asked = {"camera": "left"}
        until(lambda: server.get("/api/fixed_marks", **asked)["cells"] is not None)
        return server.get("/api/fixed_marks", **asked)["cells"]

    assert search(server) == []
    for frame in range(1, 41):
        path = dive / f"Left/tiny_L_{frame}.png"
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        cv2.putText(picture, "ROV 12", (262, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.7, 255, 2)
        cv2.imwrite(str(path), picture)
    (dive / "Left/tiny_L_20.png").write_bytes(b"damaged")
    found = search(server)
    assert {8, 9} <= {*found} <= {*CLOCK}
    assert not mask_file(dive).exists() and server.get("/api/mission")["masked"] == {"left": []}


def test_a_video_has_its_mask_beside_it(page_server, tiny_truth, tmp_path):
    def drawn(frame):
        picture = cv2.cvtColor(tiny_truth.draw(frame), cv2.COLOR_GRAY2BGR)
        return cv2.putText(
            picture, "ROV 12", (262, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 2
        )

    video = write_video(tmp_path / "dive.avi", map(drawn, range(1, 31)))
    server = page_server("--annotator", "anna", mission=video)
    server.post("/api/fixed_marks", camera="left")
    until(lambda: server.get("/api/fixed_marks", camera="left")["cells"])
    mask(server, CLOCK)
    assert server.paint("a0", 30, [*range(100)], "ocean")["states"] == {"left": {"30": "d"}}
    assert masked(video) == CLOCK and mask_file(video).parent == tmp_path


def test_an_audit_doubts_no_masked_patch(server):
    doubts = [
        AuditedPatch("tiny", "left", 1, 0, col, "ocean", "reef", -1.0, "odd") for col in (6, 7)
    ]
    write_audit(server.workspace, Audit("odd", "tiny", GRID, "a rule", tuple(doubts), TIME))
    mask(server, CLOCK)
    assert [one["cell"] for one in server.get("/api/audit", name="odd")["patches"]] == [6]
    assert server.get("/api/audits")["audits"][0]["patches"] == 1
