"""Injects faults into a soaked run, one after the other, and waits for what each row says of it.

::

    place ──> make ──> strike ──> verdicts, events, health of its row ──> mend ──> all as before
              files    a signal, or bytes,
              ports    with a frame
"""

import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain, count
from threading import Event

import numpy as np
import psutil

from tokt.features.common.arrays import U8
from tokt.features.common.terminal import say
from tokt.inference.monitoring.watchdog import STEADY_S
from tokt.inference.recording.recorder import NO_ROOM

from .faults import FAULTS, SoakFault
from .feed import AlteredFrame, Feeder
from .plan import SEED, FrameKind, SoakSize
from .ship import Ship, matches

_PATIENCE_S = 60.0
"""Until what a row says has come, and until all is as before: longer than the slowest takes (a
refused model is looked at again after 30 s)."""
_POLL_S = 0.05
_CALM_FRAMES = 60  # of clear water, from where a fault is due
_WAIT = 0.1  # part of the frames up to the next fault that a strike waits for an obstacle, at most
_BACK = re.compile(r"_(joined|back)$")
"""Events that tell that a fault is over."""

Drawn = Sequence[tuple[int, SoakFault]]
"""Faults, each with the number of the frame from which on it is due."""


@dataclass(frozen=True)
class Injection:
    """A fault that was made, and what came of it."""

    row: str
    number: int  # of the frame it was made at
    restarts: bool
    bound_s: float
    source: str  # of the bound
    from_s: float  # seconds of `time.monotonic`
    to_s: float
    missing: tuple[str, ...]  # of what its row says

    @property
    def reported(self) -> bool:
        return not self.missing


def draw_faults(kinds: U8, size: SoakSize) -> Drawn:
    """Draw a fault for each `fault_every` frames, all of them as often."""
    faults = [each for each in FAULTS if not size.fault_rows or each.row in size.fault_rows]
    rng = np.random.default_rng(SEED)
    order = chain.from_iterable(rng.permutation(len(faults)) for _ in count())
    places = range(size.fault_every, size.last_fault, size.fault_every)
    return [
        (_calm_from(kinds, place), faults[index])
        for place, index in zip(places, order, strict=False)
    ]


def _calm_from(kinds: U8, number: int) -> int:
    """Return the first number from which on the water is clear for a while."""
    while (kinds[number : number + _CALM_FRAMES] != FrameKind.WATER).any():
        number += 1
    return number


def altered_frames(drawn: Drawn) -> Mapping[int, AlteredFrame]:
    """Draw the frames that are given in place of the planned ones, by their numbers."""
    made = (
        (number + later, AlteredFrame(picture, fault.verdicts))
        for number, fault in drawn
        if fault.pictures is not None
        for later, picture in enumerate(fault.pictures(number))
    )
    return dict(made)


class Evidence:
    """Datagrams, words and counts from a moment on, held against a fault's row."""

    def __init__(self, fault: SoakFault, ship: Ship) -> None:
        self._fault, self._row, self._ship = fault, fault.documented, ship
        truth = ship.feeder.truth
        self._heard = truth.recent = type(truth.recent)()
        self._model = truth.model
        self._restarts = ship.restarts()
        self._since = ship.life_begins() if fault.once else len(ship.words().encode())
        before = None if fault.restarts else ship.metrics()
        self._before = Counter[str]() if before is None else before

    def missing(self, mended: bool) -> list[str]:
        """List what the row says and has not come; of its end only once it is `mended`."""
        return [words for words, came in self._checks(mended) if not came]

    def _checks(self, mended: bool) -> Iterator[tuple[str, object]]:
        fault, row, heard = self._fault, self._row, self._heard
        written = self._ship.words(self._since)
        if fault.restarts:
            yield "one restart", self._ship.restarts() == self._restarts + 1 and heard.starts == 1
            yield "a verdict", heard.models or (row.counted == "heartbeats" and not mended)
        if "same model" in row.comes_to or "began with" in row.comes_to:
            yield f"{self._model} alone", heard.models == {self._model}
        if row.counted == "heartbeats":
            yield row.counted, heard.heartbeats
        if fault.health:
            yield f"health: {fault.health}", matches(fault.health, heard.healths)
        if fault.words:
            yield f"written: {fault.words}", re.search(fault.words, written)
        if fault.part:
            option = f"--{fault.part}"
            yield f"{option} in health", matches(f"without .*{option}", heard.healths)
            yield f"{option} is not working", f"{option} is not working" in written
            at_work = re.search(rf"{option} \S* ?is working", written)
            yield f"{option} is working", at_work or not mended
        yield "seen", fault.seen(self._ship)
        counts = self._counts(mended)
        grown = self._grown(counts)
        for name in counts:
            yield name, grown is not None and grown[name] > 0

    def _counts(self, mended: bool) -> list[str]:
        """Name the counts that grow by the row."""
        row, fault = self._row, self._fault
        # A part that is missing may be the metrics.
        events = [] if fault.part and not mended else sorted(row.events)
        names = [f"event {name}" for name in events if mended or not _BACK.search(name)]
        for words, name in _COUNTS.items():
            if re.search(words, row.counted):
                names.append(name)
        return names

    def _grown(self, names: Sequence[str]) -> Counter[str] | None:
        if not names:
            return Counter()
        now = self._ship.metrics()
        if now is None:
            return None
        before = Counter[str]() if self._fault.once else self._before
        return Counter({name: now[name] - before[name] for name in names})


_COUNTS = {
    r"log failures \+[1-9]": "tokt_log_lines_failed_total",
    r"switches \+1$": "tokt_model_switches_total",
    r"refusals \+1$": "tokt_model_refusals_total",
}
"""Counts of a row, and the metrics that have them."""


class FaultInjector:
    """Injects faults while a block lasts, in a thread; `injections` has those that are over."""

    def __init__(self, ship: Ship, drawn: Drawn, size: SoakSize) -> None:
        self.injections: list[Injection] = []
        self._ship, self._drawn = ship, drawn
        # From which frames on the next fault, or the end, waits for one.
        self._limits = [*[number for number, _ in drawn[1:]], size.last_fault]
        self._at_most = max(int(_WAIT * size.fault_every), 1)
        self._ended = Event()
        self._pool = ThreadPoolExecutor(1)

    def __enter__(self) -> "FaultInjector":
        self._running = self._pool.submit(self._run)
        return self

    def __exit__(self, *_error: object) -> None:
        self._ended.set()
        self._pool.shutdown()
        self._running.result()

    def is_late(self, number: int) -> bool:
        """Return True if frames are to come slowly, as the next fault is due while one lasts."""
        done = len(self.injections)
        return done < len(self._drawn) and number >= self._limits[done]

    def _run(self) -> None:
        for number, fault in self._drawn:
            while self._feeder.number < number:
                if self._ended.wait(_POLL_S):
                    return
            injection = self._inject(number, fault)
            self.injections.append(injection)
            words = f"{injection.row}: {injection.to_s - injection.from_s:.1f} s"
            missing = ", ".join(injection.missing)
            say(f"   frame {injection.number}: {words}{missing and f'; missing: {missing}'}")

    @property
    def _feeder(self) -> Feeder:
        return self._ship.feeder

    def _inject(self, due: int, fault: SoakFault) -> Injection:
        ship, bound = self._ship, fault.silence_bound
        self._await(lambda: fault.ready(ship))
        if fault.restarts:
            self._await(self._is_steady)
        evidence = Evidence(fault, ship)
        from_s, number = time.monotonic(), self._feeder.number
        missing: list[str] = []
        with ship.mending:
            fault.make(ship)
            if fault.strike is not None:
                self._feeder.arm(fault.strike(ship), ship.random.randrange(self._at_most))
                if not self._await(lambda: not self._feeder.is_armed):
                    missing.append("struck")
            self._ended.wait(fault.lasts_s)
            if fault.pictures is not None:
                missing += self._wrong_verdicts(due, fault)
            missing += self._wait_for(evidence, mended=False)
        missing += self._wait_for(evidence, mended=True)
        ship.copy_ashore()
        if not self._await(self._is_as_before):
            missing.append("as before")
        return Injection(
            row=fault.row,
            number=number,
            restarts=fault.restarts,
            bound_s=bound.seconds,
            source=bound.source,
            from_s=from_s,
            to_s=time.monotonic(),
            missing=tuple(dict.fromkeys(missing)),
        )

    def _wrong_verdicts(self, due: int, fault: SoakFault) -> list[str]:
        """List the altered frames of a fault that did not get a verdict that its row has."""
        assert fault.pictures is not None
        numbers = range(due, due + len(fault.pictures(due)))
        self._await(lambda: self._feeder.number > numbers[-1])
        verdicts = self._feeder.truth.of_altered
        return [f"{number}" for number in numbers if verdicts.get(number) not in fault.verdicts]

    def _wait_for(self, evidence: Evidence, mended: bool) -> list[str]:
        missing: list[str] = []

        def is_complete() -> bool:
            missing[:] = evidence.missing(mended)
            return not missing

        self._await(is_complete)
        return missing

    def _await(self, true: Callable[[], object]) -> bool:
        """Wait until something is true, while frames come; False where it does not come true."""
        deadline = time.monotonic() + _PATIENCE_S
        while not true():
            if self._ended.wait(_POLL_S) or time.monotonic() > deadline:
                return False
        return True

    def _is_steady(self) -> bool:
        try:
            return time.time() - self._ship.runtime().create_time() > STEADY_S
        except psutil.NoSuchProcess:
            return False

    def _is_as_before(self) -> bool:
        """Return True if the newest frame of clear water has nothing to say in its health."""
        health = self._feeder.truth.health
        return (health == "ok" or NO_ROOM in health) and self._ship.metrics() is not None
