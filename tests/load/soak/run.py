"""One soaked run: `tokt run --source stream:...`, with what is around it and done to it."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.load.program import ended, program
from tokt.inference.recording.run_log import events_path
from tokt.models.bundle.bundle import Bundle

from .attend import Attendant, Exchanges
from .feed import Feeder
from .plan import FrameKind, plan

_AROUND_S = 0.02
"""Recorded around a detection: so many frames at a soak's pace as at a camera's in two seconds."""
_LAST_EXCHANGE = 0.95
"""Part of the frames after which no model is exchanged any more."""
_SETTLE_S = 30.0
"""How long the last exchange is waited for: a run looks for a new model between two frames."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class SoakSize:
    """Numbers of frames, kills and pauses of a soak.

    Parameters
    ----------
    frames : int
    bare_frames : int
        Of the same run with nothing around it, to compare with.
    kills : int
        How often the runtime is killed under its watchdog.
    rest_s : float
        Seconds between a frame's end and the next one.
    pauses, pause_s : int, float
        How often no frame comes to a run in real time, and for how long.
    exchange_every_s : float
        How often another model becomes active.
    look_every_s : float
        How often its metrics are asked for, and its memory is looked at.
    log_mb : float
        Of a log file, after which the next one begins.
    log_keep : int
        Older log files.
    record_mb : float
        Of the disk, for recordings.
    """

    frames: int = 1_000_000
    bare_frames: int = 50_000
    kills: int = 20
    rest_s: float = 0.0
    pauses: int = 30
    pause_s: float = 1.3
    exchange_every_s: float = 60.0
    look_every_s: float = 1.0
    log_mb: float = 5.0
    log_keep: int = 3
    record_mb: float = 20.0

    def of(self, frames: int) -> SoakSize:
        """The same of so many frames."""
        return replace(self, frames=frames, bare_frames=min(self.bare_frames, frames))


FULL = SoakSize()
QUICK = SoakSize(
    frames=3000,
    bare_frames=1000,
    kills=2,
    rest_s=2e-3,
    pauses=3,
    exchange_every_s=3.0,
    log_mb=0.2,
    record_mb=1.0,
)


@dataclass(frozen=True)
class Run:
    """Results of one run.

    Parameters
    ----------
    extent : SoakSize
    summary, heard : dict
        What `tokt run --json` said at its end, and what came of its datagrams.
    age_s, round_trip_s : array of float64, shape (frames,)
        Seconds from a frame's arrival until its report was sent, and from when it was sent to
        the run until its datagram was here. 0 where there was none.
    attendant : Attendant or None
    seconds : float
    exchanges : Exchanges or None
    happened : sequence of (name, number of the last frame before it)
        What is in its log besides frames.
    """

    extent: SoakSize
    summary: dict[str, Any]
    heard: dict[str, Any]
    age_s: NDArray[np.float64]
    round_trip_s: NDArray[np.float64]
    attendant: Attendant | None
    seconds: float
    exchanges: Exchanges | None = None
    happened: Sequence[tuple[str, int]] = ()


def whole_run(folder: Path, extent: SoakSize, models: Sequence[Bundle], say: Say) -> Run:
    """Run to the end with everything around it.

    Parameters
    ----------
    folder : Path
        Made here.
    extent : SoakSize
    models : sequence of Bundle
        As `Exchanges` takes them.
    say : callable

    Raises
    ------
    ToktError
        If the run fails.
    """
    (folder / "log").mkdir(parents=True)
    exchanges = Exchanges(folder / "store", models)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    log = folder / "log" / "run.jsonl"
    options = ["--store", folder / "store", "--metrics", port, "--log", log]
    options += ["--log-max-mb", extent.log_mb, "--log-keep", extent.log_keep]
    options += ["--record", folder / "record", "--record-mb", extent.record_mb]
    options += ["--record-before", _AROUND_S, "--record-after", _AROUND_S]

    def attendant(pid: int) -> Attendant:
        every = extent.look_every_s, extent.exchange_every_s
        last = int(_LAST_EXCHANGE * extent.frames)
        return Attendant(pid, port, exchanges, *every, last, say)

    run = _run(folder, extent, options, attendant)
    lines = map(json.loads, events_path(log).read_text("utf-8").splitlines())
    happened = [(line["event"], line["seq"] - 1) for line in lines]
    return replace(run, exchanges=exchanges, happened=happened)


def bare_run(folder: Path, extent: SoakSize, model: Bundle) -> Run:
    """Run to the end with nothing around it. Raises ToktError if it fails."""
    folder.mkdir()
    (folder / "soak.tokt").write_bytes(model.data)
    return _run(folder, extent, ["--bundle", folder / "soak.tokt"])


def _run(
    folder: Path,
    extent: SoakSize,
    options: Sequence[object],
    attendant_of: Callable[[int], Attendant] | None = None,
) -> Run:
    kinds, said = plan(extent.frames), folder / "said"
    last = int(_LAST_EXCHANGE * extent.frames)
    settle_s = _SETTLE_S / (extent.frames - last)
    with closing(Feeder(kinds)) as feeder:
        fixed = ["--source", feeder.address, "--policy", "texture", "--json"]
        fixed += [word for address in feeder.receivers for word in ("--udp", address)]
        with program("run", *fixed, *options, said=said) as process:
            start = time.monotonic()
            attendant = None if attendant_of is None else attendant_of(process.pid)

            def rest(number: int, kind: FrameKind) -> None:
                # Not among repeated pictures: how long they were the same counts, too.
                waits = number >= last and kind is FrameKind.WATER and attendant is not None
                slower = waits and not attendant.settled
                time.sleep(extent.rest_s + (settle_s if slower else 0))

            try:
                with attendant or nullcontext():
                    feeder.run(rest)
            except OSError:
                raise ended("run", process, said) from None
            out = process.stdout.read()
            if process.wait():
                raise ended("run", process, said)
        return Run(
            extent=extent,
            summary=json.loads(out),
            heard={**feeder.truth.found, "unlike_the_plan": feeder.truth.worst},
            age_s=feeder.age_s,
            round_trip_s=feeder.round_trip_s,
            attendant=attendant,
            seconds=time.monotonic() - start,
        )
