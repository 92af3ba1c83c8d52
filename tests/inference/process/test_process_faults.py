"""Faults of the process itself, with the real command under its watchdog.

The rows of docs/faults.md that this comes to are held against it as in test_faults.py.
"""

import os
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

from tests.models.parts import golden_of
from tests.waiting import MAX_S, until
from tokt.inference.outputs.udp import decode
from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes, read_bundle
from tokt.models.store.store import Store

from ..conftest import draw
from ..test_faults import hold_row

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")


class Ship:
    """`tokt run --watchdog` on a store and a dive, and LabVIEW's end of the wire."""

    def __init__(self, folder: Path, bundle: Path, receiver: socket.socket) -> None:
        self.store = Store(folder / "store")
        self.first = read_bundle(bundle)
        self.store.deploy(self.first)
        self.said: list[dict[str, Any]] = []
        self._receiver = receiver
        self._errors = (folder / "err").open("w+")
        command = ["run", "--watchdog", "--store", self.store.path, "--source", folder / "dive"]
        more = ["--rate", "20", "--format", "v2", "--policy", "texture"]
        address = f"127.0.0.1:{receiver.getsockname()[1]}"
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tokt", *map(str, command), *more, "--udp", address],
            stderr=self._errors,
        )

    def next(self) -> dict[str, Any]:
        """The next datagram."""
        self.said.append(decode(self._receiver.recv(65535)))
        return self.said[-1]

    def until(self, true: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The next datagram of which something is true."""
        return until(lambda: one if true(one := self.next()) else None, self.words)

    def runtime(self) -> psutil.Process:
        """The process that judges."""
        return psutil.Process(self.process.pid).children()[0]

    def killed(self, number: int = signal.SIGKILL) -> dict[str, Any]:
        """Send the runtime a signal; what is said first by the next one, seq 1."""
        os.kill(self.runtime().pid, number)
        return self.until(lambda one: one["seq"] == 1)

    def words(self) -> str:
        self._errors.seek(0)
        return self._errors.read()

    def close(self) -> None:
        self.process.terminate()
        self.process.wait(MAX_S)
        self._errors.close()


@pytest.fixture
def ship(tmp_path, bundle_file, receiver):
    (tmp_path / "dive").mkdir()
    for number in range(1, 401):
        picture = draw([(4, 4)] if number % 20 < 5 else [(1, 1)], number)
        cv2.imwrite(str(tmp_path / "dive" / f"t_{number}.png"), picture)
    receiver.settimeout(MAX_S)
    opened = Ship(tmp_path, bundle_file, receiver)
    yield opened
    opened.close()


def test_a_run_at_sea(ship):
    assert ship.until(lambda one: one["status"] == 1)["model"] == "noise/7"

    again = ship.killed()
    assert again["status"] == 1 and again["model"] == "noise/7"
    hold_row("SIGKILL at any moment", "back with the same model", "restarts +1")

    bundle_path = ship.store.bundle_file(ship.first.sha256)
    whole = bundle_path.read_bytes()
    bundle_path.write_bytes(whole[:-100])
    while not ship.store.last_good_file.exists():  # it has judged ten frames
        assert ship.next()["health"] == "ok"
    hold_row("the bundle is damaged on disk while it runs", "as without it", "nothing")

    again = ship.killed()
    assert again["model"] == "noise/7" and "is refused" in again["health"]
    words = "back with the last good copy; health says that the active one is refused"
    hold_row("the bundle is damaged on disk, then SIGKILL", words, "restarts +1")

    frame = np.kron(draw([(4, 5)]), np.ones((2, 2), np.uint8))
    values = ship.first.decision_values(frame)
    golden = golden_of([frame], [values], [ship.first.model.obstacle_patches(values)])
    other = replace(ship.first.content, version="of another camera", golden=golden)
    ship.store.deploy(bundle_from_bytes(bundle_bytes(other), "other"))
    while "it cannot judge the newest frame: frames are 360x271" not in ship.words():
        assert ship.next()["model"] == "noise/7"

    second = bundle_from_bytes(bundle_bytes(replace(ship.first.content, version="8")), "8")
    entry = ship.store.deploy(second)
    assert ship.until(lambda one: one["model"] == "noise/8")["health"] == "ok"
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
        assert one["model"] in ("noise/8", "noise/9"), one
        if one["model"] == "noise/9":
            pytest.skip("the new model was checked before the test could damage it")
    assert ship.next()["model"] == "noise/8" and entry.version == "8"
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
    ship.process.terminate()
    assert ship.process.wait(MAX_S) == 0 and not runtime.is_running()
    hold_row("SIGTERM, Ctrl-C", "the frame is judged and sent, then it ends with code 0", "nothing")
    assert not [one for one in ship.said if one["status"] == 0]
