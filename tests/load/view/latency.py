"""A verdict's latency without a live view, with one, and with many clients that look at it."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass
from itertools import chain
from statistics import median
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import cv2
import numpy as np

from tests.load.bundles import content_of
from tests.load.report import Found, Timing, machine_words, table
from tokt.cli.output import progress
from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.features.common.machine import machine
from tokt.features.extractors.extractor import extractor_named
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.outputs.view import LiveView, listening
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.publisher import ReportPublisher
from tokt.inference.report import Event
from tokt.inference.texture.detector import TextureDetector
from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes
from tokt.models.linear import LinearModel

NONE, VIEW, CLIENTS = "no view", "a view", "a view and its clients"
ASKED = 0.05  # part by which the median may grow
_WIDTH, _HEIGHT, _PICTURES = 1360, 1024, 12
_STARTED_S = 60.0
# Beside the loop only because there is no other computer here: it takes what nobody wants.
_CLIENTS = """
import selectors, socket, sys
port, count, stalled = map(int, sys.argv[1:])
asks = b"GET /stream.mjpg HTTP/1.1\\r\\nHost: 127.0.0.1:%d\\r\\n\\r\\n" % port
opened = [socket.create_connection(("127.0.0.1", port)) for _ in range(count)]
read = selectors.DefaultSelector()
for number, each in enumerate(opened):
    each.sendall(asks)
    if number >= stalled:
        read.register(each, selectors.EVENT_READ)
seen = set()
while ready := read.select():
    for key, _ in ready:
        if not key.fileobj.recv(1 << 18):
            read.unregister(key.fileobj)
        seen.add(key.fileobj)
        if len(seen) == count - stalled:
            seen.add(None)
            print("all", flush=True)
"""


@dataclass(frozen=True)
class ViewBenchSize:
    """Extent of the measurement: each round has every condition for so many frames."""

    rounds: int
    frames: int
    rate: float  # frames/s
    clients: int
    stalled: int  # of them: never read


FULL = ViewBenchSize(40, 20, 30.0, 20, 1)
QUICK = ViewBenchSize(2, 4, 30.0, 3, 1)


def run_view_bench(extent: ViewBenchSize) -> Found:
    """Judge frames at a camera's rate, by turns with nobody looking, a view, and its clients.

    Raises ToktError if the view's process does not start.
    """
    latencies: dict[str, list[list[float]]] = {name: [] for name in (NONE, VIEW, CLIENTS)}
    handing: list[float] = []
    told: list[Event] = []
    listener = listening("127.0.0.1", 0)
    port = listener.getsockname()[1]
    view = LiveView(listener, None, None, Limits().stale_s, told.append, None)
    loop = _Loop(extent.rate)
    try:
        _until_drawn(loop, view, port)
        for number in progress(range(extent.rounds), extent.rounds, "round"):
            names = list(latencies)
            for name in names[number % 3 :] + names[: number % 3]:
                with _clients(port, extent, loop, view) if name == CLIENTS else nullcontext():
                    shown = None if name == NONE else view
                    found = [loop.judge(shown) for _ in range(extent.frames)]
                latencies[name].append([latency for latency, _ in found])
                handing += [handed for _, handed in found if name != NONE]
    finally:
        view.close()
    return _found(extent, latencies, handing, [event.words for event in told])


class _Loop:
    def __init__(self, rate: float) -> None:
        rng = np.random.default_rng(7)
        self._pictures = [_picture(rng) for _ in range(_PICTURES)]
        self._policy = SinglePolicy(TextureDetector(_bundle(self._pictures)))
        self._publisher = ReportPublisher([], SYSTEM_CLOCK, Limits(), live=True)
        self._number, self._period_s = 0, 1 / rate
        self._due = time.monotonic()

    def judge(self, view: LiveView | None) -> tuple[float, float]:
        """The next frame's latency, and what handing it over took, in ms."""
        self._due = max(self._due + self._period_s, time.monotonic())
        time.sleep(max(0.0, self._due - time.monotonic()))
        self._number += 1
        picture = self._pictures[self._number % _PICTURES]
        now = SYSTEM_CLOCK.monotonic()
        frame = Frame(self._number, time.time(), picture, None, timed=True, arrived=now)
        self._publisher.begin(frame)
        judgement = self._policy.judge(frame)
        report = self._publisher.publish(frame, judgement)
        before = time.perf_counter()
        if view is not None:
            view.judged(frame, judgement, report)
        assert report.latency_ms is not None
        return report.latency_ms, 1000 * (time.perf_counter() - before)


def _picture(rng: np.random.Generator) -> U8:
    """A frame as large as a mission camera's, smooth but for a rough part."""
    rough = rng.normal(90, 30, (_HEIGHT // 4, _WIDTH // 4, 3))
    noise = cv2.GaussianBlur(rng.normal(90, 60, (_HEIGHT, _WIDTH, 3)), (0, 0), 5)
    noise[: _HEIGHT // 4, : _WIDTH // 4] = rough
    return np.asarray(np.clip(noise, 0, 255), np.uint8)


def _bundle(pictures: list[U8]) -> Any:
    """A model of the usual features; what it says does not matter."""
    extractor, grid = extractor_named("lbp_10_5_frame"), DEFAULT_GRID
    weights = np.zeros((1, extractor.dim))
    weights[0, 10] = -1.0
    model = LinearModel(weights, np.array([0.2]), np.zeros(1), ("ocean", "other"), (False, True))
    content = content_of("bench", extractor, grid, model, pictures[:1])
    return bundle_from_bytes(bundle_bytes(content), "bench")


def _until_drawn(loop: _Loop, view: LiveView, port: int) -> None:
    """Let the process start: none of what it costs is a view's."""
    deadline = time.monotonic() + _STARTED_S
    while time.monotonic() < deadline:
        loop.judge(view)
        with suppress(HTTPError), urlopen(f"http://127.0.0.1:{port}/picture", timeout=_STARTED_S):
            return
    raise ToktError("the view shows no picture")


@contextmanager
def _clients(port: int, extent: ViewBenchSize, loop: _Loop, view: LiveView) -> Iterator[None]:
    """Have all of them look, once they have seen something."""
    command = [sys.executable, "-c", _CLIENTS, *map(str, (port, extent.clients, extent.stalled))]
    lower = None if sys.platform == "win32" else lambda: os.nice(19)
    with subprocess.Popen(command, stdout=subprocess.PIPE, preexec_fn=lower) as process:
        try:
            assert process.stdout is not None
            os.set_blocking(process.stdout.fileno(), False)
            while not process.stdout.read():
                loop.judge(view)
            yield
        finally:
            process.kill()


def _found(extent: ViewBenchSize, latencies, handing, told) -> Found:
    timings = [
        Timing(name, "from a frame to its verdict", [*chain(*rounds)], None)
        for name, rounds in latencies.items()
    ]
    timings.append(Timing("handing over", "the loop's own time for the view", handing, 0.5, 50))
    medians = {name: [median(times) for times in rounds] for name, rounds in latencies.items()}
    growth = {
        name: sorted(a / b - 1 for a, b in zip(medians[name], medians[NONE], strict=True))
        for name in (VIEW, CLIENTS)
    }
    grown = {name: {"median": median(all_), "all": all_} for name, all_ in growth.items()}
    holds = all(each["median"] <= ASKED for each in grown.values()) and not told
    rows = [
        (each.name, str(len(each.times_ms)), *(f"{each.at(p):.3f}" for p in (25, 50, 75, 95, 100)))
        for each in timings
    ]
    headings = ("", "n", "p25 ms", "median ms", "p75 ms", "p95 ms", "worst ms")
    lines = [
        f"{name}: median {100 * median(all_):+.1f} % over no view "
        f"(rounds {100 * all_[0]:+.1f} to {100 * all_[-1]:+.1f} %), {100 * ASKED:.0f} % allowed"
        for name, all_ in growth.items()
    ]
    about = {"machine": machine(), "extent": asdict(extent)}
    figures = {**about, "times": [each.to_json() for each in timings], "growth": grown}
    figures |= {"holds": holds, "told": told}
    fault = "" if holds else "a verdict's latency grew by more than asked, or the view failed"
    report = [table(headings, rows), *lines, machine_words(about), *told]
    return Found("view", figures, report, fault=fault)
