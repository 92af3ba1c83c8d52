"""The strip of frames, and playing, in a real browser: what they show; nothing is written."""

import re
import shutil

import pytest

from tests.waiting import until

COLUMN = """x => {
  const strip = document.querySelector(".timeline");
  return [...strip.getContext("2d").getImageData(x, 0, 1, strip.height).data];
}"""
SHOWN = """() => {
  const image = document.querySelector(".peek img");
  return image.style.visibility === "visible" && image.naturalWidth > 0 && image.currentSrc;
}"""


@pytest.fixture(scope="module")
def server(page_server):
    return page_server("--annotator", "anna")


class Strip:
    """The strip on a frame's page."""

    def __init__(self, view):
        self.view, self.page = view, view.page
        self.box = self.page.locator(".timeline").bounding_box()

    def middle(self, frame, first=1, shown=40):
        """Where a frame is, in CSS pixels of the strip, when `shown` are, from `first` on."""
        return (frame - first + 0.5) / shown * self.box["width"]

    def hover(self, x):
        self.page.mouse.move(self.box["x"] + x + 1, self.box["y"] + 20)
        self.page.mouse.move(self.box["x"] + x, self.box["y"] + 20)

    def colours(self, frame):
        """All colours of a frame, beside the line that marks the current one."""
        found = self.page.evaluate(COLUMN, self.middle(frame) - 8)
        return {tuple(found[at : at + 3]) for at in range(0, len(found), 4)}


@pytest.fixture
def strip(view):
    return Strip(view)


def test_the_pointer_on_the_strip_shows_that_frame_and_its_state(strip, server):
    view = strip.view
    view.open(9)
    view.label("3", 0)
    view.label("1", 5)
    view.saved()
    strip.hover(strip.middle(9))
    view.shows(".peek", "frame 9 · part · ocean, sand")
    assert "/api/thumb/left/9?" in strip.page.wait_for_function(SHOWN).json_value()
    strip.page.mouse.down()  # dragged: the frame there is shown, small and large
    strip.hover(strip.middle(23))
    strip.page.mouse.up()
    view.shows(".peek", "frame 23 · ")
    view.wait(23)
    assert "/api/thumb/left/23?" in strip.page.wait_for_function(SHOWN).json_value()
    strip.page.mouse.move(*view.at(50))
    assert not strip.page.locator(".peek").is_visible()
    assert set(view.stored(9)) == {0, 5} and view.stored(23) == {}


def test_bands_show_the_classes_that_i_gave_at_once_and_nobody_elses(strip, server):
    colour = "() => import('/static/core/mission.js').then(({ colourOf }) => colourOf('reef'))"
    reef = tuple(map(int, re.findall(r"\d+", strip.page.evaluate(colour))))
    server.paint("bands-1", 31, [4], "reef", who="ben")
    strip.view.open(30)
    strip.view.label("4", 7)
    strip.view.saved()
    assert until(lambda: reef in strip.colours(30))
    assert reef not in strip.colours(31)
    strip.view.press("Control+z")
    strip.view.saved()
    assert until(lambda: reef not in strip.colours(30))
    someone = "who => import('/static/core/mission.js').then(({ setPerson }) => setPerson({ who }))"
    strip.page.evaluate(someone, "ben")
    assert until(lambda: reef in strip.colours(31))
    strip.page.evaluate(someone, "anna")


PLAYS = """on => document.querySelector(".player button").getAttribute("aria-pressed") === on"""
TOLD = """() => {
  const output = document.querySelector(".player output");
  window.told = [];
  new MutationObserver(() => told.push(output.textContent)).observe(output, { childList: true });
}"""
SEEN = """() => performance.getEntriesByName("tokt:frame").map(({ detail }) => detail.frame)"""


def plays(view, on="true"):
    view.page.wait_for_function(PLAYS, arg=on)


def test_playing_goes_on_to_the_end_and_writes_nothing(view, server):
    view.open(34)
    event = server.get("/api/mission")["event"]
    view.page.get_by_label("Frames a second").select_option("25")
    view.press("k")
    view.wait(40)
    plays(view, "false")
    view.shows("#toast", "No further frame")
    seen = view.page.evaluate(SEEN)
    assert seen == sorted(seen) and len(seen) > 3
    assert server.get("/api/mission")["event"] == event


def test_whatever_labels_or_steps_stops_it_and_labels_nothing(view, server):
    event = server.get("/api/mission")["event"]
    for act in ("stroke", "Space", "Enter", "o", "g", "Delete", "d", "k"):
        view.open(5)
        view.press("Escape", "ArrowDown")  # the cursor is there: the next Space would paint
        view.page.get_by_label("Frames a second").select_option("5")
        view.page.locator(".player button").click()
        plays(view)
        view.page.wait_for_function(
            "() => document.querySelector('.timeline').getAttribute('aria-valuenow') > 5"
        )
        if act == "stroke":
            view.drag(33, 36)
        else:
            view.press(act)
        plays(view, "false")
        view.saved()
        assert server.get("/api/mission")["event"] == event, act
    view.open(13)
    view.label("1", 0)
    assert view.stored(13) == {0: "ocean"}


def test_frames_that_come_late_are_passed_over_and_the_rate_is_what_is_reached(open_frame):
    view = open_frame(1)

    def late(route):
        view.page.wait_for_timeout(120)
        route.continue_()

    view.page.route("**/api/picture/**", late)
    view.page.get_by_label("Frames a second").select_option("25")
    view.page.evaluate(TOLD)
    view.press("k")
    view.wait(40)
    plays(view, "false")
    assert any(rate < 15 for rate in view.page.evaluate("() => told.map(parseFloat)") if rate)
    assert 3 < len(view.page.evaluate(SEEN)) < 30
    view.page.unroute_all(behavior="wait")


PART = """selector => {
  const canvas = document.querySelector(selector);
  const { clientWidth: x, clientHeight: y } = canvas;
  const { data } = canvas.getContext("2d").getImageData(x / 2, y / 2, 60, 60);
  return String(data.reduce((sum, value, at) => (sum * 31 + value * (at + 1)) % 1000003, 7));
}"""


def test_left_and_right_side_by_side_the_second_is_to_look_at(open_frame, page_server, own_tiny):
    shutil.copytree(own_tiny.path / "Left", own_tiny.path / "Right")
    (own_tiny.path / "Right" / "tiny_L_5.png").unlink()
    server = page_server("--annotator", "anna", mission=own_tiny.path)
    server.paint("right-1", 3, list(range(100)), "reef", camera="right")
    view = open_frame(3, server)

    def part(canvas):
        return view.page.evaluate(PART, canvas)

    view.press("w", "v")  # with no labels both pictures are the same here
    other = view.page.locator(".other-canvas")
    assert other.get_attribute("aria-label") == "right frame 3, to look at"
    assert until(lambda: part(".other-canvas") == part(".frame-canvas"))
    whole = part(".frame-canvas")
    view.press("+", "+", "+")
    assert until(lambda: part(".other-canvas") == part(".frame-canvas") != whole)
    view.press("0", "v")
    assert until(lambda: part(".other-canvas") != part(".frame-canvas"))  # its reef is drawn
    view.press("3")
    other.click()
    view.shows("#toast", "to look at")
    view.click(44)
    view.saved()
    assert {(one.camera, one.label) for one in view.records(3)} == {
        ("left", "sand"),
        ("right", "reef"),
    }
    view.open(5)
    assert not other.is_visible()  # there is none
