"""A tab of the labelling page in a headless Chromium, as a person's hand and eye use it."""

import json
import time
from collections.abc import Sequence
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID

ANNOTATOR = "bench"  # who labels in every tab
FIRST, FRAME, ACK = "tokt:first", "tokt:frame", "tokt:ack"
"""Performance entries that the page makes: a mark, and two measures."""
WIDTH, HEIGHT = 1280, 720
_MAX_MS = 60_000
_LOOK_EVERY_S = 0.01

_FRAME_BOX = """async () => {
  const { Viewport } = await import("/static/frame/viewport.js");
  const { picture } = await import("/static/core/pictures.js");
  const { setting } = await import("/static/core/settings.js");
  const canvas = document.querySelector(".frame-canvas");
  const [, , camera, frame] = location.hash.split("/");
  const view = new Viewport();
  view.canvas = { width: canvas.clientWidth, height: canvas.clientHeight };
  view.frame = await picture(camera, Number(frame), setting("enhance"));
  const { left, top } = canvas.getBoundingClientRect();
  const size = [view.frame.width * view.scale, view.frame.height * view.scale];
  return [left + view.origin.x, top + view.origin.y, ...size];
}"""
_NOTE_KEYS = """
  window.toktPressed = [];
  performance.setResourceTimingBufferSize(100000);
  addEventListener("keydown", (event) => window.toktPressed.push(event.timeStamp), true);
"""
_DRAWN = """(name) => performance.getEntriesByName(name)
  .map((entry) => [entry.detail.frame, entry.startTime + entry.duration])"""
_DURATIONS = """([name, first]) =>
  performance.getEntriesByName(name).slice(first).map((entry) => entry.duration)"""
_IS_DRAWN = """([name, frame]) =>
  performance.getEntriesByName(name).at(-1)?.detail.frame === frame"""
_MORE = "([name, known]) => performance.getEntriesByName(name).length > known"
_COUNT = "name => performance.getEntriesByName(name).length"
_START = "name => performance.getEntriesByName(name)[0].startTime"
Box = Sequence[float]  # left, top, width and height of a picture, in the window's pixels


def middle_of(box: Box, cell: int) -> tuple[float, float]:
    left, top, width, height = box
    row, col = divmod(cell, DEFAULT_GRID.cols)
    x, y = (col + 0.5) / DEFAULT_GRID.cols, (row + 0.5) / DEFAULT_GRID.rows
    return left + x * width, top + y * height


class Tab:
    """A tab on the page's server; each has its own cache and storage.

    All frames are taken to be of one size, and the picture is not zoomed.
    """

    def __init__(self, browser: Any, url: str) -> None:
        self._context = browser.new_context(viewport={"width": WIDTH, "height": HEIGHT})
        self._context.set_default_timeout(_MAX_MS)
        who = json.dumps(json.dumps({"who": ANNOTATOR}))
        self._context.add_init_script(f"localStorage.setItem('tokt.identity', {who})")
        self._context.add_init_script(_NOTE_KEYS)
        self.page: Any = self._context.new_page()
        self.url = url.rstrip("/")
        self._box: Box | None = None

    def close(self) -> None:
        self._context.close()

    def open(self, address: str) -> float:
        """Load the page at an address such as ``#/label/left/17``.

        It gives the ms from the start of the navigation to the picture with its labels drawn.
        """
        self.page.goto(f"{self.url}/{address}")
        self.wait_for(FIRST, 0)
        return float(self.page.evaluate(_START, FIRST))

    def count(self, name: str) -> int:
        return self.page.evaluate(_COUNT, name)

    def wait_for(self, name: str, known: int) -> None:
        self.until(_MORE, [name, known])

    def durations(self, name: str, first: int = 0) -> list[float]:
        """Durations of the entries of that name, ms, from the one numbered `first` on.

        A request's name is its address: from its being sent until its answer was received.
        """
        return list(self.page.evaluate(_DURATIONS, [name, first]))

    def frames_drawn(self) -> list[tuple[int, float]]:
        """Every frame that was drawn with its labels since the page was loaded, and when, ms."""
        return list(self.page.evaluate(_DRAWN, FRAME))

    def until_drawn(self, frame: int) -> None:
        self.until(_IS_DRAWN, [FRAME, frame])

    def key_presses(self) -> list[float]:
        """When keys went down, ms on the tab's clock."""
        return list(self.page.evaluate("() => window.toktPressed"))

    def click(self, cell: int) -> None:
        self._box = self._box or self.page.evaluate(_FRAME_BOX)
        self.page.mouse.click(*middle_of(self._box, cell))

    def until(self, script: str, arg: Any = None) -> Any:
        """Wait until a script, which may be asynchronous, gives something true, and return it."""
        last = time.monotonic() + _MAX_MS / 1000
        while not (found := self.page.evaluate(script, arg)):
            if time.monotonic() > last:
                raise ToktError(f"the page did not get so far in {_MAX_MS // 1000} s: {script}")
            time.sleep(_LOOK_EVERY_S)
        return found
