"""The toolbar, the drawer and where the page opens, in a real browser."""

from dataclasses import replace

import cv2
import pytest

from tests.inference.stereo.plain_rig import PLAIN
from tests.inference.stereo.test_carried_labels import coverage, pair
from tests.waiting import until
from tokt.inference.stereo.calibration_writer import write_calibration
from tokt.models.bundle.bundle import bundle_bytes, read_bundle

pytestmark = pytest.mark.xdist_group("browser_toolbar")  # what they share is made once


@pytest.fixture(scope="module")
def server(page_server, tiny_bundle, tmp_path_factory):
    content = read_bundle(tiny_bundle).content
    row = {"obstacle": False, "low": 3.0, "high": None, "n": 80, "right": 1.0, "at_least": 0.9261}
    wrong = {**row, "at_least": 7}, {**row, "low": "nan"}, {**row, "high": 2.0, "at_least": 0.1}
    metrics = {**content.metrics, "right_by_margin": [*wrong, row]}
    file = tmp_path_factory.mktemp("model") / "tiny.tokt"
    file.write_bytes(bundle_bytes(replace(content, metrics=metrics)))
    return page_server("--annotator", "anna", "--model", file)


def command(view, name):
    return view.page.locator(f"[data-command={name}]")


def refuses(view, name):
    """Why a button would do nothing; None if it can be pressed."""
    found = command(view, name)
    return found.get_attribute("title") if found.get_attribute("aria-disabled") else None


def test_the_page_opens_where_this_person_stopped(open_frame, browse, server):
    view = open_frame(7)
    view.label("3", 44)
    view.open(9)
    view.label("e", 12)  # nothing was labelled here
    view.saved()
    for who, frame in (("anna", 7), ("carl", 1)):
        page = browse(server, who=who)
        page.wait_for_url(f"**/#/label/left/{frame}")
    page = browse(server, "#/overview/left/1")
    page.wait_for_selector(".thumb")
    page.click("[data-view=label]")
    page.wait_for_url("**/#/label/left/7")


def test_buttons_that_would_do_nothing_say_why(open_frame, page_server):
    view = open_frame(1, page_server("--annotator", "anna"))
    view.shows("#status", "Choose a class, then click")  # nobody has labelled anything yet
    for name in ("undo", "redo", "previous", "copy", "blink", "acceptNext", "uncertain"):
        assert refuses(view, name), name
    assert refuses(view, "undo") == "Nothing to undo."
    assert "no model" in refuses(view, "uncertain")
    assert refuses(view, "rest") is None and refuses(view, "next") is None
    command(view, "previous").click(force=True)
    assert "No frame before" not in view.text("#toast")
    view.label("3", 44)
    view.press("o")
    view.saved()
    assert refuses(view, "undo") is None and refuses(view, "rest")
    assert (
        command(view, "undo").get_attribute("title") == "Undo: rest, 99 patches, left frame 1 (z)"
    )
    command(view, "undo").click()
    view.shows("#toast", "Undone: rest")
    assert view.stored(1) == {44: "sand"} and refuses(view, "redo") is None
    view.press("End")
    view.wait(40)
    assert refuses(view, "next") and refuses(view, "previous") is None
    view.press("S")
    view.page.get_by_role("link", name="Train a model").click()
    view.page.wait_for_url("**/#/files")


def test_what_is_said_of_a_frame_leaves_with_it(open_frame):
    view = open_frame(12)
    view.press("p")
    view.shows("#toast.shown", "You have no labels on frame 11")
    view.press("d")
    view.wait(13)
    assert view.page.locator("#toast.shown").count() == 0
    view.page.evaluate(
        "() => import('/static/core/dom.js').then(({ say }) => say('the server', { stays: true }))"
    )
    view.press("d")
    view.wait(14)
    assert view.page.locator("#toast.shown").count() == 1


def test_settings_wait_in_a_drawer_that_stays_as_it_was_left(open_frame):
    view = open_frame(15)
    drawer = view.page.locator(".drawer")
    assert not drawer.is_visible()
    view.press("S")
    drawer.wait_for(state="visible")
    view.page.reload()
    view.wait(15)
    assert drawer.is_visible()
    command(view, "settings").click()
    drawer.wait_for(state="hidden")


def test_the_one_main_button_accepts_what_is_sure_and_goes_on(open_frame, server):
    view = open_frame(24)
    query = {"who": "anna", "camera": "left", "frames": 24, "suggest": 1}
    view.page.wait_for_function(
        "() => document.querySelector('.model-said').textContent.includes('of 100')"
    )
    view.press(*">" * 25)
    [suggested] = server.get("/api/labels", **query)["frames"]
    sure = {cell for cell, value in enumerate(suggested["suggestions"]["values"]) if value >= 3}
    assert 0 < len(sure) < 100
    main = view.page.locator(".frame-view button.main")
    assert main.all_inner_texts() == ["Accept and next"]
    view.point(min(sure))
    said = view.page.locator("#status span")
    assert said.inner_text().endswith(", sure (clear: 92 %)")
    assert "decision value" in said.get_attribute("title")
    main.click()
    view.wait(25)
    assert set(view.stored(24)) == sure and view.stored(25) == {}
    view.press("Control+z")
    view.wait(24)
    assert view.stored(24) == {}


def test_labels_of_the_left_camera_are_proposed_where_they_lie_in_the_right(
    page_server, browse, tmp_path
):
    dive = tmp_path / "dive"
    for camera, picture in zip(("Left", "Right"), pair(700, 350, 200), strict=True):
        (dive / camera).mkdir(parents=True)
        cv2.imwrite(str(dive / camera / f"dive_{camera[0]}_1.png"), picture)
    server = page_server("--annotator", "anna", mission=dive, workspace=tmp_path / "ws")
    page = browse(server, "#/label/right/1")
    page.wait_for_selector("[data-command=carry][title*='No calibration']")
    page.close()
    server.kill()
    write_calibration(tmp_path / "calibration.yml", PLAIN, {})
    server.arguments += ("--calibration", str(tmp_path / "calibration.yml"))
    server.start()
    labels = ["other" if share >= 0.1 else "ocean" for share in coverage(700, 350)]
    for label in ("ocean", "other"):
        cells = [cell for cell, known in enumerate(labels) if known == label]
        server.paint(f"paint-{label}", 1, cells, label)
    page = browse(server, "#/label/left/1")
    page.wait_for_selector("[data-command=carry][title^='Labels go from the left']")
    page.keyboard.press("s")

    def proposed():  # not while the picture is on its way
        page.click("[data-command=carry]:not([aria-disabled])")
        return "copied" in page.inner_text("#toast")

    until(proposed)
    page.keyboard.press("Enter")
    page.wait_for_selector('#save-state[data-state="saved"]')
    (stored,) = server.get("/api/labels", who="anna", camera="right", frames=1)["frames"]
    there = coverage(500, 350)
    assert set(stored["mine"]) == {None, "other"}
    for label, share in zip(stored["mine"], there, strict=True):
        assert label == "other" or share < 0.9
