"""Patches that are not seen, through the page's server: told why, never suggested as clear."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tokt.models.bundle.bundle import bundle_bytes, read_bundle
from tokt.models.sight import measure_sight

DARK, BLURRED = 11, 8  # frames
LEFT = {10 * row + col for row in range(10) for col in range(5)}


@pytest.fixture(scope="module")
def dive(tiny, tmp_path_factory):
    """The tiny mission; in a frame the upper left is dark, in another the left half is blurred."""
    folder = shutil.copytree(tiny.path, tmp_path_factory.mktemp("unseen") / "tiny")

    def change(frame, rows, how):
        path = str(folder / f"Left/tiny_L_{frame}.png")
        picture = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
        picture[:rows, :180] = how(picture)[:rows, :180]
        cv2.imwrite(path, picture)

    change(DARK, 135, lambda picture: picture // 8)
    change(BLURRED, 272, lambda picture: cv2.GaussianBlur(picture, (0, 0), 4))
    return folder


@pytest.fixture(scope="module")
def server(page_server, tiny_bundle, dive):
    return page_server("--annotator", "anna", "--model", tiny_bundle, mission=dive)


def unseen(server, frame):
    """The causes of the patches that are not seen, by cell."""
    causes = server.get("/api/sight", camera="left", frame=frame)["causes"]
    return {cell: cause for cell, cause in enumerate(causes) if cause}


def suggested(server, frame):
    """Whether each patch is an obstacle to the model, and its margin."""
    query = {"camera": "left", "frames": frame, "suggest": 1}
    said = server.get("/api/labels", **query)["frames"][0]["suggestions"]
    obstacle = server.get("/api/mission")["model"]["obstacle"]
    return [obstacle[which] for which in said["classes"]], said["values"]


def test_a_model_says_what_is_not_seen_and_nothing_of_it_is_suggested_clear(server):
    blurred = unseen(server, BLURRED)
    assert {*blurred} >= LEFT and {*blurred.values()} == {"blurred"}
    obstacle, values = suggested(server, BLURRED)
    unknown = {cell for cell, value in enumerate(values) if value is None}
    assert unknown == {cell for cell in blurred if not obstacle[cell]}
    # What the model calls an obstacle there stays one.
    assert unknown & LEFT and LEFT - unknown
    assert unseen(server, 1) == {} and None not in suggested(server, 1)[1]


def test_a_masked_patch_is_no_patch_that_is_not_seen(server):
    server.post("/api/mask", who="anna", camera="left", cells=[0, 1])
    assert {*unseen(server, DARK)} == {cell for cell in LEFT if cell < 50} - {0, 1}
    server.post("/api/mask", who="anna", camera="left", cells=[])
    assert {0, 1} <= {*unseen(server, DARK)}


def test_without_a_model_only_what_needs_no_numbers_is_told(page_server, dive):
    server = page_server("--annotator", "anna", mission=dive)
    assert unseen(server, DARK) == {cell: "dark" for cell in LEFT if cell < 50}
    assert unseen(server, BLURRED) == {}


def test_frames_of_a_camera_that_a_model_did_not_learn_are_taken_for_sharp(
    page_server, tiny, tiny_bundle, tmp_path
):
    """Who labels looks at each; else such a model would suggest clear nowhere."""
    rng = np.random.default_rng(0)
    noisy = [rng.normal(90, 9, (480, 640)).astype(np.uint8) for _ in range(2)]
    content = read_bundle(tiny_bundle).content
    (tmp_path / "other.tokt").write_bytes(
        bundle_bytes(replace(content, sight=measure_sight(noisy)))
    )
    server = page_server("--annotator", "anna", "--model", tmp_path / "other.tokt")
    assert unseen(server, 1) == {} and None not in suggested(server, 1)[1]
    obstacle, _ = suggested(server, 1)
    assert False in obstacle


def test_a_fogged_dive_of_the_model_s_own_camera_keeps_its_marks(
    page_server, tiny, tiny_bundle, tmp_path
):
    folder = shutil.copytree(tiny.path, tmp_path / "tiny")
    for path in (folder / "Left").glob("*.png"):
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(path), cv2.GaussianBlur(picture, (0, 0), 4))
    model = "--annotator", "anna", "--model", tiny_bundle
    server = page_server(*model, mission=folder)
    assert len(unseen(server, 1)) > 50
    told = page_server(*model, "--sharp-frames", folder, mission=folder)
    assert len(unseen(told, 1)) < 5


def test_another_grid_gets_the_cause_of_the_patch_that_its_middle_lies_in(page_server, dive):
    server = page_server("--annotator", "anna", "--grid", "4x6@200", mission=dive)
    assert unseen(server, DARK) == dict.fromkeys([0, 1, 2, 6, 7, 8], "dark")


def test_a_frame_that_is_not_there_or_cannot_be_read_is_one_sentence(server, dive):
    answer = server.request("GET", "/api/sight?camera=left&frame=99")
    assert answer.status == 404 and answer.json["error"]
    path = dive / "Left/tiny_L_40.png"
    path.write_bytes(path.read_bytes()[:200])
    answer = server.request("GET", "/api/sight?camera=left&frame=40")
    assert answer.status == 422 and "tiny_L_40" in answer.json["error"]
