"""All that is around a soaked run: its places on the disk, its ports, its neighbours and models."""

import mmap
import os
import random
import re
import shutil
import socket
import struct
import sys
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from http.client import HTTPConnection, HTTPException
from pathlib import Path

import psutil
from prometheus_client.parser import text_string_to_metric_families

from tests.calls import free_port
from tokt.inference.links.autopilot import mavlink_dialect
from tokt.inference.recording.run_log import events_path
from tokt.models.bundle.bundle import Bundle
from tokt.models.store.store import Store

from .feed import Feeder, receiver
from .plan import SEED, SoakSize
from .synthetic_frames import Models

_SCRAPE_S = 5.0
_AROUND_S = 0.02
"""Recorded around a detection: so many frames at a soak's pace as at a camera's in two seconds."""
_BEAT_S = 0.5  # between two times that the autopilot speaks
_STARTED_AGAIN = "started again ("

SITE = """
import mmap, os, socket, struct, time
with open({offset!r}, "rb") as file:
    offset = mmap.mmap(file.fileno(), 8, access=mmap.ACCESS_READ)
real_time, real_getaddrinfo = time.time, socket.getaddrinfo
time.time = lambda: real_time() + struct.unpack("d", offset)[0]
def getaddrinfo(host, *more, **options):
    if host in ("pilot.example", b"pilot.example"):
        if not os.path.exists({known!r}):
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        host = "127.0.0.1"
    return real_getaddrinfo(host, *more, **options)
socket.getaddrinfo = getaddrinfo
"""
"""Module that each Python of the run imports first: a time of day that can be set, a name that can
be forgotten."""


class Autopilot:
    """The vehicle's end of a MAVLink link (``udpin``), which speaks while it is not `silent`."""

    def __init__(self, port: int) -> None:
        self.silent = False
        self._port = port
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._speak, daemon=True)
        self._thread.start()

    def packed(self, system: int = 1, lat: int = 634_467_000) -> bytes:
        """Return a heartbeat and a place, of a component of a system."""
        words = mavlink_dialect()
        mavlink = words.MAVLink(None, system, 1)
        beat = mavlink.heartbeat_encode(12, 3, 0, 0, 4)
        place = mavlink.global_position_int_encode(5, lat, 104_200_000, 0, -31_420, 0, 0, 0, 27_150)
        return bytes(beat.pack(mavlink)) + bytes(place.pack(mavlink))

    def say(self, data: bytes, opened: socket.socket) -> None:
        """Send something to the link from some socket."""
        opened.sendto(data, ("127.0.0.1", self._port))

    def _speak(self) -> None:
        with receiver() as opened:
            while not self._ended.wait(_BEAT_S):
                if not self.silent:
                    self.say(self.packed(), opened)

    def close(self) -> None:
        self._ended.set()
        self._thread.join()


class Ship:
    """A run under its watchdog, and what is around it.

    What a fault changes is undone by `mending`, a stack that is closed. `process` is the watchdog.
    """

    process: psutil.Process

    def __init__(self, folder: Path, size: SoakSize, models: Models, feeder: Feeder) -> None:
        self.folder, self.feeder, self.models = folder, feeder, models
        self.random = random.Random(SEED)
        self.mending = ExitStack()
        self.store = Store(folder / "store")
        self.log, self.record = folder / "log" / "run.jsonl", folder / "record"
        self.events, self.config = events_path(self.log), folder / "soak.toml"
        self.known, self.stderr = folder / "known", folder / "stderr"
        for new in (self.log.parent, folder / "site"):
            new.mkdir(parents=True)
        self.known.touch()
        self.config.write_text(f"[recording]\nlog-keep = {size.log_keep}\n")
        for model in models.good[::-1]:
            self.store.deploy(model)
        offset = folder / "offset"
        offset.write_bytes(bytes(8))
        with offset.open("r+b") as file:
            self._offset = mmap.mmap(file.fileno(), 8)
        site = SITE.format(offset=str(offset), known=str(self.known))
        (folder / "site" / "sitecustomize.py").write_text(site)
        self.ports = {"metrics": free_port(), "view": free_port()}
        with receiver() as free:
            self.ports["mavlink"] = free.getsockname()[1]
        self.autopilot = Autopilot(self.ports["mavlink"])
        self.pilot, self.spare = receiver(), receiver()
        self._size = size

    def close(self) -> None:
        self.mending.close()
        self.autopilot.close()
        for opened in (self.pilot, self.spare, self._offset):
            opened.close()

    @property
    def options(self) -> list[object]:
        """Those of `tokt run`, besides where frames come from and what is heard of them."""
        size, pilot, spare = self._size, self.pilot.getsockname(), self.spare.getsockname()
        return [
            *("--watchdog", "--config", self.config, "--store", self.store.path),
            *("--metrics", self.ports["metrics"], "--view", self.ports["view"]),
            *("--mavlink", f"udpin:127.0.0.1:{self.ports['mavlink']}", "--camera-fov-deg", "60"),
            *("--udp", f"v2@pilot.example:{pilot[1]}", "--udp", f"v2@127.0.0.1:{spare[1]}"),
            *("--log", self.log, "--log-max-mb", size.log_mb),
            *("--record", self.record, "--record-mb", size.record_mb),
            *("--record-before", _AROUND_S, "--record-after", _AROUND_S),
        ]

    @property
    def env(self) -> dict[str, str]:
        """The environment of its processes."""
        path = os.pathsep.join([str(self.folder / "site"), *filter(None, sys.path)])
        return {**os.environ, "PYTHONPATH": path}

    def runtime(self) -> psutil.Process:
        """Return the process that judges; psutil.NoSuchProcess while there is none."""
        children = self.process.children()
        if not children:
            raise psutil.NoSuchProcess(self.process.pid, msg="no runtime")
        return children[0]

    def view_process(self) -> psutil.Process:
        """Return the process of the live view; psutil.NoSuchProcess while there is none."""
        for child in self.runtime().children():
            if any("spawn_main" in word for word in child.cmdline()):
                return child
        raise psutil.NoSuchProcess(self.process.pid, msg="no view")

    def words(self, since: int = 0) -> str:
        """Return what it has written to standard error, from a byte on."""
        with self.stderr.open("rb") as file:
            file.seek(since)
            return file.read().decode("utf-8", "replace")

    def life_begins(self) -> int:
        """Return the byte of standard error at which the newest runtime began."""
        return len(self.words().rpartition(_STARTED_AGAIN)[0].encode())

    def restarts(self) -> int:
        """Count the times that the watchdog has started it again."""
        return self.words().count(_STARTED_AGAIN)

    def metrics(self) -> Counter[str] | None:
        """Return its metrics, summed over labels, and events by name; None if none are served."""
        address = f"http://127.0.0.1:{self.ports['metrics']}/metrics"
        try:
            with urllib.request.urlopen(address, timeout=_SCRAPE_S) as answer:
                text = answer.read().decode()
        except (OSError, HTTPException):
            return None
        values: Counter[str] = Counter()
        for family in text_string_to_metric_families(text):
            for sample in family.samples:
                values[sample.name] += sample.value
                if "event" in sample.labels and sample.name.endswith("_total"):
                    values[f"event {sample.labels['event']}"] += sample.value
        return values

    def answer(self, name: str, path: str, host: str = "") -> int:
        """Return the status that the server of a port answers with; 0 where it does not."""
        port = self.ports[name]
        connection = HTTPConnection("127.0.0.1", port, timeout=_SCRAPE_S)
        try:
            connection.request("GET", path, headers={"Host": host or f"127.0.0.1:{port}"})
            return connection.getresponse().status
        except (OSError, HTTPException):
            return 0
        finally:
            connection.close()

    def set_time(self, by_s: float) -> None:
        """Set the time of day of its processes by some seconds from the true one."""
        self._offset[:] = struct.pack("d", by_s)

    def active_model(self) -> Bundle:
        """Return the model that the history ends with."""
        sha256 = self.store.history()[-1].sha256
        return next(model for model in self.models.good if model.sha256 == sha256)

    def deploy_at_the_end(self) -> None:
        """Have the model that is active now deployed again when the fault is over."""
        deploy = partial(self.store.deploy, notice=lambda line: None)
        self.undo(partial(deploy, self.active_model(), "made good"))

    def copy_ashore(self) -> None:
        """Take away what earlier runtimes have recorded, as a person does: the next one never does.

        It sees the room after a minute; until then its health may say that there is none.
        """
        by_age = sorted(self.record.glob("run-*"), key=lambda path: path.stat().st_mtime)
        for folder in by_age[:-1]:
            shutil.rmtree(folder, ignore_errors=True)

    def undo(self, call: Callable[[], object]) -> None:
        """Have something done when the fault is over."""
        self.mending.callback(call)


def until(true: Callable[[], object], patience_s: float, poll_s: float = 0.02) -> bool:
    """Wait until something is true; False where it does not come true in time."""
    deadline = time.monotonic() + patience_s
    while not true():
        if time.monotonic() > deadline:
            return False
        time.sleep(poll_s)
    return True


def matches(pattern: str, texts: set[str]) -> bool:
    """Return True if one of some texts has a pattern in it."""
    return any(re.search(pattern, text) for text in list(texts))
