"""The toolbar, the drawer and where the page opens, in a real browser."""

import pytest

pytestmark = pytest.mark.xdist_group("browser_toolbar")  # what they share is made once


@pytest.fixture(scope="module")
def server(page_server, tiny_bundle):
    return page_server("--annotator", "anna", "--model", tiny_bundle)


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
    assert said.inner_text().endswith(", sure")
    assert "decision value" in said.get_attribute("title")
    main.click()
    view.wait(25)
    assert set(view.stored(24)) == sure and view.stored(25) == {}
    view.press("Control+z")
    view.wait(24)
    assert view.stored(24) == {}
