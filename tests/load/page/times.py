"""Waiting times of a person at the labelling page: the page, a frame, a label, another tab."""

import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tests.load.report import WORST, Timing

from .tab import ACK, FRAME, Tab

FIRST_MS, FRAME_MS, ACK_MS, LIVE_MS = 1000.0, 50.0, 25.0, 2000.0  # what is asked for, in ms
STEP_KEY = "d"
_BETWEEN_STEPS_MS, _BETWEEN_CLICKS_MS = 250, 200
_LABEL_KEYS = ("1", "2")
_PAINT_KEYS = ("u", "1")  # nothing is unsure at first, so that every click changes something
_SEED = 1
FIRST_FRAME = "#/label/left/1"

_WATCH = """async ([camera, frame, cell, label]) => {
  const { labelsOf } = await import("/static/saving/labels.js");
  window.toktSeen = new Promise((resolve) => {
    const look = () => {
      if (labelsOf(camera, frame)?.mine[cell] === label) {
        resolve(performance.timeOrigin + performance.now());
      } else requestAnimationFrame(look);
    };
    look();
  });
}"""
_LAST_ACT = """() => {
  const last = performance.getEntriesByName("tokt:ack").at(-1);
  return performance.timeOrigin + last.startTime;
}"""


@dataclass(frozen=True)
class Repeats:
    loads: int
    steps: int
    jumps: int
    clicks: int
    changes: int


def first_page(browser: Any, url: str, loads: int) -> Timing:
    times = []
    for _ in range(loads):
        tab = Tab(browser, url)
        times.append(tab.open(FIRST_FRAME))
        tab.close()
    what = "start of the navigation to the first picture with its labels drawn"
    return Timing("first_page", what, times, FIRST_MS, WORST)


def stepping(tab: Tab, steps: int) -> list[Timing]:
    """Step forward at a person's pace, and then as fast as the page goes."""
    what = "key press to the next frame drawn with its labels"
    paced, fast = (_steps(tab, steps, pause_ms) for pause_ms in (_BETWEEN_STEPS_MS, None))
    return [
        Timing("next_frame", f"{what}, 4 a second", paced, FRAME_MS),
        Timing("next_frame_fast", f"{what}, each once the one before is drawn", fast, FRAME_MS),
    ]


def _steps(tab: Tab, count: int, pause_ms: int | None) -> list[float]:
    """Step from frame to frame, with a pause after each or none.

    A frame that was passed over because the next key came first has waited until a later one was
    drawn.
    """
    first, pressed = tab.frames_drawn()[-1][0], len(tab.key_presses())
    for number in range(first + 1, first + count + 1):
        tab.page.keyboard.press(STEP_KEY)
        if pause_ms is None:
            tab.until_drawn(number)
        else:
            tab.page.wait_for_timeout(pause_ms)
    tab.until_drawn(first + count)
    drawn = tab.frames_drawn()
    return [
        next(end for frame, end in drawn if frame >= number and end > press) - press
        for number, press in enumerate(tab.key_presses()[pressed:], first + 1)
    ]


def jumps(tab: Tab, frames: int, count: int) -> Timing:
    """Go to frames all over the mission, which nothing can have fetched before."""
    known = tab.count(FRAME)
    for number in random.Random(_SEED).sample(range(1, frames + 1), min(count, frames)):
        tab.page.wait_for_timeout(_BETWEEN_STEPS_MS)
        tab.page.evaluate("address => { location.hash = address }", f"#/label/left/{number}")
        tab.until_drawn(number)
    what = "a link to any frame to this frame drawn with its labels"
    return Timing("jump", what, tab.durations(FRAME, known))


def acknowledging(tab: Tab, cells: Sequence[int], clicks: int) -> list[Timing]:
    """Click patches one after the other, five a second."""
    requests = f"{tab.url}/api/actions"
    known, sent = tab.count(ACK), tab.count(requests)
    for number in range(clicks):
        if number % len(cells) == 0:
            tab.page.keyboard.press(_PAINT_KEYS[number // len(cells) % 2])
        tab.click(cells[number % len(cells)])
        tab.page.wait_for_timeout(_BETWEEN_CLICKS_MS)
    tab.wait_for(ACK, known + clicks - 1)
    what = "click on a patch until the page knows that its label is on disk"
    part = "of this, request sent to answer received"
    return [
        Timing("acknowledged", what, tab.durations(ACK, known), ACK_MS),
        Timing("answered", part, tab.durations(requests, sent)),
    ]


def live_update(browser: Any, url: str, names: Sequence[str], changes: int) -> Timing:
    here, there = tabs = [Tab(browser, url), Tab(browser, url)]
    for tab in tabs:
        tab.open(FIRST_FRAME)
    times = [_one_change(here, there, cell, names, cell % 2) for cell in range(changes)]
    for tab in tabs:
        tab.close()
    what = "click in one tab to the label shown in another"
    return Timing("other_tab", what, times, LIVE_MS)


def _one_change(here: Tab, there: Tab, cell: int, names: Sequence[str], which: int) -> float:
    there.page.evaluate(_WATCH, ["left", 1, cell, names[which]])
    known = here.count(ACK)
    here.page.keyboard.press(_LABEL_KEYS[which])
    here.click(cell)
    here.wait_for(ACK, known)
    shown = there.page.evaluate("() => window.toktSeen")
    return float(shown - here.page.evaluate(_LAST_ACT))
