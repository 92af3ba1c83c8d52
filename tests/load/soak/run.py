"""One run of a soak's loop, with its receiver, and with what is done to it meanwhile."""

from __future__ import annotations

import json
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.inference.config import Limits
from tokt.inference.runtime import TICK_S
from tokt.models.bundle.bundle import Bundle

from .exchange import Exchanges
from .loop import LOG, STORE, LoopPlan
from .process_monitor import ProcessMonitor
from .soak_size import SoakSize

MARGIN_S = 0.15
"""By how much a heartbeat may be late at the receiver: a busy machine runs the thread that says it
and the process that hears it a little later."""
SILENCE_S = Limits().heartbeat_s + TICK_S + MARGIN_S

_LOOK_S = 0.05
_SAY_S = 60.0
_LAST_EXCHANGE = 0.95
"""Part of the frames after which no model is exchanged any more."""
_SETTLE_S = 30.0
"""How long the last exchange is waited for."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class Run:
    """Results of one run of the loop.

    Parameters
    ----------
    extent : SoakSize
    loop, heard : dict
        What the loop and the receiver said at their ends.
    arrived, sent, received : array of float64, shape (frames,)
        Seconds, by one clock: when each frame came, when its datagrams were out, and when the one
        of v2 was at the receiver. 0 where there was none.
    watch : ProcessMonitor or None
    exchanges : Exchanges
    seconds : float
    """

    extent: SoakSize
    loop: dict[str, Any]
    heard: dict[str, Any]
    arrived: NDArray[np.float64]
    sent: NDArray[np.float64]
    received: NDArray[np.float64]
    watch: ProcessMonitor | None
    exchanges: Exchanges
    seconds: float

    @property
    def latency_s(self) -> NDArray[np.float64]:
        """From a frame's arrival until its datagrams were out; of frames that were judged."""
        judged = self.sent > 0
        return np.asarray(self.sent[judged] - self.arrived[judged])

    @property
    def reception_s(self) -> NDArray[np.float64]:
        """From a frame's arrival until its datagram was in the other process."""
        heard = self.received > 0
        return np.asarray(self.received[heard] - self.arrived[heard])


def run_loop(
    folder: Path, extent: SoakSize, models: Sequence[Bundle], parts: tuple[str, ...], say: Say
) -> Run:
    """Run the loop to its end.

    Parameters
    ----------
    folder : Path
        Made here.
    extent : SoakSize
    models : sequence of Bundle
        As `Exchanges` takes them.
    parts : tuple of str
        What is around the loop: some of `loop.PARTS`.
    say : callable

    Raises
    ------
    ToktError
        If a process fails.
    """
    (folder / LOG).parent.mkdir(parents=True)
    exchanges = Exchanges(folder / STORE, models)
    receiver = ["receiver", str(folder), str(extent.frames), str(SILENCE_S)]
    with _program(*receiver) as hearing:
        ports = _line(hearing)
        _write_plan(folder, extent, ports, parts)
        start = time.monotonic()
        with _program("loop", str(folder)) as looping:
            port = _line(looping)["metrics_port"]
            watch = None if port is None else ProcessMonitor(looping.pid, port)
            _look_after(looping, watch, exchanges, extent, say)
            loop = _line(looping)
        seconds = time.monotonic() - start
        heard = _line(hearing, ended=True)
    times, received = np.load(folder / "loop.npz"), np.load(folder / "heard.npz")["heard"]
    arrived, sent = times["arrived"], times["sent"]
    return Run(extent, loop, heard, arrived, sent, received, watch, exchanges, seconds)


def _write_plan(
    folder: Path, extent: SoakSize, ports: dict[str, int], parts: tuple[str, ...]
) -> None:
    asked = LoopPlan(
        frames=extent.frames,
        v1_port=ports["v1"],
        v2_port=ports["v2"],
        rest_s=extent.rest_s,
        pause_every_s=extent.pause_every_s,
        pause_s=extent.pause_s,
        log_mb=extent.log_mb,
        log_keep=extent.log_keep,
        record_mb=extent.record_mb,
        parts=parts,
    )
    (folder / "loop.json").write_text(json.dumps(asdict(asked)))


def _look_after(
    looping: subprocess.Popen[str],
    watch: ProcessMonitor | None,
    exchanges: Exchanges,
    extent: SoakSize,
    say: Say,
) -> None:
    """Until the loop ends: exchange its model, and look at it from outside."""
    assert looping.stdin is not None, "it is a pipe"
    if watch is None:
        looping.stdin.close()
        return
    start = scrape_at = time.monotonic()
    exchange_at, say_at, exchanged = start + extent.exchange_every_s, start + _SAY_S, start
    while not _said(looping):
        now = time.monotonic()
        if now >= scrape_at:
            scrape_at += extent.look_every_s
            watch.look()
        if not watch.samples:
            continue
        newest = watch.samples[-1]
        settled = newest.models == exchanges.switches + exchanges.refusals
        soon_over = newest.frames >= _LAST_EXCHANGE * extent.frames
        if now >= exchange_at and settled and not soon_over:
            exchange_at, exchanged, settled = now + extent.exchange_every_s, now, False
            exchanges.step()
        if newest.frames >= extent.frames - 1 and (settled or now - exchanged > _SETTLE_S):
            looping.stdin.close()
        if now >= say_at:
            say_at += _SAY_S
            say(f"   {newest.frames} frames, {newest.resident / 1e6:.1f} MB")


@contextmanager
def _program(name: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A program of this package, ended with the block."""
    command = [sys.executable, "-m", f"{__package__}.{name}", *arguments]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def _said(process: subprocess.Popen[str]) -> bool:
    """Whether a program has said something, or ended, waiting a little for it."""
    assert process.stdout is not None, "it is a pipe"
    return bool(select.select([process.stdout], [], [], _LOOK_S)[0])


def _line(process: subprocess.Popen[str], ended: bool = False) -> dict[str, Any]:
    """The next line a program says, once its input has ended if it waits for that."""
    assert process.stdin is not None and process.stdout is not None, "both are pipes"
    if ended:
        process.stdin.close()
    line = process.stdout.readline()
    if not line:
        raise ToktError(f"a program of the soak ended with code {process.wait()}")
    said: dict[str, Any] = json.loads(line)
    return said
