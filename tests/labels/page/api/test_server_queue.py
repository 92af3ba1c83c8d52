"""Where nothing is left in the queue of frames to label next, the page's server says why."""

import shutil

import cv2
import pytest

from tests.waiting import until


@pytest.fixture(scope="module")
def server(page_server, tiny_bundle, tiny, tmp_path_factory):
    """A mission of four frames, of which the model cannot judge the last two."""
    folder = tmp_path_factory.mktemp("queue") / "tiny"
    (folder / "Left").mkdir(parents=True)
    for frame in range(1, 5):
        shutil.copy(tiny.path / f"Left/tiny_L_{frame}.png", folder / "Left")
    for frame in (3, 4):
        path = str(folder / f"Left/tiny_L_{frame}.png")
        cv2.imwrite(path, cv2.resize(cv2.imread(path), (360, 90)))
    server = page_server("--annotator", "anna", "--model", tiny_bundle, mission=folder)
    assert until(lambda: _queue(server)["ready"])
    return server


def test_pictures_of_changing_size_are_no_sequence(server):
    assert server.get("/api/mission")["single_pictures"] is True


def _queue(server, **more):
    return server.get("/api/queue", who="anna", **more)


def test_an_empty_queue_names_the_frames_that_the_model_cannot_judge(server):
    left = _queue(server)
    assert {entry["frame"] for entry in left["frames"]} == {1, 2} and left["why_not"] == ""
    server.paint("one", 1, [3], "ocean", who="anna")
    nothing = _queue(server, camera="left", frame=2)
    assert nothing["frames"] == [] and nothing["ready"]
    assert nothing["why_not"].startswith("The model cannot judge 2 frames without a label of yours")
    assert "360x90" in nothing["why_not"]
    for frame in (3, 4):
        server.paint(f"frame {frame}", frame, [3], "ocean", who="anna")
    assert "you labelled something in each" in _queue(server, camera="left", frame=2)["why_not"]
