"""Parts of a run that fail at a restart or a start: none of them silences it.

One run under its watchdog has every optional part at once. Its runtime is killed while all of them
have a fault; each is then mended. The rows of docs/reference/faults.md are held as in
test_faults.py.
"""

import os
import re
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
import pytest

from tests.ports import TakenPort
from tests.waiting import MAX_S, until
from tokt.features.common.atomic import locked
from tokt.features.frames.mask_file import mask_file
from tokt.features.frames.view_mask import CameraMasks, ViewMask, write_masks
from tokt.inference.links.autopilot import mavlink_dialect
from tokt.inference.outputs.udp import decode
from tokt.models.bundle.bundle import bundle_bytes, read_bundle

from ..conftest import draw, write_mission
from ..live import bound_socket
from ..policy import named_object
from ..stereo import plain_rig
from ..test_faults import hold_row

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")

NAMES = """
import os, socket
real = socket.getaddrinfo
def getaddrinfo(host, *more, **options):
    if host in ("pilot.example", b"pilot.example"):
        if not os.path.exists({known!r}):
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        host = "127.0.0.1"
    return real(host, *more, **options)
socket.getaddrinfo = getaddrinfo
"""


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    with socket.socket(socket.AF_INET, kind) as opened:
        opened.bind(("127.0.0.1", 0))
        return opened.getsockname()[1]


class Sea:
    """`tokt run` with one receiver, and the words that it says."""

    def __init__(
        self, folder: Path, *options: object, receiver: str | None = None, **process: Any
    ) -> None:
        self.receiver, self.folder = bound_socket(), folder
        self.said: list[dict[str, Any]] = []
        self.errors = folder.with_name(f"{folder.name}-stderr")
        address = receiver or f"v2@127.0.0.1:{self.receiver.getsockname()[1]}"
        command = [sys.executable, "-m", "tokt", "run", "--udp", address, *map(str, options)]
        self.process = subprocess.Popen(
            command, cwd=folder, stderr=self.errors.open("w"), **process
        )

    def next(self) -> dict[str, Any]:
        self.said.append(decode(self.receiver.recv(65535)))
        return self.said[-1]

    def until(self, true: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        return until(lambda: one if true(one := self.next()) else None, self.words)

    def words(self) -> str:
        return self.errors.read_text()

    def kill_runtime(self) -> dict[str, Any]:
        """Kill the runtime, and return the first verdict of the next one."""
        (runtime,) = psutil.Process(self.process.pid).children()
        runtime.kill()
        self.until(lambda one: one["seq"] == 1)
        return self.said[-1] if self.said[-1]["model"] else self.until(lambda one: one["model"])

    def close(self) -> None:
        self.process.terminate()
        assert self.process.wait(MAX_S) == 0, self.words()
        self.receiver.close()


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    """Frames in folders Left and Right, with an obstacle in one of three."""
    folder = tmp_path_factory.mktemp("dive")
    write_mission(folder, [[(4, 4)] if number % 3 else [(1, 1)] for number in range(1200)])
    return folder


def renamed(bundle_file: Path) -> bytes:
    """The same model as noise/8."""
    return bundle_bytes(replace(read_bundle(bundle_file).content, version="8"))


@dataclass
class PartFault:
    """A fault of one part of the run, made while it goes on, and mended after it is back."""

    row: str  # in docs/reference/faults.md
    option: str  # of `tokt run`
    make: Callable[[], object]
    mend: Callable[[], object]
    joined: Callable[[], object]  # whether the part does its work again


def is_served(port: int) -> bool:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=1) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False


def answers(port: int) -> bool:
    """Whether MAVLink comes back from there."""
    mavlink = mavlink_dialect()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.settimeout(0.5)
        beat = mavlink.MAVLink(None, 1, 1)
        station.sendto(beat.heartbeat_encode(2, 3, 0, 0, 4).pack(beat), ("127.0.0.1", port))
        try:
            return bool(station.recv(2048))
        except OSError:
            return False


def has_depth(sea: Sea, port: int) -> bool:
    """Whether a sentence of a depth sounder is read there."""
    sentence = b"GPHDT,90.0,T"
    check = reduce(xor, sentence)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as compass:
        compass.sendto(b"$%s*%02X\r\n" % (sentence, check), ("127.0.0.1", port))
    return sea.next()["heading_deg"] == 90.0


PORTS = {
    "metrics": "another program has the port of `--metrics`",
    "view": "another program has the port of `--view`",
    "mavlink": "another program has the port of `--mavlink`",
    "nmea": "another program has the port of `--nmea`",
}


class AtSea:
    """One run whose parts all had a fault as it was started again; what was said of each."""

    def __init__(self, folder: Path, dive: Path, bundle_file: Path) -> None:
        known, self.pilot = folder / "known", bound_socket()
        self.pilot.settimeout(0.2)
        known.touch()
        (folder / "sitecustomize.py").write_text(NAMES.format(known=str(known)))
        for name in ("logs", "films"):
            (folder / name).mkdir()
        model = Path(shutil.copy(bundle_file, folder / "m.tokt"))
        mask, config, source = folder / "mask.png", folder / "dive.toml", folder / "dive"
        source.symlink_to(dive)
        cv2.imwrite(str(mask), cv2.rectangle(draw([]) * 0, (300, 200), (330, 230), 255, -1))
        config.write_text("[recording]\nlog-keep = 3\n")
        self.ports = {name: free_port() for name in ("metrics", "view")}
        udp = socket.SOCK_DGRAM
        self.links = {name: free_port(udp) for name in ("mavlink", "nmea")}
        path = os.pathsep.join([str(folder), *sys.path])
        self.sea = sea = Sea(
            folder,
            *("--watchdog", "--config", config, "--source", source, "--rate", "4"),
            *("--bundle", model, "--policy", "texture", "--mask", mask),
            *("--udp", f"v2@pilot.example:{self.pilot.getsockname()[1]}"),
            *("--log", "logs/log.jsonl", "--record", folder / "rec", "--view-record"),
            *("films/dive.mp4", "--nmea", f"udpin:127.0.0.1:{self.links['nmea']}"),
            *("--metrics", self.ports["metrics"], "--view", self.ports["view"]),
            *("--mavlink", f"udpin:127.0.0.1:{self.links['mavlink']}", "--camera-fov-deg", "60"),
            env={**os.environ, "PYTHONPATH": path},
        )
        log, record = folder / "logs" / "log.jsonl", folder / "rec"
        taken = {name: TakenPort(socket.SOCK_STREAM, port) for name, port in self.ports.items()}
        taken |= {name: TakenPort(udp, port) for name, port in self.links.items()}
        self.faults = [
            PartFault(
                "the log's folder is a file",
                "log",
                lambda: (shutil.rmtree(log.parent), log.parent.write_text("")),
                lambda: (log.parent.unlink(), log.parent.mkdir()),
                lambda: log.is_file() and log.stat().st_size,
            ),
            PartFault(
                "the recording's folder is a file",
                "record",
                lambda: (shutil.rmtree(record), record.write_text("")),
                record.unlink,
                lambda: list(record.glob("run-*/recording.jsonl")),
            ),
            *(
                PartFault(PORTS[name], name, taken[name].take, taken[name].free, joined)
                for name, joined in (
                    ("metrics", lambda: is_served(self.ports["metrics"])),
                    ("view", lambda: is_served(self.ports["view"])),
                    ("mavlink", lambda: answers(self.links["mavlink"])),
                    ("nmea", lambda: has_depth(sea, self.links["nmea"])),
                )
            ),
            PartFault(
                "the folder of `--view-record` is gone",
                "view-record",
                lambda: shutil.rmtree(folder / "films"),
                (folder / "films").mkdir,
                lambda: list((folder / "films").glob("*.part")),
            ),
            PartFault(
                "the name of one of two receivers is not known any more",
                "udp",
                known.unlink,
                known.touch,
                self._pilot_hears,
            ),
        ]
        self.changes = {
            "the bundle's file is replaced": (model, lambda: model.write_bytes(renamed(model))),
            "the configuration is half written": (config, lambda: config.write_text("[record")),
            "the mask's picture is deleted": (mask, mask.unlink),
        }

    def _pilot_hears(self) -> bool:
        try:
            return bool(self.pilot.recv(65535))
        except OSError:
            return False

    def hear_all(self) -> None:
        """Take what the other receiver was sent until now."""
        while self._pilot_hears():
            continue


@pytest.fixture(scope="module")
def at_sea(tmp_path_factory, dive, bundle_file) -> Iterator[AtSea]:
    pytest.importorskip("pymavlink")
    pytest.importorskip("prometheus_client")
    pytest.importorskip("av")
    at_sea = AtSea(tmp_path_factory.mktemp("sea"), dive, bundle_file)
    sea = at_sea.sea
    assert sea.until(lambda one: one["model"])["model"] == "noise/7"
    for _, change in at_sea.changes.values():
        change()
    for fault in at_sea.faults:
        fault.make()
    assert sea.kill_runtime()["model"] == "noise/7"
    until(lambda: all(f"--{fault.option} is not working" in sea.words() for fault in at_sea.faults))
    yield at_sea
    sea.close()


ROWS = [
    "the log's folder is a file",
    "the recording's folder is a file",
    *PORTS.values(),
    "the folder of `--view-record` is gone",
    "the name of one of two receivers is not known any more",
]
JOINS = "back with the same model; health names the part, which joins once it can"


@pytest.mark.parametrize("row", ROWS)
def test_a_part_that_fails_at_a_restart_joins_later(at_sea, row):
    (fault,) = [each for each in at_sea.faults if each.row == row]
    at_sea.hear_all()
    assert not fault.joined()
    health = at_sea.sea.until(lambda one: one["model"])["health"]
    assert re.search(f"without .*--{fault.option}", health)
    fault.mend()
    until(fault.joined, at_sea.sea.words)
    until(lambda: f"--{fault.option} " in at_sea.sea.words().rpartition("is working")[0])
    hold_row(row, JOINS, "events `part_failed`, `part_joined`; `tokt_part_failing`")


CHANGES = [
    "the bundle's file is replaced",
    "the configuration is half written",
    "the mask's picture is deleted",
]


@pytest.mark.parametrize("row", CHANGES)
def test_a_restart_is_the_same_run(at_sea, row):
    file, _ = at_sea.changes[row]
    changed = f"{file} (has changed|is gone) since the run began"
    assert re.search(changed, at_sea.sea.words())
    assert {one["model"] for one in at_sea.sea.said} - {None} == {"noise/7"}
    hold_row(row, "back with what the run began with", "event `file_changed`")


def test_a_restart_needs_neither_its_folder_nor_what_lies_beside_the_frames(
    dive, bundle_file, tmp_path
):
    home, source, sharp = tmp_path / "home", tmp_path / "dive", tmp_path / "sharp"
    for folder in (home, source, sharp):
        folder.mkdir()
    for camera in ("Left", "Right"):
        (source / camera).symlink_to(dive / camera)
    for number in range(1, 6):
        shutil.copy(dive / "Left" / f"t_L_{number}.jpg", sharp)
    masked = ViewMask(((0.0, 0.0, 0.2, 0.2),))
    write_masks(source, CameraMasks(masked, masked))
    shutil.copy(bundle_file, home / "m.tokt")
    sea = Sea(
        home,
        *("--watchdog", "--bundle", "m.tokt", "--policy", "texture", "--log", "log.jsonl"),
        *("--source", source, "--rate", "4", "--sharp-frames", sharp, "--accept-blind"),
    )
    sight = sea.until(lambda one: one["model"])["sight"]
    assert any(sight["masked"])
    shutil.rmtree(home)
    mask_file(source).unlink()
    (sharp / "t_L_1.jpg").unlink()
    again = sea.kill_runtime()
    assert again["sight"]["masked"] == sight["masked"]
    assert "sharp has changed since the run began" in again["health"]
    until(lambda: f"{mask_file(source)} is gone since the run began" in sea.words())
    sea.close()
    back = "back with what the run began with"
    hold_row("the folder in which tokt was started is deleted", back, "event `file_changed`")
    hold_row("the mask beside the frames is deleted", back, "event `file_changed`")
    words = "back; nothing is called clear, and health says why"
    hold_row("the frames of `--sharp-frames` change", words, "nothing")


MISSING = "unknown `no_frame` with the reason, until it is there"


@pytest.fixture
def lenient(tmp_path):
    """Start a run that goes on until what it needs is there."""
    started: list[Sea] = []

    def start(*options: object, **process: Any) -> Sea:
        started.append(Sea(tmp_path, "--no-strict", "--rate", "4", *options, **process))
        return started[-1]

    yield start
    for sea in started:
        sea.close()


def test_a_start_without_a_source_and_a_model_waits_for_both(lenient, dive, bundle_file, tmp_path):
    source, model = tmp_path / "dive", tmp_path / "m.tokt"
    sea = lenient("--source", source, "--bundle", model, "--policy", "texture")
    first = sea.until(lambda one: "without --source" in one["health"])
    assert (first["status"], first["reason"]) == (-1, "no_frame")
    assert "not a folder of frames" in first["health"]
    source.symlink_to(dive)
    without_model = sea.until(lambda one: "without --policy: bundle" in one["health"])
    assert (without_model["status"], without_model["reason"]) == (-1, "no_frame")
    shutil.copy(bundle_file, model)
    verdict = sea.until(lambda one: one["model"])
    assert sea.said[0]["health"].startswith("no frame has come yet")
    numbers = [one["seq"] for one in sea.said]
    assert numbers == list(range(1, verdict["seq"] + 1))
    hold_row("no source at the start, with `--no-strict`", MISSING, "heartbeats")
    hold_row("no model at the start, with `--no-strict`", MISSING, "heartbeats")


def test_a_start_whose_only_receiver_is_not_known_waits_for_it(
    lenient, dive, bundle_file, tmp_path
):
    known = tmp_path / "known"
    (tmp_path / "sitecustomize.py").write_text(NAMES.format(known=str(known)))
    with bound_socket() as pilot:
        address = f"v2@pilot.example:{pilot.getsockname()[1]}"
        sea = lenient(
            *("--source", dive, "--bundle", bundle_file, "--policy", "texture"),
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
            receiver=address,
        )
        time.sleep(2)
        assert sea.process.poll() is None
        known.touch()
        assert decode(pilot.recv(65535))["seq"] == 1
    hold_row(
        "the name of the only receiver is not known at the start, with `--no-strict`",
        "nothing, until it is known",
        "nothing",
    )


def test_a_recording_that_another_process_writes_is_waited_for(
    lenient, dive, bundle_file, tmp_path
):
    folder = tmp_path / "rec"
    folder.mkdir()
    with locked(folder / ".recording.lock", 0.0):
        options = ("--source", dive, "--bundle", bundle_file, "--policy", "texture")
        sea = lenient(*options, "--record", folder)
        health = sea.until(lambda one: one["model"])["health"]
        assert "without --record" in health and "another tokt" in health
    until(lambda: list(folder.glob("run-*/recording.jsonl")), sea.words)
    words = "as without it, and health names the part, which joins once it can"
    hold_row(
        "another process has the recording's folder", words, "events `part_failed`, `part_joined`"
    )


def calibration_of_drawn(path: Path) -> Path:
    """A rig of two equal cameras whose frames are as the drawn ones."""
    scale = 360 / plain_rig.WIDTH
    camera = plain_rig.CAMERA * [[scale], [scale], [1]]
    camera[0, 2], camera[1, 2] = 179.5, 135.0
    straight = plain_rig.STRAIGHT
    parts = {"K1": camera, "D1": straight, "K2": camera, "D2": straight}
    shift = {"R": np.eye(3), "T_mm": plain_rig.SHIFT_MM}
    size = {"image_width": 360, "image_height": 271}
    return plain_rig.store_parts(path, {**parts, **shift, **size})


LATER = {
    "the mask's picture is missing, with `--no-strict`": ("mask", ("--mask", "mask.png")),
    "the picture of the object to hold is missing, with `--no-strict`": (
        "anchor-from",
        ("--anchor-from", "object.png:98,90,60,84"),
    ),
    "the challenger's model is missing, with `--no-strict`": (
        "shadow",
        ("--shadow", "other.tokt", "--shadow-log", "shadow.jsonl"),
    ),
    "the calibration is missing, and texture has its model, with `--no-strict`": (
        "calibration",
        ("--calibration", "rig.yml"),
    ),
}


@pytest.fixture(scope="module")
def without_files(tmp_path_factory, dive, bundle_file) -> Iterator[Sea]:
    """A run that begins without any of the files that verdicts can go on without."""
    folder = tmp_path_factory.mktemp("without")
    options = [word for _, words in LATER.values() for word in words]
    more = ("--no-strict", "--policy", "fallback", "--rate", "4", "--log", "log.jsonl")
    sea = Sea(folder, *more, "--source", dive, "--bundle", bundle_file, *options)
    sea.until(lambda one: one["model"])
    yield sea
    sea.close()


@pytest.mark.parametrize("row", LATER)
def test_a_file_that_is_missing_joins_once_it_is_there(without_files, bundle_file, row):
    sea, (option, _) = without_files, LATER[row]
    until(lambda: f"--{option} is not working" in sea.words())
    assert re.search(f"without .*--{option}", sea.until(lambda one: one["model"])["health"])
    if option == "mask":
        cv2.imwrite(
            str(sea.folder / "mask.png"), cv2.rectangle(draw([]) * 0, (9, 9), (40, 40), 255)
        )
    elif option == "anchor-from":
        picture = named_object.picture(named_object.own(120), seed=1)
        cv2.imwrite(str(sea.folder / "object.png"), picture)
    elif option == "shadow":
        (sea.folder / "other.tokt").write_bytes(renamed(bundle_file))
    else:
        calibration_of_drawn(sea.folder / "rig.yml")
    until(lambda: re.search(f"--{option} .* is working", sea.words()), sea.words)
    sea.until(lambda one: one["model"] and f"--{option}" not in one["health"])
    words = "as without it, and health names the part, which joins once it can"
    hold_row(row, words, "events `part_failed`, `part_joined`")
