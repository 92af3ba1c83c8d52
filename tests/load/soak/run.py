"""One soaked run: `tokt run --source stream:...`, with what is around it and done to it."""

import json
import time
from collections.abc import Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tests.calls import free_port
from tests.load.program import ended, program
from tokt.features.common.arrays import F64
from tokt.inference.recording.run_log import events_path
from tokt.models.bundle.bundle import Bundle
from tokt.models.store.store import Store

from .attend import Attendant, exchanges
from .feed import Feeder
from .plan import FrameKind, SoakSize, plan

_AROUND_S = 0.02
"""Recorded around a detection: so many frames at a soak's pace as at a camera's in two seconds."""
_SETTLE_S = 30.0
"""How long the last exchange is waited for: a run looks for a new model between two frames."""


@dataclass(frozen=True)
class Run:
    extent: SoakSize
    summary: dict[str, Any]  # what `tokt run --json` said at its end
    heard: dict[str, Any]  # what came of its datagrams
    age_s: F64  # of each frame, from its arrival until its report was sent
    round_trip_s: F64  # from when it was sent until its datagram was here
    attendant: Attendant | None
    seconds: float
    happened: Sequence[tuple[str, int]] = ()
    """What is in its log besides frames, and the number of the last frame before it."""


def whole_run(folder: Path, extent: SoakSize, models: Sequence[Bundle]) -> Run:
    (folder / "log").mkdir(parents=True)
    store = Store(folder / "store")
    store.deploy(models[0], "the first")
    port, log = free_port(), folder / "log" / "run.jsonl"
    options = ["--store", store.path, "--metrics", port, "--log", log]
    options += ["--log-max-mb", extent.log_mb, "--log-keep", extent.log_keep]
    options += ["--record", folder / "record", "--record-mb", extent.record_mb]
    options += ["--record-before", _AROUND_S, "--record-after", _AROUND_S]

    steps = exchanges(store, models)
    run = _run(folder, extent, options, lambda pid: Attendant(pid, port, steps, extent))
    lines = map(json.loads, events_path(log).read_text("utf-8").splitlines())
    happened = [(line["event"], line["seq"] - 1) for line in lines]
    return replace(run, happened=happened)


def bare_run(folder: Path, extent: SoakSize, model: Bundle) -> Run:
    folder.mkdir()
    (folder / "soak.tokt").write_bytes(model.data)
    return _run(folder, extent, ["--bundle", folder / "soak.tokt"])


def _run(folder, extent, options, attendant_of=None) -> Run:
    kinds, said = plan(extent.frames), folder / "said"
    settle_s = _SETTLE_S / (extent.frames - extent.last_exchange)
    with closing(Feeder(kinds)) as feeder:
        fixed = ["--source", feeder.address, "--policy", "texture", "--json"]
        fixed += [word for address in feeder.receivers for word in ("--udp", address)]
        with program("run", *fixed, *options, said=said) as process:
            start = time.monotonic()
            attendant = None if attendant_of is None else attendant_of(process.pid)

            def rest(number: int, kind: FrameKind) -> None:
                # Not among repeated pictures: how long they were the same counts, too.
                late = number >= extent.last_exchange and kind is FrameKind.WATER
                waits = late and attendant is not None and not attendant.settled
                time.sleep(extent.rest_s + (settle_s if waits else 0))

            try:
                with attendant or nullcontext():
                    feeder.run(rest)
            except OSError:
                raise ended("run", process, said) from None
            out = process.stdout.read()
            if process.wait():
                raise ended("run", process, said)
        heard = {**feeder.truth.found, "unlike_the_plan": feeder.truth.worst}
        times = (feeder.age_s, feeder.round_trip_s)
        return Run(extent, json.loads(out), heard, *times, attendant, time.monotonic() - start)
