"""The live view's page in Chromium: on a phone, in another page, and with its server gone."""

import http.server
import signal
import threading

import cv2
import numpy as np
import pytest

from tests.inference.view_client import viewed
from tests.waiting import MAX_S, until
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import Limits
from tokt.inference.outputs import view as view_module

pytestmark = pytest.mark.browser
PHONE = {"width": 360, "height": 640}


@pytest.fixture(scope="module")
def view():
    """One that tests look at which do it no harm."""
    with viewed() as made:
        yield made


@pytest.fixture
def open_page(browser):
    """A tab of that size with its errors, which are none."""
    opened, errors = [], []

    def go(url, size=PHONE):
        context = browser.new_context(viewport=size, has_touch=size is PHONE)
        context.set_default_timeout(1000 * MAX_S)
        page = context.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda said: errors.append(said.text) if "Policy" in said.text else None)
        page.goto(url)
        opened.append(context)
        return page

    yield go
    for context in opened:
        context.close()
    assert errors == []


SAYS = """([word, covered]) => {
  const words = document.querySelector("dd")?.textContent.trim() ?? "";
  const cover = document.querySelector("#cover");
  return words.split(/\\s+/)[0] === word && !!cover?.checkVisibility() === covered;
}"""


def until_says(view, page, word, covered=False, patches=None):
    """Show frames, if any are given, until the page says that word, covered or not."""
    asked = word.split()[0], covered
    if patches is None:
        page.wait_for_function(SAYS, arg=asked)
    else:
        until(lambda: view.see(patches) and page.evaluate(SAYS, asked), page.content)


def pixels(page, of="img"):
    """A screenshot of a part of the page."""
    shot = page.locator(of).screenshot()
    return cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR).astype(int)


def test_a_phone_shows_all_of_it_without_scrolling_sideways(open_page, view):
    page = open_page(view.url)
    until_says(view, page, "OBSTACLE", patches=[(4, 2)])
    named = [page.locator(kind).all_inner_texts() for kind in ("dt", "dd")]
    facts = dict(zip(*named, strict=True))
    assert list(facts) == ["verdict", "age", "model", "steer", "health"]
    assert facts["steer"].startswith("right") and facts["age"].endswith(" s")
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    box = page.locator("img").bounding_box()
    assert (box["x"], box["width"]) == (0, 360) and box["y"] == 0
    assert page.evaluate("getComputedStyle(document.querySelector('dd')).fontSize") == "16px"
    # The banner; words come before the picture is drawn.
    until(lambda: np.abs(pixels(page)[3, 34] - [30, 30, 200]).max() < 20)
    # Of the last minute: now is at the right, and moves on while the page is drawn.
    until(
        lambda: (
            view.see([(4, 2)])
            and (np.abs(pixels(page)[-4, -6:] - [30, 30, 200]).max(axis=1) < 40).any()
        )
    )
    until_says(view, page, "CLEAR", patches=[])
    assert np.abs(pixels(page)[3, 34] - [60, 110, 20]).max() < 20


def drag(page, *ends, button="left"):
    """Draw from one place on the picture to another, in shares of it."""
    room = page.locator("#picture").bounding_box()
    for at, (x, y) in enumerate(ends):
        page.mouse.move(room["x"] + x * room["width"], room["y"] + y * room["height"], steps=3)
        if at == 0:
            page.mouse.down(button=button)


SECOND_FINGER = """() => {
  for (const [kind, clientX] of [["down", 90], ["move", 20], ["up", 20]])
    document.getElementById("picture").dispatchEvent(new PointerEvent(`pointer${kind}`,
      { clientX, clientY: 90, pointerId: 7, isPrimary: false, bubbles: true }));
}"""


@pytest.mark.parametrize("size", [PHONE, {"width": 1280, "height": 500}])
def test_a_box_drawn_on_the_page_names_the_object_of_that_very_frame(open_page, size):
    with viewed() as view:
        page = open_page(view.url, size)
        until_says(view, page, "OBSTACLE", patches=[(4, 2)])
        wide, high = 720, page.evaluate("document.getElementById('picture').naturalHeight")
        room = page.locator("#picture").bounding_box()
        times = min(room["width"] / wide, room["height"] / high)
        top, bottom = page.evaluate("document.getElementById('picture').rows")

        def on_frame(x, y):  # as shares of the element
            x = (room["width"] - times * wide) / 2 + times * wide * x
            y = (room["height"] - times * high) / 2 + times * (top + y * (bottom - top))
            return x / room["width"], y / room["height"]

        drag(page, on_frame(0.5, 0.6), on_frame(0.15, 0.35))  # the button was not pressed
        page.mouse.up()
        page.get_by_role("button").click()
        drag(page, on_frame(0.1, 0.1), on_frame(0.8, 0.8), button="right")
        page.mouse.up(button="right")
        drag(page, on_frame(0.5, 0.6), on_frame(0.15, 0.35))
        page.evaluate(SECOND_FINGER)
        frame = page.evaluate("document.getElementById('picture').frame")
        for _ in range(20):  # it stands still, and what is said goes on
            view.see([(4, 2)])
        until_says(view, page, "CLEAR", patches=[])
        assert page.evaluate("document.getElementById('picture').frame") == frame
        drawn = page.locator("#box").bounding_box()
        assert drawn["width"] == pytest.approx(0.35 * times * wide, abs=2)
        page.mouse.up()
        until(lambda: view.see([(4, 2)]) and view.events)
        (event,) = view.events
        assert (event.name, event.fields["frame"]) == ("object_named", frame)
        assert event.fields["box"] == pytest.approx([0.15, 0.35, 0.35, 0.25], abs=0.01)
        assert not page.locator("#box").is_visible()
        until(lambda: view.see([(4, 2)]) and "searching" in page.locator("dl").inner_text())
        page.get_by_role("button").click()
        drag(page, on_frame(0.5, 0.5), on_frame(0.51, 0.51))
        page.mouse.up()
        until(lambda: view.see([(4, 2)]) and "cannot be held" in page.locator("dl").inner_text())


@pytest.fixture
def other_site():
    """A page of another origin that frames an address, and shows a stream beside it."""

    class Site(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            body = self.server.page.encode()
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *told): ...

    with http.server.HTTPServer(("127.0.0.1", 0), Site) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server
        server.shutdown()


def framed_in(other_site, open_page, *tags):
    """A page of another site with these tags, and the first one's inner page."""
    other_site.page = "".join(tags)
    page = open_page(
        f"http://localhost:{other_site.server_address[1]}/", {"width": 900, "height": 500}
    )
    return page, page.frames[1]


def test_another_site_s_page_frames_it_and_shows_the_stream(open_page, other_site):
    with viewed(token="a b/c") as view:
        stream = view.url.replace("/?", "/stream.mjpg?")
        tags = f'<iframe src="{view.url}"></iframe>', f'<img src="{stream}">'
        page, inner = framed_in(other_site, open_page, *tags)
        until_says(view, inner, "OBSTACLE", patches=[(4, 2)])
        until(
            lambda: view.see([(4, 2)]) and page.evaluate("document.images[0].naturalWidth") == 720
        )
        # The stream alone says it, too, in its own pixels.
        until(
            lambda: (
                view.see() and np.abs(pixels(page, "body > img")[4, 60] - [60, 110, 20]).max() < 20
            )
        )


def test_a_hidden_frame_has_no_button_and_shows_what_is_true_when_it_is_back(
    view, open_page, other_site
):
    """As Cockpit hides the widgets of another of its views."""
    page, inner = framed_in(other_site, open_page, f'<iframe src="{view.url}"></iframe>')
    until_says(view, inner, "CLEAR", patches=[])
    assert not inner.locator("button").is_visible()
    page.evaluate("document.querySelector('iframe').style.display = 'none'")
    page.wait_for_timeout(2000)
    view.until_shown("OBSTACLE", [(4, 2)])
    page.evaluate("document.querySelector('iframe').style.display = ''")
    until_says(view, inner, "OBSTACLE", patches=[(4, 2)])


def test_without_the_token_it_says_what_to_open(open_page):
    with viewed(token="abc") as view:
        page = open_page(view.url)
        until_says(view, page, "CLEAR", patches=[])
        page.evaluate("history.replaceState(null, '', '/?token=no')")
        page.reload()
        assert page.locator("#cover").count() == 0
        assert "Open the address that tokt run printed" in page.content()


def test_a_server_that_hangs_or_is_gone_is_no_signal_until_it_is_back(open_page, monkeypatch):
    monkeypatch.setattr(view_module, "ANSWER_S", 1.0)
    with viewed() as view:
        page = open_page(view.url)
        for how in (signal.SIGSTOP, signal.SIGKILL):
            until_says(view, page, "CLEAR", patches=[])
            view.signal(how)
            until_says(view, page, "NO SIGNAL", covered=True)
            assert page.evaluate("passed(news) / 1000") >= 1
            cover, whole = page.locator("#cover").bounding_box(), page.locator("img").bounding_box()
            assert all(abs(cover[side] - whole[side]) < 1 for side in cover)
            shown = pixels(page, "#cover")
            assert (shown.max(axis=2) - shown.min(axis=2) < 30).mean() > 0.8  # not the picture
            until_says(view, page, "OBSTACLE", patches=[(4, 2)])


def test_old_counts_up_and_ended_stays(open_page):
    with viewed(Limits(1.0, MAX_S)) as view:
        page = open_page(view.url)
        until_says(view, page, "CLEAR", patches=[])
        seen_s = SYSTEM_CLOCK.monotonic()
        until_says(view, page, "OLD")
        ages = []

        def count():
            """An answer's time on its way may be in the age: too old, but never too young."""
            least_s = SYSTEM_CLOCK.monotonic() - seen_s
            look = "() => { look(); return document.querySelectorAll('dd')[1].textContent; }"
            ages.append(float(page.evaluate(look)[:-2]))
            assert ages[-1] >= least_s - 0.06  # it is rounded
            return len(set(ages)) > 5

        until(count)
        view.view.close()
        until_says(view, page, "ENDED")
        page.wait_for_timeout(1200)
        assert page.evaluate(SAYS, ("ENDED", False))
        assert page.locator("dd").first.text_content() == "ENDED the run is over"


def test_a_computer_that_slept_shows_nothing_of_before(open_page, view):
    """The page's monotonic clock stood still meanwhile: at once, not a second after it woke."""
    page = open_page(view.url)
    until_says(view, page, "CLEAR", patches=[])
    slept = """() => {
      const now = Date.now;
      Date.now = () => now() + 60000;
      look();
      const covered = !document.getElementById("cover").hidden;
      Date.now = now;
      return covered;
    }"""
    assert page.evaluate(slept)
    until_says(view, page, "CLEAR", patches=[])
