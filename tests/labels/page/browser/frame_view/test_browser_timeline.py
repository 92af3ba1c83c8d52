"""The strip of frames, and playing, in a real browser: what they show; nothing is written."""

import re

import pytest

from tests.waiting import until

pytestmark = pytest.mark.xdist_group("browser_timeline")  # what they share is made once

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
def strip(open_frame):
    return Strip(open_frame(1))


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


def test_zoomed_in_each_frame_can_be_hit_by_wheel_and_by_keys(strip):
    strip.hover(strip.middle(30))
    strip.page.mouse.wheel(0, -2000)  # as near as it goes: 20 frames, 30 stays under the pointer
    first = 30 + 0.5 - 20 * (30 - 0.5) / 40
    x = strip.middle(33, first, 20)
    strip.hover(x)
    strip.view.shows(".peek", "frame 33 ")
    strip.page.mouse.click(strip.box["x"] + x, strip.box["y"] + 20)
    strip.view.wait(33)
    strip.view.press("End", "Home")
    strip.view.wait(1)  # what is shown moves with the frame
    strip.hover(strip.middle(12, 1, 20))
    strip.view.shows(".peek", "frame 12 ")
    strip.page.locator(".timeline").focus()
    strip.view.press("0")
    strip.hover(strip.middle(12))
    strip.view.shows(".peek", "frame 12 ")
    strip.view.press("+", "+")
    strip.hover(strip.middle(12, 1, 20))
    strip.view.shows(".peek", "frame 12 ")
