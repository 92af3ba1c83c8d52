"""Patches that are not seen, in a real browser: marked, told why, and painted as others are."""

import shutil

import cv2
import numpy as np
import pytest

from tests.labels.page.colours import contrast, luminance
from tests.waiting import until

NIGHT, SNOW, BLURRED, NARROW = 11, 12, 8, 41  # frames


@pytest.fixture(scope="module")
def dive(tiny, tmp_path_factory):
    """The tiny mission; the left half of three frames is dark, saturated or blurred.

    One more frame has a shape that the model cannot judge.
    """
    folder = shutil.copytree(tiny.path, tmp_path_factory.mktemp("unseen") / "tiny")
    for frame in (NIGHT, SNOW, BLURRED):
        path = str(folder / f"Left/tiny_L_{frame}.png")
        picture = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
        blurred = cv2.GaussianBlur(picture, (0, 0), 4)
        picture[:, :180] = {NIGHT: 2, SNOW: 250, BLURRED: blurred[:, :180]}[frame]
        cv2.imwrite(path, picture)
    cv2.imwrite(str(folder / f"Left/tiny_L_{NARROW}.png"), picture[:90])
    return folder


@pytest.fixture(scope="module")
def server(page_server, tiny_bundle, dive):
    return page_server("--annotator", "anna", "--model", tiny_bundle, mission=dive)


def marked(view, cell):
    """Whether something with a contrast of 3 to the patch itself is drawn in its middle."""
    shot = np.frombuffer(view.page.screenshot(), np.uint8)
    seen = luminance(cv2.imdecode(shot, cv2.IMREAD_COLOR)[..., ::-1])
    x, y = map(round, view.at(cell))
    mark, ground = seen[y - 8 : y + 9, x - 8 : x + 9], seen[y + 20, x]
    return (contrast(mark, ground) > 3).sum() > 8


@pytest.mark.parametrize(("frame", "cause"), [(NIGHT, "dark"), (SNOW, "saturated")])
def test_the_mark_shows_on_dark_and_bright_water(open_frame, frame, cause):
    view = open_frame(frame)
    view.page.evaluate(
        "() => import('/static/core/mission.js').then(({ setSetting }) =>"
        " { setSetting('enhance', 0); setSetting('suggestions', false); })"
    )
    view.shows("#status", "patches are not seen: ")
    view.point(52)
    view.shows("#status", f"not seen: {cause}")
    view.page.mouse.move(1, 1)
    until(lambda: marked(view, 52), lambda: "there is no mark")
    assert not marked(view, 57)
    view.press("v")
    until(lambda: not marked(view, 52), lambda: "it is not hidden with the labels")


def test_the_cause_is_said_and_the_patch_takes_a_label(open_frame, server):
    view = open_frame(BLURRED)
    view.shows("#status", "patches are not seen: blurred")
    [labels] = server.get("/api/labels", camera="left", frames=BLURRED, suggest=1)["frames"]
    unknown = [cell for cell, value in enumerate(labels["suggestions"]["values"]) if value is None]
    cell = unknown[0]
    view.point(cell)
    view.shows("#status", f"row {cell // 10}, column {cell % 10}: no label, not seen: blurred")
    assert "suggests" not in view.text("#status")
    view.press("Shift+Enter")  # all suggestions
    view.shows("#status", f"{100 - len(unknown)} of 100 labelled")
    assert not {*view.stored(BLURRED)} & {*unknown}
    view.label("3", cell)
    assert view.stored(BLURRED)[cell] == "sand"
    view.point(cell)
    view.shows("#status", "sand, not seen: blurred")


def test_copies_of_what_is_clear_are_not_sure_where_nothing_is_seen(open_frame, server):
    server.paint("before", BLURRED - 1, [*range(100)], "ocean")
    view = open_frame(BLURRED)
    view.shows("#status", "patches are not seen: blurred")
    before = view.stored(BLURRED)
    view.press("p", "Enter")
    view.saved()
    added = {*view.stored(BLURRED)} - {*before}
    [labels] = server.get("/api/labels", camera="left", frames=BLURRED, suggest=1)["frames"]
    assert not any(labels["suggestions"]["values"][cell] is None for cell in added)


def test_why_nothing_is_suggested_stands_beside_the_picture(open_frame):
    view = open_frame(NARROW)
    view.shows("#status", "No suggestions: ")
    view.shows("#status", "360x90")
    view.press("m")
    view.shows("#status", "Suggestions are switched off (m)")
    view.press("m")
    view.open(1)
    until(lambda: "No suggestions" not in view.text("#status"))
