"""The frame view in a real browser: what is painted is what the store holds."""

import pytest


@pytest.fixture(scope="module")
def server(page_server, tiny_bundle):
    return page_server("--annotator", "anna", "--model", tiny_bundle)


def test_click_drag_rectangle_row_and_rest_are_stored(view):
    view.open(3)
    view.label("5", 44)
    view.drag(0, 7, 77)  # two long jumps: none of the patches between may be left out
    view.page.keyboard.down("Shift")
    view.press("3")
    view.drag(81, 92)
    view.page.keyboard.up("Shift")
    view.click(99, button="right")
    view.press("4")
    view.page.mouse.click(*view.row_head(5))
    view.saved()
    expected = {44: "subsea_installation", 99: "unsure"}
    expected |= dict.fromkeys(range(8), "subsea_installation")
    expected |= dict.fromkeys(range(17, 78, 10), "subsea_installation")
    expected |= dict.fromkeys((81, 82, 91, 92), "sand")
    expected |= dict.fromkeys(range(50, 60), "reef")
    assert view.stored(3) == expected
    view.press("o")
    view.saved()
    rest = dict.fromkeys(set(range(100)) - set(expected), "ocean")
    assert view.stored(3) == expected | rest
    assert view.text("#status").endswith("done") or "done" in view.text("#status")


def test_a_stroke_is_of_the_frame_on_which_it_began(view):
    view.open(10)
    view.press("5")
    view.page.mouse.move(*view.at(30))
    view.page.mouse.down()
    view.page.mouse.move(*view.at(32))
    view.press("d")
    view.wait(11)
    view.page.mouse.move(*view.at(35))
    view.page.mouse.up()
    assert view.stored(10) == dict.fromkeys((30, 31, 32), "subsea_installation")
    assert view.stored(11) == {}


def test_undo_and_redo_reach_back_over_a_reload(view):
    view.open(5)
    view.label("2", 10)
    view.click(11)
    view.label("e", 10)
    view.press("1")
    view.open(6)
    view.click(20)
    assert view.stored(5) == {11: "other"} and view.stored(6) == {20: "ocean"}
    view.page.reload()
    view.wait(6)
    view.press("Control+z")
    view.shows("#toast", "paint")
    assert view.stored(6) == {}
    view.press("d")
    view.wait(7)
    view.press("Control+z")
    view.wait(5)
    assert "erase" in view.text("#toast") and "frame 5" in view.text("#toast")
    view.press("Control+z", "Control+Shift+z", "Control+y")
    assert view.stored(5) == {11: "other"}
    view.press("Control+z", "Control+z", "Control+z")
    assert view.stored(5) == {}


def test_a_frame_is_labelled_by_keyboard_alone(view, server, obstacles_said):
    view.page.keyboard.type("f8\n")
    view.wait(8)
    view.press("Escape", "ArrowDown", "ArrowDown", "ArrowRight", "3", "Space")  # row 2, column 2
    view.shows("#announcer", "sand: row 1, column 1")
    view.press("ArrowRight", "Shift+ArrowRight", "Shift+ArrowDown", "5")
    view.shows("#announcer", "subsea_installation: row 1, column 2 and 3 more")
    view.press("Escape", "ArrowDown", "ArrowDown", "4", "r")
    view.press("ArrowDown", "u", "Space", "m", "o", "m")  # not shown, the model still has its say
    view.saved()
    expected = dict.fromkeys({*range(100)} - obstacles_said(server, 8), "ocean")
    expected |= {11: "sand", 53: "unsure"}
    expected |= dict.fromkeys((12, 13, 22, 23), "subsea_installation")
    expected |= dict.fromkeys(range(40, 50), "reef")
    assert view.stored(8) == expected
    view.press("n")
    assert "frame 8 " not in view.text("#status")
    view.press("?")
    overlay = view.page.locator("#help")
    assert overlay.is_visible()
    text = overlay.text_content() or ""
    assert "subsea_installation" in text and "Alt+click" in text
    view.press("Escape")
    assert not overlay.is_visible()


def test_suggestions_are_labels_only_when_accepted(view, server):
    view.open(14)
    view.page.wait_for_function(
        "() => /of 100 suggested patches/.test(document.querySelector('.model-said').textContent)"
    )
    assert view.stored(14) == {}
    view.label("2", 0)
    view.click_holding("Alt", 1)
    view.saved()
    query = {"who": "anna", "camera": "left", "frames": 14, "suggest": 1}
    [suggested] = server.get("/api/labels", **query)["frames"]
    assert set(view.stored(14)) == {0, 1} and list(suggested["models"]) == ["1"]
    values = suggested["suggestions"]["values"]
    view.press(*">" * 25, "Enter")
    view.saved()
    confident = {cell for cell in range(2, 100) if values[cell] >= 3}
    assert 10 < len(confident) < 90
    assert set(view.stored(14)) == {0, 1} | confident
    assert view.stored(14)[0] == "other"
    view.press("Shift+Enter")
    view.saved()
    confirmed = view.records(14)
    assert len(confirmed) == 100 and {one.source for one in confirmed} == {"human"}
    versions = {one.model_version for one in confirmed if (one.row, one.col) != (0, 0)}
    assert len(versions) == 1 and None not in versions
    view.press("Control+z")
    view.saved()
    assert set(view.stored(14)) == {0, 1} | confident


def test_no_key_for_many_calls_clear_what_the_model_calls_an_obstacle(view, server, obstacles_said):
    """Carried, copied, or the rest: only a stroke of one's own contradicts the model."""
    tower = sorted(obstacles_said(server, 28) & obstacles_said(server, 29))
    assert len(tower) > 2
    view.open(28)
    view.page.evaluate(
        "() => import('/static/core/mission.js').then(({ setSetting }) => setSetting('follow', 5))"
    )
    view.label("1", *tower)  # wrong, but a person's own
    view.press("o")  # the rest, but for what else is an obstacle
    view.saved()
    assert set(view.stored(28).values()) == {"ocean"}
    view.press("d")
    view.wait(29)
    for keys in (("Shift+Enter",), ("p", "Enter"), ("o",), ("m", "o", "p", "Enter", "m")):
        view.press(*keys)
        view.saved()
        said = {view.stored(29).get(cell) for cell in tower}
        assert said <= {None, "subsea_installation"}, keys
        assert "ocean" in view.stored(29).values()
        view.press("Control+z")
        view.saved()
        assert view.stored(29) == {}
        view.press("Escape")
