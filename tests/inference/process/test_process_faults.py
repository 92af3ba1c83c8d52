"""Faults of the process itself, with the real command under its watchdog.

The rows of docs/reference/faults.md that this comes to are held against it as in test_faults.py.
"""

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
import pytest

from tests.calls import succeeds
from tests.inference.logged_runs import lines
from tests.models.parts import golden_of
from tests.waiting import MAX_S, until
from tokt.inference.outputs.udp import decode
from tokt.inference.recording.run_log import events_path
from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes, read_bundle
from tokt.models.operating_point import OperatingPoint
from tokt.models.store.store import Store
from tokt.models.water import WaterPrior

from ..conftest import draw
from ..test_faults import hold_row

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")


def is_alive(process: psutil.Process) -> bool:
    """Whether it runs: one that nobody has waited for yet has ended as well."""
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:  # it ended between the two questions
        return False


class Ship:
    """`tokt run --watchdog` on a store and a dive, and LabVIEW's end of the wire."""

    def __init__(
        self, store: Store, dive: Path, receiver: socket.socket, *options: Any, **process: Any
    ) -> None:
        self.store, self.first = store, store.active()
        self.said: list[dict[str, Any]] = []
        self._receiver = receiver
        self._errors = (store.path.parent / "err").open("w+")
        command = ["run", "--watchdog", "--store", self.store.path, "--source", dive]
        more = ["--rate", "20", "--format", "v2", "--policy", "texture", *map(str, options)]
        address = f"127.0.0.1:{receiver.getsockname()[1]}"
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tokt", *map(str, command), *more, "--udp", address],
            **{"stderr": self._errors, **process},
        )

    def next(self) -> dict[str, Any]:
        self.said.append(decode(self._receiver.recv(65535)))
        return self.said[-1]

    def until(self, true: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The next datagram of which something is true."""
        return until(lambda: one if true(one := self.next()) else None, self.words)

    def runtime(self) -> psutil.Process:
        """The process that judges."""
        return psutil.Process(self.process.pid).children()[0]

    def killed(self, number: int = signal.SIGKILL) -> dict[str, Any]:
        """Send the runtime a signal; the first verdict of the next one, whose seq 1 came."""
        runtime = self.runtime()
        runtime.send_signal(number)
        until(lambda: not is_alive(runtime), self.words)
        first = self.until(lambda one: one["seq"] == 1)
        # On a busy machine a heartbeat may come before it.
        return first if first["model"] else self.until(lambda one: one["model"])

    def words(self) -> str:
        self._errors.seek(0)
        return self._errors.read()

    def ends(self) -> None:
        """Ask it to end, which it does well."""
        self.process.terminate()
        assert self.process.wait(MAX_S) == 0

    def close(self) -> None:
        self.process.terminate()
        self.process.wait(MAX_S)
        self._errors.close()


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    """20 s of clear water with an obstacle each second."""
    folder = tmp_path_factory.mktemp("dive")
    for number in range(1, 401):
        picture = draw([(4, 4)] if number % 20 < 5 else [(1, 1)], number)
        cv2.imwrite(str(folder / f"t_{number}.png"), picture)
    return folder


@pytest.fixture
def launch(tmp_path, dive, bundle_file, receiver):
    """Start a ship, its process as a test wants it."""
    store, ships = Store(tmp_path / "store"), []
    store.deploy(read_bundle(bundle_file))

    def start(*options: Any, **process: Any) -> Ship:
        ships.append(Ship(store, dive, receiver, *options, **process))
        return ships[-1]

    yield start
    for ship in ships:
        ship.close()


@pytest.fixture
def ship(launch):
    return launch()


@pytest.fixture
def terminal():
    """A terminal: the end that a person types at, and the other one."""
    ends = os.openpty()
    yield ends
    for end in ends:
        with contextlib.suppress(OSError):  # a test has closed it
            os.close(end)


def test_a_run_at_sea(ship):
    assert ship.until(lambda one: one["status"] == 1)["model"] == "noise/7"

    again = ship.killed()
    assert again["status"] == 1 and again["model"] == "noise/7"
    hold_row("SIGKILL at any moment", "back with the same model", "restarts +1")

    bundle_path = ship.store.bundle_file(ship.first.sha256)
    whole = bundle_path.read_bytes()
    bundle_path.write_bytes(whole[:-100])
    while not ship.store.last_good_file.exists():  # it has judged ten frames
        one = ship.next()
        assert one["model"] in ("noise/7", None) and "refused" not in one["health"], one
    hold_row("the bundle is damaged on disk while it runs", "as without it", "nothing")

    again = ship.killed()
    assert again["model"] == "noise/7" and "is refused" in again["health"]
    words = "back with the last good copy; health says that the active one is refused"
    hold_row("the bundle is damaged on disk, then SIGKILL", words, "restarts +1")

    # Those before are of 360x271; this one is made for a camera whose pictures are turned.
    frame = np.ascontiguousarray(np.rot90(draw([(4, 5)])))
    values = ship.first.decision_values(frame)
    golden = golden_of([frame], [values], [ship.first.model.obstacle_patches(values)])
    other = replace(ship.first.content, version="turned", golden=golden, frame_sizes=())
    ship.store.deploy(bundle_from_bytes(bundle_bytes(other), "other"))
    while "it cannot judge the newest frame: frames are 360x271" not in ship.words():
        assert ship.next()["model"] in ("noise/7", None)

    second = bundle_from_bytes(bundle_bytes(replace(ship.first.content, version="8")), "8")
    entry = ship.store.deploy(second)
    assert "refused" not in ship.until(lambda one: one["model"] == "noise/8")["health"]
    hold_row(
        "a new model becomes active while it runs",
        "the new model from the next frame on",
        "switches +1",
    )

    third = bundle_from_bytes(bundle_bytes(replace(ship.first.content, version="9")), "9")
    ship.store.deploy(third)
    ship.store.bundle_file(third.sha256).write_bytes(b"\0" * 4000)
    while "noise/9 is refused" not in ship.words():
        one = ship.next()
        assert one["model"] in ("noise/8", "noise/9", None), one
        if one["model"] == "noise/9":
            pytest.skip("the new model was checked before the test could damage it")
    assert ship.until(lambda one: one["model"])["model"] == "noise/8" and entry.version == "8"
    hold_row(
        "a new model that does not pass its checks",
        "as without it: the old one goes on",
        "refusals +1",
    )

    ship.store.rollback(reason="9 is damaged")
    again = ship.killed(signal.SIGSTOP)
    assert again["model"] == "noise/8" and "does not answer and was killed" in ship.words()
    hold_row(
        "the runtime hangs altogether",
        "killed after 2 s without a sign of life, and back",
        "restarts +1",
    )

    runtime = ship.runtime()
    ship.ends()
    assert not runtime.is_running()
    hold_row("SIGTERM, Ctrl-C", "the frame is judged and sent, then it ends with code 0", "nothing")
    assert not [one for one in ship.said if one["status"] == 0]


def test_the_boundary_stays_fixed_when_the_model_is_exchanged(launch, tmp_path):
    log = tmp_path / "log.jsonl"
    ship = launch("--fixed-boundary", "--log", log, "--log-values")
    assert ship.until(lambda one: one["model"])["model"] == "noise/7"
    prior = WaterPrior(-0.3, 0.1, 0.08, 0.08, 0.1, limit=0.02)
    moving = replace(ship.first.content, version="8", operating_point=OperatingPoint(water=prior))
    entry = ship.store.deploy(bundle_from_bytes(bundle_bytes(moving), "8"))
    ship.until(lambda one: one["model"] == "noise/8" and one["status"] == 1)
    ship.ends()
    assert {line["boundary"] for line in lines(log)} == {None}
    (exchanged,) = [event for event in lines(events_path(log)) if event["event"] == "model"]
    assert exchanged["sha256"] == entry.sha256
    succeeds("replay", log, "--json")


def fill(descriptor: int) -> None:
    """Write until nothing more goes in."""
    os.set_blocking(descriptor, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(descriptor, b"x" * 4096)
    os.set_blocking(descriptor, True)


def test_a_terminal_that_is_held(launch, terminal):
    shown, written = terminal
    ship = launch(stderr=written)
    ship.until(lambda one: one["status"] == 1)
    os.write(shown, b"\x13")  # Ctrl-S
    assert ship.killed()["model"] == "noise/7"
    hold_row(
        "the terminal is held (Ctrl-S), then SIGKILL", "back with the same model", "restarts +1"
    )
    ship.ends()


def test_standard_error_that_nobody_reads(launch):
    read, write = os.pipe()
    fill(write)
    ship = launch(stderr=write)
    assert ship.until(lambda one: one["status"] == 1)["model"] == "noise/7"
    hold_row(
        "standard error takes nothing (a stuck `tee`) from the start", "as without it", "nothing"
    )
    assert ship.killed()["model"] == "noise/7"
    ship.ends()
    os.close(read)
    os.close(write)


def test_a_terminal_that_is_closed(launch, terminal):
    shown, written = terminal
    ship = launch(preexec_fn=lambda: os.login_tty(written), stderr=None)
    os.close(written)
    seq = ship.until(lambda one: one["status"] == 1)["seq"]
    os.close(shown)
    for number in (signal.SIGHUP, signal.SIGTTOU):
        ship.process.send_signal(number)
        ship.runtime().send_signal(number)
    assert [ship.next()["seq"] for _ in range(20)] == list(range(seq + 1, seq + 21))
    hold_row("the terminal is closed (SIGHUP)", "as without it", "nothing")
    assert ship.killed()["model"] == "noise/7"
    ship.ends()


def test_standard_files_that_are_closed_from_the_start(launch):
    ship = launch(preexec_fn=lambda: os.closerange(0, 3), stderr=None)
    assert ship.until(lambda one: one["status"] == 1)["model"] == "noise/7"
    for process in (ship.process, ship.runtime()):
        # Otherwise the first socket is there, and C libraries warn its receiver.
        assert str(Path(f"/proc/{process.pid}/fd/2").readlink()).startswith("pipe:")
    hold_row("standard error is closed from the start", "as without it", "nothing")
    assert ship.killed()["model"] == "noise/7"


def test_logs_on_a_disk_that_hangs_from_the_start(launch, bundle_file, tmp_path):
    for name in ("log.jsonl", "shadow.jsonl"):
        os.mkfifo(tmp_path / name)
    shadow = "--shadow", bundle_file, "--shadow-log", tmp_path / "shadow.jsonl"
    ship = launch("--log", tmp_path / "log.jsonl", *shadow, start_new_session=True)
    ship.until(lambda one: one["seq"] == 40)
    assert ship.said[-1]["model"] == "noise/7"
    hold_row("the log's disk hangs from the start", "as without it", "log failures")
    hold_row("the challenger's log: its disk hangs from the start", "as without it", "nothing")
    # Ctrl-C: the runtime is ending already when its watchdog asks it to.
    os.killpg(ship.process.pid, signal.SIGINT)
    assert ship.process.wait(MAX_S) == 0
    assert re.search(r"\d\d log lines could not be written", ship.words())


SUSPENDED = """
import os, time
real, woken = time.clock_gettime, {woken!r}
later = lambda clock: 5.0 if clock == time.CLOCK_BOOTTIME and os.path.exists(woken) else 0.0
time.clock_gettime = lambda clock: real(clock) + later(clock)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells of a suspend")
def test_a_suspend_of_the_whole_process(launch, tmp_path):
    """The clock that goes on meanwhile is 5 s ahead all at once, for the watchdog as well."""
    woken, path = tmp_path / "woken", os.pathsep.join([str(tmp_path), *sys.path])
    (tmp_path / "sitecustomize.py").write_text(SUSPENDED.format(woken=str(woken)))
    ship = launch(env={**os.environ, "PYTHONPATH": path})
    ship.until(lambda one: one["status"] == 1)
    runtime, before = ship.runtime(), ship.next()["seq"]
    woken.touch()
    first = ship.until(lambda one: "suspended" in one["health"])
    assert (first["status"], first["reason"]) == (-1, "stale")
    back = ship.until(lambda one: one["seq"] > first["seq"] and one["reason"] == "ok")
    assert runtime == ship.runtime() and back["seq"] > before
    hold_row("the computer is suspended for 5 s", "unknown `stale`", "frames by reason: stale")


STEPPED = """
import time
real = time.time
def stepped():
    try:
        return real() + float(open({by!r}).read())
    except (OSError, ValueError):
        return real()
time.time = stepped
"""


def test_a_time_of_day_that_is_set_back_and_forth(launch, tmp_path):
    by, path = tmp_path / "by", os.pathsep.join([str(tmp_path), *sys.path])
    (tmp_path / "sitecustomize.py").write_text(STEPPED.format(by=str(by)))
    log, notify = tmp_path / "log.jsonl", str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(notify)
        systemd.settimeout(MAX_S)
        ship = launch("--log", log, env={**os.environ, "PYTHONPATH": path, "NOTIFY_SOCKET": notify})
        ship.until(lambda one: one["status"] == 1)
        runtime = ship.runtime()
        for steps, by_s in enumerate((3600, -86_400, 0), 1):
            by.write_text(str(by_s))
            while ship.words().count("the time of day was set") < steps:
                ship.next()
            ship.until(lambda one: one["status"] == 1)
            heard = systemd.recv(100)
            while heard != b"WATCHDOG=1":
                heard = systemd.recv(100)
        assert ship.runtime() == runtime
        ship.ends()
    assert all(one["age_ms"] < 1000 for one in ship.said if one["model"])
    seqs = [line["seq"] for line in lines(log)]
    assert seqs == sorted(seqs)
    hold_row(
        "the time of day is set back and forth, under the watchdog and systemd's",
        "as without it; signs of life go on",
        "events `clock_set`",
    )


def test_a_signal_to_the_runtime_alone(ship):
    ship.until(lambda one: one["status"] == 1)
    for number in (signal.SIGTERM, signal.SIGINT):
        assert ship.killed(number)["model"] == "noise/7"
    assert ship.words().count("the runtime ended with exit code 0; started again") == 2
    fault = "SIGTERM to the runtime and not to its watchdog (earlyoom)"
    hold_row(fault, "back with the same model", "restarts +1")
