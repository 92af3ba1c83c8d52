"""One soaked run: `tokt run --source stream:...`, with what is around it and done to it."""

import json
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from tests.load.program import ended, program
from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.models.bundle.bundle import Bundle

from .attend import Attendant
from .feed import Feeder
from .injector import FaultInjector, Injection, altered_frames, draw_faults
from .plan import FrameKind, SoakSize, plan
from .ship import Ship
from .standstill import Interval, StandstillWatch
from .synthetic_frames import Models

_LATE_S, _SETTLE_S, _MAX_REST_S = 5e-3, 30.0, 0.5
"""Rest before each frame while the next fault waits for one that lasts: at least; by which the
frames that are left last so long; at most, as the watchdog waits for two seconds."""
_WATCHED = Path(__file__).with_name("watched.py")


@dataclass(frozen=True)
class Around:
    """What was around a run, and done to it."""

    attendant: Attendant
    injections: Sequence[Injection]
    drawn: int  # faults that were to be injected
    restarts: int
    standstills: Sequence[Interval]


@dataclass(frozen=True)
class Run:
    extent: SoakSize
    summary: dict[str, Any]  # what `tokt run --json` said at its end: of its last runtime
    heard: dict[str, Any]  # what came of its datagrams
    age_s: F64  # of each frame, from its arrival until its report was sent
    round_trip_s: F64  # from when it was sent until its datagram was here
    heard_s: F64  # when that was, in seconds of `time.monotonic`
    silences: Sequence[Interval]  # longer ones
    seconds: float
    around: Around | None = field(default=None)


def whole_run(folder: Path, extent: SoakSize, models: Models) -> Run:
    """Run under the watchdog, with everything around the loop, and inject faults."""
    kinds = plan(extent.frames)
    drawn = draw_faults(kinds, extent)
    with ExitStack() as opened:
        feeder = opened.enter_context(closing(Feeder(kinds, altered_frames(drawn))))
        ship = opened.enter_context(closing(Ship(folder, extent, models, feeder)))
        standstills = opened.enter_context(StandstillWatch())
        process = opened.enter_context(
            program(
                *("run", *_options(feeder), *ship.options),
                said=ship.stderr,
                start=("-P", _WATCHED),
                env=ship.env,
            )
        )
        ship.process = psutil.Process(process.pid)
        attendant, injector = Attendant(ship, extent), FaultInjector(ship, drawn, extent)

        def rest(number: int, kind: FrameKind) -> None:
            # Not among repeated pictures: how long they were the same counts, too.
            is_late = kind is FrameKind.WATER and injector.is_late(number)
            late_s = min(max(_SETTLE_S / (extent.frames - number), _LATE_S), _MAX_REST_S)
            time.sleep(extent.rest_s + (late_s if is_late else 0))

        start = time.monotonic()
        try:
            with injector, attendant:
                feeder.run(rest)
        except ToktError:
            raise ended("run", process, ship.stderr) from None
        summary = _end(process, ship.stderr)
        around = Around(
            attendant, injector.injections, len(drawn), ship.restarts(), standstills.gaps()
        )
        return _run_of(extent, summary, feeder, start, around)


def bare_run(folder: Path, extent: SoakSize, model: Bundle) -> Run:
    """Run the loop with nothing around it."""
    folder.mkdir()
    (folder / "soak.tokt").write_bytes(model.data)
    said = folder / "said"
    with closing(Feeder(plan(extent.frames))) as feeder:
        options = ["run", *_options(feeder), "--bundle", folder / "soak.tokt"]
        with program(*options, said=said) as process:
            start = time.monotonic()
            try:
                feeder.run(lambda number, kind: time.sleep(extent.rest_s))
            except ToktError:
                raise ended("run", process, said) from None
            return _run_of(extent, _end(process, said), feeder, start)


def _options(feeder: Feeder) -> list[object]:
    receivers = [word for address in feeder.receivers for word in ("--udp", address)]
    return ["--source", feeder.address, "--policy", "texture", "--json", *receivers]


def _end(process: Any, said: Path) -> dict[str, Any]:
    """The summary of the last runtime, once it has ended: one that is stopped has one as well."""
    out = process.stdout.read()
    if process.wait():
        raise ended("run", process, said)
    return dict(json.loads(out[out.rindex("\n{") if "\n{" in out else 0 :]))


def _run_of(
    extent: SoakSize,
    summary: dict[str, Any],
    feeder: Feeder,
    start: float,
    around: Around | None = None,
) -> Run:
    return Run(
        extent=extent,
        summary=summary,
        heard={**feeder.truth.found, "unlike_the_plan": feeder.truth.worst},
        age_s=feeder.age_s,
        round_trip_s=feeder.round_trip_s,
        heard_s=feeder.heard_s,
        silences=feeder.silences,
        seconds=time.monotonic() - start,
        around=around,
    )
