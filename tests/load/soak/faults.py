"""The faults that a soak injects: each is a row of docs/reference/faults.md, made from outside.

The row is the key: it says what verdicts come of the fault, which events it is reported by, and
whether the runtime starts again, by which `silence_bound` knows how long nothing may be heard.
"""

import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil

from tests.fault_rows import FaultRow, rows_by_fault
from tests.ports import TakenPort
from tokt.features.common.arrays import U8
from tokt.features.common.atomic import locked
from tokt.features.common.errors import ToktError
from tokt.inference.config import Limits
from tokt.inference.monitoring.watchdog import HANG_S
from tokt.inference.outputs.view_server import MAX_CLIENTS
from tokt.inference.publisher import TICK_S
from tokt.inference.sources.stream import MAX_HEADER, encode_frame
from tokt.inference.verdict import STATUS_WORDS

from .feed import Strike, Verdict, receiver
from .live import ASKED_MS
from .ship import Ship, until
from .synthetic_frames import HEIGHT, WIDTH, dark, water

MARGIN_S = 0.15
"""By how much a datagram may be late at the receiver: a busy machine runs the thread that sends it
and the process that hears it a little later."""
SILENCE_S = Limits().heartbeat_s + TICK_S + MARGIN_S
"""Without a fault of the runtime: a verdict, or else a heartbeat, after `--heartbeat` at most."""
BACK_S = ASKED_MS / 1000 + SILENCE_S
"""From a kill to the next datagram: a second until the next runtime sends, and a heartbeat."""
HUNG_S = HANG_S + BACK_S
"""The same where the watchdog kills it: after `HANG_S` without a sign of life."""
STALL_S = 1.0  # that the stream stands still within a frame

_MAX_DELAY_S = 0.003  # from a frame to a kill: while it is judged, or after
_PATIENCE_S = 20.0
_FRAMES = 3  # that are altered in a row


class Bound(NamedTuple):
    """The longest silence that a row allows, and why it is that long."""

    seconds: float
    source: str


@dataclass(frozen=True)
class SoakFault:
    """A fault of a running `tokt run`, which `make` begins and `Ship.undo` ends."""

    row: str  # of docs/reference/faults.md: its first cell
    make: Callable[[Ship], object] = lambda ship: None
    strike: Callable[[Ship], Strike] | None = None  # how the next frame is sent, after `make`
    restarts: bool = False  # whether the watchdog starts the runtime again
    closes: bool = False  # whether the runtime ends by itself, and closes its parts before
    part: str = ""  # the option of the part that is not working meanwhile
    health: str = ""  # a pattern in the health of a verdict
    words: str = ""  # a pattern in what the run writes to standard error
    once: bool = False  # whether that is told once only, of all times of one runtime
    ready: Callable[[Ship], object] = lambda ship: True  # before it can be made
    seen: Callable[[Ship], object] = lambda ship: True  # besides, while it lasts
    lasts_s: float = 0.0  # at least
    pictures: Callable[[int], list[U8 | None]] | None = None  # from a number on, for the planned

    @property
    def documented(self) -> FaultRow:
        """The row, as the page has it."""
        return rows_by_fault()[self.row]

    @property
    def verdicts(self) -> frozenset[Verdict]:
        """Status and reason that altered frames get."""
        statuses = {word: status for status, word in STATUS_WORDS.items()}
        row = self.documented
        verdicts = {(statuses[word], reason) for word, reason in row.verdicts}
        if row.comes_to.startswith("as without it"):
            verdicts.add((statuses["clear"], "ok"))
        if "an obstacle" in row.comes_to:
            verdicts.add((statuses["obstacle"], "ok"))
        return frozenset(verdicts)

    @property
    def silence_bound(self) -> Bound:
        """The longest silence of v2 while it lasts."""
        if self.documented.comes_to.startswith("nothing, until it goes on"):
            return Bound(STALL_S + SILENCE_S, f"{STALL_S:g} s without a whole frame, a heartbeat")
        if self.closes or "without a sign of life" in self.documented.comes_to:
            return Bound(HUNG_S, f"{HANG_S:g} s without a sign of life, a start, a heartbeat")
        if self.restarts:
            return Bound(BACK_S, "a start in 1 s, a heartbeat")
        return Bound(SILENCE_S, "a heartbeat")


remove = partial(shutil.rmtree, ignore_errors=True)  # while others write there


def signalled(number: int) -> Callable[[Ship], Strike]:
    """Send a frame, and some time after it a signal to the runtime."""

    def of(ship: Ship) -> Strike:
        runtime = ship.runtime()

        def strike(connection: socket.socket, frame: bytes) -> None:
            connection.sendall(frame)
            time.sleep(ship.random.uniform(0, _MAX_DELAY_S))
            runtime.send_signal(number)

        return strike

    return of


def after(other: bytes) -> Callable[[Ship], Strike]:
    """Send something else before a frame."""
    return lambda ship: lambda connection, frame: connection.sendall(other + frame)


def stalled(ship: Ship) -> Strike:
    """Send a frame in two halves."""

    def strike(connection: socket.socket, frame: bytes) -> None:
        middle = len(frame) // 2
        connection.sendall(frame[:middle])
        time.sleep(STALL_S)
        connection.sendall(frame[middle:])

    return strike


killed = partial(SoakFault, strike=signalled(signal.SIGKILL), restarts=True)


def replace_file(path: Path, by: Path | None = None) -> None:
    """Put another file in the place of one: an empty one, or a link."""
    other = path.with_name("other")
    if by is None:
        other.write_text("")
    else:
        other.symlink_to(by)
    other.replace(path)


def delete(path: Path) -> None:
    """Delete a file, which may be given another name just then."""

    def is_deleted() -> bool:
        with suppress(FileNotFoundError):
            path.unlink()
            return True
        return False

    until(is_deleted, _PATIENCE_S)


def fill_disk(ship: Ship) -> None:
    """Let the disk under the log's file be full."""
    replace_file(ship.log, Path("/dev/full"))
    ship.undo(ship.log.unlink)


def put_file_in_place(folder: Path, ship: Ship) -> None:
    """Put a file in the place of a folder, which whoever uses it makes anew meanwhile."""

    def is_file() -> bool:
        remove(folder)
        with suppress(OSError):
            folder.write_text("")
        return folder.is_file()

    until(is_file, _PATIENCE_S)

    def mend() -> None:
        folder.unlink()
        folder.mkdir(exist_ok=True)

    ship.undo(mend)


def take_port(name: str, kind: int, ship: Ship) -> None:
    """Let another program have a port as soon as it is free."""
    taken = TakenPort(kind, ship.ports[name])
    taken.take()
    ship.undo(taken.free)


def take_recording(ship: Ship) -> None:
    """Let another process record into the folder as soon as it can."""
    ended = threading.Event()

    def hold() -> None:
        while not ended.is_set():
            with suppress(ToktError), locked(ship.record / ".recording.lock", 0.0):
                ended.wait()
            ended.wait(0.005)

    thread = threading.Thread(target=hold, daemon=True)
    thread.start()
    ship.undo(lambda: (ended.set(), thread.join()))


def forget_name(ship: Ship) -> None:
    """Let nobody know the name of one receiver."""
    ship.known.unlink()
    ship.undo(ship.known.touch)


def write_half(path: Path, ship: Ship) -> None:
    """Leave half of a file."""
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    ship.undo(lambda: path.write_bytes(whole))


def cut_bundle(ship: Ship) -> None:
    """Damage the active bundle on the disk."""
    path = ship.store.bundle_file(ship.active_model().sha256)
    path.write_bytes(path.read_bytes()[:-100])
    ship.deploy_at_the_end()


def damage_both(ship: Ship) -> None:
    """Damage the active bundle and the copy of what ran last."""
    cut_bundle(ship)
    ship.store.last_good_file.write_bytes(b"damaged")


def put_old_pointer_back(ship: Ship) -> None:
    """Put an older `active` file in the pointer's place."""
    pointer = ship.store.path / "active"
    old = pointer.read_bytes()
    ship.store.deploy(ship.active_model(), "once more")
    ship.deploy_at_the_end()
    pointer.write_bytes(old)


def damage_pointer(ship: Ship) -> None:
    """Damage the `active` file."""
    ship.deploy_at_the_end()
    (ship.store.path / "active").write_bytes(b"{")


def take_store_away(ship: Ship) -> None:
    """Take the store's folder away, with its disk."""
    away = ship.store.path.with_name("away")
    ship.store.path.rename(away)
    ship.undo(lambda: away.rename(ship.store.path))


def close_stream(ship: Ship) -> None:
    """Let nobody send frames."""
    ship.feeder.be_away()
    ship.undo(ship.feeder.listen)


def deploy_other(ship: Ship) -> None:
    """Make the other good model active."""
    (other,) = (model for model in ship.models.good if model != ship.active_model())
    ship.store.deploy(other, "the other")
    until(lambda: ship.feeder.truth.model == other.label, _PATIENCE_S)


def deploy_refused(name: str, ship: Ship) -> None:
    """Make a model active that cannot run here."""
    ship.store.deploy(getattr(ship.models, name), "it is refused")
    ship.undo(lambda: ship.store.rollback("back"))


def kill_deployment(ship: Ship) -> None:
    """Kill `tokt deploy` at some instant."""
    other = ship.folder / "other.tokt"
    other.write_bytes(ship.models.good[1].data)
    command = [sys.executable, "-m", "tokt", "deploy", str(other), str(ship.store.path)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as deploy:
        time.sleep(ship.random.uniform(0.1, 1.0))
        deploy.kill()


def set_time(by_s: float, ship: Ship) -> None:
    """Set the time of day."""
    ship.set_time(by_s)
    ship.undo(lambda: ship.set_time(0.0))


def signal_view(number: int, ship: Ship) -> None:
    """Send a signal to the process of the live view."""
    ship.view_process().send_signal(number)


def has_view(ship: Ship) -> bool:
    """Return True if the live view is served, by a process of this runtime."""
    with suppress(psutil.NoSuchProcess):
        ship.view_process()
        return ship.answer("view", "/") == 200
    return False


def crowd(clients: int, ship: Ship) -> None:
    """Open live views that never read."""
    port = ship.ports["view"]
    for _ in range(clients):
        client = socket.create_connection(("127.0.0.1", port))
        client.sendall(b"GET /stream.mjpg HTTP/1.0\r\nHost: 127.0.0.1:%d\r\n\r\n" % port)
        ship.undo(client.close)


def is_foreign_refused(name: str, path: str, ship: Ship) -> bool:
    """Return True if a server refuses who asks for it by another name."""
    return ship.answer(name, path, f"evil.example:{ship.ports[name]}") == 403


def silence_autopilot(ship: Ship) -> None:
    """Let the autopilot fall silent."""
    ship.autopilot.silent = True
    ship.undo(lambda: setattr(ship.autopilot, "silent", False))


def speak_as(systems: Sequence[int], ship: Ship) -> None:
    """Speak to the MAVLink link as so many senders."""
    for system in systems:
        opened = receiver()
        ship.undo(opened.close)
        ship.autopilot.say(ship.autopilot.packed(system), opened)


def contradict_autopilot(ship: Ship) -> None:
    """Give another place in the autopilot's name."""
    with receiver() as forger:
        ship.autopilot.say(ship.autopilot.packed(lat=644_467_000), forger)


def flood(ship: Ship) -> None:
    """Send garbage to the MAVLink link, faster than it is read."""
    garbage = [np.random.default_rng(number).bytes(1000) for number in range(20)]
    with receiver() as stranger:
        for _ in range(200):
            for data in garbage:
                ship.autopilot.say(data, stranger)
            time.sleep(0.005)


def close_spare(ship: Ship) -> None:
    """Let nobody listen at one of the receivers."""
    address = ship.spare.getsockname()
    ship.spare.close()

    def mend() -> None:
        ship.spare = receiver(address[1])

    ship.undo(mend)


def has_recorded(ship: Ship) -> bool:
    """Return True if this runtime has recorded frames."""
    metrics = ship.metrics()
    return metrics is not None and metrics["tokt_recorder_frames_total"] > 0


def several(draw: Callable[[int], U8 | None]) -> Callable[[int], list[U8 | None]]:
    """Draw some pictures in a row."""
    return lambda number: [draw(number + later) for later in range(_FRAMES)]


def of_grey(number: int) -> U8:
    return np.full((HEIGHT, WIDTH, 3), 60 + number % 100, np.uint8)


def of_glare(number: int) -> U8:
    grey = np.random.default_rng((number, 5)).normal(254, 3, (HEIGHT, WIDTH, 3))
    return np.clip(grey, 0, 255).astype(np.uint8)


def torn(number: int) -> U8:
    other = water(number + 5000)  # one that was not delivered
    return np.vstack([water(number)[: HEIGHT // 2], other[HEIGHT // 2 :]])


def small(number: int) -> U8:
    return np.ascontiguousarray(water(number)[:100, :100])


def ring(number: int) -> list[U8 | None]:
    """The last two pictures by turns."""
    return [water(number - 2 + turn % 2) for turn in range(5)]


TCP, UDP = socket.SOCK_STREAM, socket.SOCK_DGRAM
OVER_LARGE = encode_frame(2**52, 4e9, None, None).replace(b'"left":null', b'"left":[16384,16384,3]')
FAULTS = (
    SoakFault("lens covered, lamp out", pictures=several(dark)),
    SoakFault("glare", pictures=several(of_glare)),
    SoakFault("a frame of one grey", pictures=several(of_grey)),
    SoakFault("a torn picture: its lower rows are of the frame before", pictures=several(torn)),
    SoakFault("a frame under 240 pixels wide, or of no camera's shape", pictures=several(small)),
    SoakFault("no such frame", pictures=several(lambda number: None)),
    SoakFault(
        "a camera's buffers go round, or its picture is frozen in part, or a little changed",
        pictures=ring,
    ),
    SoakFault(
        "a stream's header of pictures of over 64 MiB",
        strike=after(OVER_LARGE),
        restarts=True,
        closes=True,
        words="sends no frames",
    ),
    SoakFault(
        "a stream's header that does not end",
        strike=after(b"{" + b" " * MAX_HEADER),
        restarts=True,
        closes=True,
        words="sends no frames: a line of",
    ),
    SoakFault(
        "a stream whose numbers or times run backwards",
        strike=after(encode_frame(-1, 0.0, None, None)),
        restarts=True,
        closes=True,
        words="runs backwards",
    ),
    SoakFault("a stream that stalls within a frame", strike=stalled),
    SoakFault("the time of day is set back by an hour", make=partial(set_time, -3600.0)),
    SoakFault("the time of day is set forward by an hour", make=partial(set_time, 3600.0)),
    SoakFault(
        "a receiver gone: the system answers that nobody listens", make=close_spare, lasts_s=1.0
    ),
    SoakFault("the log's disk is full", make=fill_disk, part="log"),
    SoakFault("the log's file is deleted", make=lambda ship: delete(ship.log)),
    SoakFault("the log's events are deleted", make=lambda ship: delete(ship.events)),
    SoakFault("the log's file is replaced", make=lambda ship: replace_file(ship.log)),
    SoakFault("the log's file is cut short", make=lambda ship: ship.log.write_bytes(b"")),
    SoakFault(
        "the log's file is given another name",
        make=lambda ship: ship.log.rename(ship.log.with_name("old.jsonl")),
    ),
    SoakFault("the log's folder is deleted", make=lambda ship: remove(ship.log.parent)),
    SoakFault(
        "the recording's folder is deleted",
        make=lambda ship: remove(ship.record),
        words="the recording was taken away and restarted",
        ready=has_recorded,
    ),
    SoakFault("a MAVLink link whose other end sends garbage", make=flood),
    SoakFault("the autopilot falls silent", make=silence_autopilot),
    SoakFault(
        "8 senders of other systems speak first on a MAVLink link (`udpin`)",
        make=partial(speak_as, range(101, 110)),
        words="senders of systems other than system 1",
        once=True,
    ),
    SoakFault(
        "more than 32 senders with the own system's number on a MAVLink link (`udpin`)",
        make=partial(speak_as, [1] * 40),
        words="senders of system 1",
        once=True,
    ),
    SoakFault(
        "two senders with the autopilot's numbers, each at its address, contradict each other",
        make=contradict_autopilot,
    ),
    SoakFault(
        "the live view's process is killed",
        make=partial(signal_view, signal.SIGKILL),
        words="the live view is started again",
        once=True,
        ready=has_view,
        seen=has_view,
    ),
    SoakFault(
        "the live view's process hangs",
        make=partial(signal_view, signal.SIGSTOP),
        words="the live view is started again",
        once=True,
        ready=has_view,
        seen=has_view,
    ),
    SoakFault(
        "clients of the live view that never read",
        make=partial(crowd, 5),
        ready=has_view,
        lasts_s=3.0,
    ),
    SoakFault(
        "clients of the live view that never read, more than there is room for",
        make=partial(crowd, MAX_CLIENTS + 6),
        ready=has_view,
        lasts_s=3.0,
    ),
    SoakFault(
        "the live view without a token is asked for by another host name",
        ready=has_view,
        seen=partial(is_foreign_refused, "view", "/"),
    ),
    SoakFault(
        "metrics are asked for by another host name",
        seen=partial(is_foreign_refused, "metrics", "/metrics"),
    ),
    killed("SIGKILL at any moment"),
    SoakFault("the runtime hangs altogether", strike=signalled(signal.SIGSTOP), restarts=True),
    SoakFault(
        "SIGTERM to the runtime and not to its watchdog (earlyoom)",
        strike=signalled(signal.SIGTERM),
        restarts=True,
        closes=True,
    ),
    killed(
        "the log's folder is a file",
        make=lambda ship: put_file_in_place(ship.log.parent, ship),
        part="log",
    ),
    killed(
        "the recording's folder is a file",
        make=lambda ship: put_file_in_place(ship.record, ship),
        part="record",
    ),
    killed(
        "another program has the port of `--metrics`",
        make=partial(take_port, "metrics", TCP),
        part="metrics",
    ),
    killed(
        "another program has the port of `--view`",
        make=partial(take_port, "view", TCP),
        part="view",
    ),
    killed(
        "another program has the port of `--mavlink`",
        make=partial(take_port, "mavlink", UDP),
        part="mavlink",
    ),
    killed("the name of one of two receivers is not known any more", make=forget_name, part="udp"),
    killed("the configuration is half written", make=lambda ship: write_half(ship.config, ship)),
    killed("another process has the recording's folder", make=take_recording, part="record"),
    killed(
        "no source at the start, with `--no-strict`", make=close_stream, health="without --source"
    ),
    killed(
        "no model at the start, with `--no-strict`", make=take_store_away, health="without --policy"
    ),
    SoakFault("the bundle is damaged on disk while it runs", make=cut_bundle, lasts_s=2.0),
    killed("the bundle is damaged on disk, then SIGKILL", make=cut_bundle, health="is refused"),
    SoakFault("a new model becomes active while it runs", make=deploy_other),
    SoakFault(
        "a new model that does not pass its checks",
        make=partial(deploy_refused, "unproven"),
        words="golden",
    ),
    SoakFault(
        "a new model of another camera becomes active while it runs",
        make=partial(deploy_refused, "turned"),
        words="cannot judge",
    ),
    killed(
        "an old `active` file is put in the pointer's place",
        make=put_old_pointer_back,
        health="the active pointer",
        words="active by the history .* runs instead",
    ),
    killed(
        "the active pointer is damaged",
        make=damage_pointer,
        health="the active pointer",
        words="active by the history .* runs instead",
    ),
    killed(
        "the active bundle and the last good copy are damaged",
        make=damage_both,
        health="is refused",
        words="the earlier model .* runs instead",
    ),
    SoakFault(
        "a command on the store is killed at any instant, or at any of its system calls",
        make=kill_deployment,
    ),
)
"""All of them, each once."""
