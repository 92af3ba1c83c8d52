"""Cameras in processes of their own: real ones with the simulated camera of the genicam package,
and small programs in their place for what no real one does on request."""

import io
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.calls import refuses
from tests.waiting import MAX_S, until
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig
from tokt.inference.reason import NO_FAULT
from tokt.inference.report import Event
from tokt.inference.sources.cameras import process_driver
from tokt.inference.sources.cameras.capture import LEFT, Capture, Deliver
from tokt.inference.sources.cameras.genicam import driver as genicam_driver
from tokt.inference.sources.cameras.genicam import producers as genicam_producers
from tokt.inference.sources.cameras.genicam.driver import open_drivers
from tokt.inference.sources.cameras.genicam.producers import (
    ListedCamera,
    Listing,
    Place,
    list_cameras,
)
from tokt.inference.sources.cameras.live_source import CameraSource
from tokt.inference.sources.cameras.messages import read_message, write_frame, write_message
from tokt.inference.sources.cameras.process_driver import ProcessDriver

genicam = pytest.importorskip("genicam")
pytest.importorskip("harvesters")

READY = {"kind": "ready", "place": {"producer": "p", "interface": "i", "device": "d"}}
READY |= {"period_s": None, "shared_clock": True}
FRAME = {"kind": "frame", "frame_id": 1, "taken_s": 2.5, "fetched_s": 0.0, "shared_clock": True}
FRAME |= {"reason": "ok", "words": "", "height": 4, "width": 5, "pixel_format": "Mono8"}


@pytest.fixture(autouse=True)
def viky(monkeypatch):
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(Path(genicam.__file__).parent))


@pytest.fixture
def open_camera(made_drivers):
    def make(name: str = "0") -> ProcessDriver:
        order = {"name": name, "place": None, "share": 1.0}
        order["options"] = asdict(SourceConfig(camera_rate=100))
        made_drivers.append(ProcessDriver("cameras.genicam", LEFT, name, order, SYSTEM_CLOCK))
        return made_drivers[-1]

    return make


@pytest.fixture
def instead(monkeypatch):
    """Run a program in the place of a camera's process. It may `say(header, data)`."""
    head = (
        "import json, os, sys, time\n"
        "def say(header, data=None):\n"
        "    header = header if data is None else {**header, 'bytes': len(data)}\n"
        "    sys.stdout.buffer.write(json.dumps(header).encode() + b'\\n' + (data or b''))\n"
        "    sys.stdout.buffer.flush()\n"
        f"ready, frame = {json.loads(json.dumps(READY))!r}, {FRAME!r}\n".replace("true", "True")
    )

    def use(program: str) -> None:
        command = [sys.executable, "-I", "-S", "-c", head + program]
        monkeypatch.setattr(process_driver, "program", lambda kind: command)
        monkeypatch.setattr(genicam_producers, "program", lambda kind: command)

    return use


class Stamped:
    """A driver whose captures bear their arrival as their time: viky has no clock."""

    def __init__(self, driver: ProcessDriver) -> None:
        self.driver = driver

    def __getattr__(self, name: str) -> Any:
        return getattr(self.driver, name)

    def start(self, deliver: Deliver) -> None:
        def stamped(capture: Capture) -> None:
            assert math.isnan(capture.taken_s)
            deliver(replace(capture, taken_s=capture.arrived))

        self.driver.start(stamped)


def test_two_cameras_as_a_source_of_pairs():
    options = SourceConfig(camera_rate=50)
    drivers = open_drivers(["VikyTL_DEV_red", "1"], options, SYSTEM_CLOCK)
    assert [driver.name for driver in drivers] == ["VikyTL_DEV_red", "1"]
    told: list[Event] = []
    source = CameraSource([Stamped(driver) for driver in drivers], SYSTEM_CLOCK, told.append)
    pairs = []
    for frame in source:
        if frame.left is not None and frame.right is not None:
            pairs.append(frame)
        if len(pairs) == 3:
            source.stop()
    assert [frame.left_fault or frame.right_fault for frame in pairs] == [NO_FAULT] * 3
    assert {frame.left.shape for frame in pairs} == {(400, 400)}
    assert {frame.right.shape for frame in pairs} == {(400, 400)}
    assert drivers[0].period_s == pytest.approx(0.02)
    assert told == []
    assert not [thread for thread in threading.enumerate() if "tokt camera" in thread.name]


def test_one_camera_from_start_to_stop_and_again(open_camera):
    driver = open_camera("VikyTL_DEV_blue")
    captures: list[Capture] = []
    slow = threading.Event()

    def deliver(capture: Capture) -> None:
        captures.append(capture)
        if len(captures) == 3:
            raise RuntimeError("not this one")
        if len(captures) == 5:
            slow.wait(MAX_S)

    driver.start(deliver)
    until(lambda: len(captures) == 5)
    time.sleep(0.3)  # 30 frames at the camera's rate
    slow.set()
    resumed = SYSTEM_CLOCK.monotonic()
    until(lambda: len(captures) >= 30)
    assert driver.failures == 1
    assert {capture.fault for capture in captures} == {NO_FAULT}
    first_pictures = [capture.picture.copy() for capture in captures[:2]]
    numbers = [capture.frame_id for capture in captures]
    assert numbers == sorted(set(numbers))
    # What was in the pipe came, as old as it is; then the newest; and the rest never.
    assert numbers[29] > 30
    old = [capture for capture in captures if capture.arrived < resumed]
    assert len(old) <= 5 + 3

    os.kill(driver._process.pid, signal.SIGKILL)
    until(driver.lost)
    assert "its process ended with -9" in driver.lost()
    driver.stop()
    driver.stop()

    del captures[5:]
    driver.start(captures.append)
    assert driver.lost() == ""
    until(lambda: len(captures) > 7)
    driver.stop()
    count = len(captures)
    assert captures[5].frame_id < 5 and driver.lost() == ""
    time.sleep(0.05)
    assert len(captures) == count
    for one, other in zip(first_pictures, captures[:2], strict=True):
        assert (one == other.picture).all()


@pytest.fixture
def listed(monkeypatch):
    """Two cameras, without asking the producers again."""
    cameras = tuple(ListedCamera(Place("p", "i", device)) for device in ("red", "green"))
    listing = Listing(("viky.cti",), cameras, ())
    monkeypatch.setattr(genicam_driver, "list_cameras", lambda: listing)


@pytest.mark.parametrize(
    ("ids", "wait", "words"),
    [
        (["nope"], False, r"no GenICam camera 'nope': found 0: red"),
        (["0", "red"], False, "are the same camera"),
        (["nope", "nope"], True, "are the same camera"),
        (["2"], True, "no GenICam camera '2'"),  # a number is not waited for
    ],
)
def test_what_cannot_be_meant(ids, wait, words, listed):
    refuses(words, open_drivers, ids, SourceConfig(wait=wait), SYSTEM_CLOCK)


def test_a_camera_that_is_waited_for(listed):
    drivers = open_drivers(["not here yet", "1"], SourceConfig(wait=True), SYSTEM_CLOCK)
    assert [driver.name for driver in drivers] == ["not here yet", "1"]


def test_nothing_to_drive_cameras_with(monkeypatch):
    monkeypatch.setattr(genicam_producers, "find_spec", lambda name: None)
    asked = (["0"], SourceConfig(), SYSTEM_CLOCK)
    refuses("needs harvesters: install the extra 'genicam'", open_drivers, *asked)
    monkeypatch.undo()
    monkeypatch.delenv("GENICAM_GENTL64_PATH", raising=False)
    refuses("no GenTL producer: install the camera vendor's", open_drivers, *asked)


def test_producers_that_crash_or_hang(instead):
    instead("os.abort()")
    refuses("producers end the process with -6", list_cameras)
    instead("time.sleep(60)")
    refuses(r"do not answer in 0\.2 s", list_cameras, timeout_s=0.2)


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("os.abort()", "camera 0: its process ended with -6"),
        ("time.sleep(60)", r"camera 0 does not answer in 0\.3 s"),
        ("say({'kind': 'refused', 'words': 'it is taken'})", "it is taken"),
        ("print('nonsense')", "does not make sense"),
    ],
)
def test_cameras_that_do_not_open(program, words, open_camera, instead, monkeypatch):
    monkeypatch.setattr(process_driver, "_CLOSE_S", 0.1)
    instead(program)
    monkeypatch.setattr(process_driver, "_OPEN_S", 0.3 if "sleep" in program else MAX_S)
    driver = open_camera()
    refuses(words, driver.start, lambda capture: None)
    assert driver._process is None


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("say({'kind': 'lost', 'words': 'no such handle'})", "no such handle"),
        ("os.abort()", "its process ended with -6"),
        ('os.write(1, b\'{"kind": "frame", "bytes": 9}\\n123\')', "its process ended with 0"),
        ("say({'kind': 'frame'})", "does not make sense"),
    ],
)
def test_cameras_that_are_lost(program, words, open_camera, instead):
    instead("say(ready)\nsay(frame, bytes(20))\n" + program)
    captures: list[Capture] = []
    driver = open_camera()
    driver.start(captures.append)
    until(driver.lost)
    assert words in driver.lost() and driver.shared_clock
    assert [capture.taken_s for capture in captures] == [2.5]
    # Its camera's process had it at 0 s: it is as old as this machine's clock.
    assert captures[0].arrived == pytest.approx(0.0, abs=60)


def test_a_process_without_a_runtime_ends_though_it_hangs():
    """In native code that holds Python's lock: nobody is left to end it."""
    program = (
        "import contextlib, ctypes, types\n"
        "from tokt.inference.sources.cameras.genicam import process\n"
        "place = types.SimpleNamespace(place=types.SimpleNamespace())\n"
        "camera = types.SimpleNamespace(period_s=None, shared_clock=False)\n"
        "process.opened_producers = lambda: contextlib.nullcontext(place)\n"
        "place.listing = types.SimpleNamespace(camera=lambda name: place)\n"
        "process.opened_camera = lambda *any: contextlib.nullcontext(camera)\n"
        "process._send_next = lambda *any: ctypes.PyDLL(None).sleep(60)\n"
        "process._HUNG_S = 0.2\n"
        "process.main()\n"
    )
    order = {"name": "0", "place": None, "options": {}, "share": 1.0}
    command = [sys.executable, "-P", "-c", program]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as hung:
        write_message(hung.stdin, order)
        assert read_message(hung.stdout)[0]["kind"] == "ready"
        assert hung.wait(MAX_S) == -signal.SIGALRM


def test_a_picture_without_pixels_is_a_picture():
    """Which what decodes it finds fault with: without one there would be none."""
    pipe = io.BytesIO()
    write_frame(pipe, 1, 2.0, NO_FAULT, (0, 640, "Mono8", np.empty(0, np.uint8)))
    pipe.seek(0)
    header, data = read_message(io.BufferedReader(pipe))
    assert (header["height"], header["width"], data) == (0, 640, b"")


def test_a_process_that_cannot_be_started_is_a_camera_that_cannot(open_camera, monkeypatch):
    monkeypatch.setattr(process_driver, "program", lambda kind: ["/no/such/program"])
    words = "camera 0: no process for it: .*/no/such/program"
    refuses(words, open_camera().start, lambda capture: None)
