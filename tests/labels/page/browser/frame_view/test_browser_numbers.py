"""Pictures named by their time: numbers no browser holds, and an order that is not the numbers'."""

import shutil

import pytest

from tokt.labels.store.store import LabelStore

ORDER = (235959, 0, 1403636579763555584, 1403636579813555456)
NAMES = ("A_20190513_235959", "A_20190514_000000", "B_20200101_1403636579763555584")
NAMES += ("B_20200101_1403636579813555456",)


@pytest.fixture(scope="module")
def server(page_server, tiny, tmp_path_factory):
    dive = tmp_path_factory.mktemp("stamps") / "dive"
    dive.mkdir()
    for number, name in enumerate(NAMES, 5):
        shutil.copy(tiny.path / "Left" / f"tiny_L_{number}.png", dive / f"{name}.png")
    return page_server("--annotator", "anna", mission=dive)


def test_such_frames_are_stepped_through_in_the_dives_order_and_labelled(open_frame, server):
    page = open_frame(ORDER[0])
    for frame, cell in zip(ORDER, (11, 22, 33, 44), strict=True):
        page.wait(frame)
        page.label("1", cell)
        page.press("PageDown")
    page.saved()
    page.open(ORDER[3])
    page.press("PageUp")
    page.wait(ORDER[2])
    with LabelStore(server.workspace / "labels.db") as store:
        found = {(record.frame, record.row * 10 + record.col) for record in store.current("dive")}
    assert found == set(zip(ORDER, (11, 22, 33, 44), strict=True))
    mission = server.get("/api/mission", who="anna")
    assert mission["cameras"]["left"]["ranges"][1:] == [[0, 0], *([str(n)] * 2 for n in ORDER[2:])]
    (labels,) = server.get("/api/labels", who="anna", camera="left", frames=ORDER[3])["frames"]
    assert labels["frame"] == str(ORDER[3]) and labels["mine"][44] == "ocean"
