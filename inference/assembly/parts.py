"""The parts of a run: each is opened, reported where that fails, tried again, and put to work.

::

    add ──> thread: open ─────────────────────> waits ──> join, between two frames
               ^     │ fails: event, health, metrics
               └─────┴─ pause 1, 2, 4, 5, 5 ... s

A run requires one part of each kind of `REQUIRED`: a source, a detector and a receiver. Every other
part is optional, and so is a second receiver or a second detector: a run goes on without them.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from tokt.features.common.address import without_credentials
from tokt.features.common.errors import ToktError, UnavailableError, os_words
from tokt.inference.clock import Clock
from tokt.inference.config import OPTIONS
from tokt.inference.report import Event
from tokt.inference.verdict import WITHOUT

SOURCE, DETECTOR, RECEIVER = REQUIRED = "source", "detector", "receiver"
"""The kinds of parts of which a run needs one each."""

PART_FAILED, PART_JOINED = "part_failed", "part_joined"
"""Events: a part of the run cannot be opened, or fails; it works after it had failed."""

FIRST_PAUSE_S, MAX_PAUSE_S = 1.0, 5.0
"""Seconds until a part is opened again: at first, and at most after the pause has doubled."""
PATIENCE_S = 1.0
"""Seconds that a start waits for an optional part, such as a log on a disk that hangs."""


@dataclass(frozen=True)
class Part:
    """One part of a run, and the option that asks for it."""

    option: str  # name of a field of `RunConfig`, whose section describes the part
    value: object  # of this option, or the one of its values that this part is for
    open: Callable[[], Any]  # raises ToktError or OSError where the part cannot be opened
    join: Callable[[Any], None]  # puts what `open` returned to work; called between two frames
    kind: str = ""  # one of `REQUIRED`; empty for a part that is always optional
    strict: bool = False  # whether a strict start ends where it fails: verdicts depend on it
    fault: Callable[[Any], str] = lambda _: ""  # why what was opened fails at present, or ""
    # Takes what fails out of work, so that it is opened again; None for what recovers by itself.
    leave: Callable[[Any], None] | None = None

    @cached_property
    def name(self) -> str:
        """The name that people know it by: its option as on the command line."""
        return without_credentials(f"{self.key} {self.value}")

    @property
    def key(self) -> str:
        """The option's name on the command line."""
        return f"--{OPTIONS[self.option].key}"


class _Attempt:
    """The first attempt to open a part."""

    def __init__(self, part: Part) -> None:
        self.part = part
        self.ended = threading.Event()
        self.error: Exception | None = None


class RunParts:
    """Open the parts of a run, and put those that fail to work once they can be opened.

    Parameters
    ----------
    clock : Clock
        For the times of events.
    tell : callable
        Takes the events `PART_FAILED` and `PART_JOINED`, from any thread.
    strict : bool
        Whether a part that verdicts depend on, or a required one, has to be there at the start.

    Attributes
    ----------
    faults : dict of str
        By the part's name the reason why it is not working. For any thread to read.
    """

    def __init__(self, clock: Clock, tell: Callable[[Event], None], strict: bool) -> None:
        self.faults: dict[str, str] = {}
        self._clock, self._tell, self._strict = clock, tell, strict
        self._opened: deque[tuple[Part, Any]] = deque()
        self._working: list[tuple[Part, Any]] = []
        self._closing = threading.Event()

    def add(self, parts: Iterable[Part]) -> None:
        """Open parts, all at once, and put them to work, or have them tried again.

        A strict start waits for each part that verdicts depend on, or of a required kind, and
        raises its error. Other parts are waited for `PATIENCE_S` seconds at most. What the system
        refuses is reported, and any other error, such as of an option's value, ends a strict start.
        """
        attempts = []
        for part in parts:
            if self._strict and part.strict:
                # On this thread: another one's memory takes longer to get.
                self._opened.append((part, part.open()))
                self.join()
            else:
                attempts.append(_Attempt(part))
                self._start(attempts[-1])
        patient_until_s = time.monotonic() + PATIENCE_S
        for attempt in attempts:
            required = self._strict and bool(attempt.part.kind)
            left_s = max(patient_until_s - time.monotonic(), 0.0)
            ended = attempt.ended.wait(None if required else left_s)
            if not (ended or attempt.part.kind):
                self._fail(attempt.part, f"it is not open after {PATIENCE_S:g} s")
            error = attempt.error
            refused = isinstance(error, OSError | UnavailableError)
            if self._strict and error is not None and not refused:
                raise error
        self.join()

    def _start(self, attempt: _Attempt, pause_s: float = 0.0) -> None:
        threading.Thread(
            target=self._keep_trying, args=(attempt, pause_s), name="tokt part", daemon=True
        ).start()

    def _keep_trying(self, attempt: _Attempt, pause_s: float) -> None:
        while not self._closing.wait(pause_s):
            try:
                opened = attempt.part.open()
            # A defect in one part must cost this part alone, and never the run.
            except Exception as error:  # noqa: BLE001 - raised again by `add` in a strict start
                attempt.error = error
                self._fail(attempt.part, _words(error))
            else:
                self._opened.append((attempt.part, opened))
                if self._closing.is_set():
                    self.close()
                attempt.ended.set()
                return
            attempt.ended.set()
            pause_s = min(2 * pause_s, MAX_PAUSE_S) or FIRST_PAUSE_S

    def _fail(self, part: Part, words: str) -> None:
        if self.faults.get(part.name) == words or self._closing.is_set():
            return
        self.faults[part.name] = words
        self._report(PART_FAILED, part, f"{part.key} is not working: {words}")

    def join(self) -> None:
        """Put what was opened meanwhile to work; for the loop's thread, between two frames."""
        while self._opened:
            part, opened = self._opened.popleft()
            try:
                part.join(opened)
            except ToktError as error:
                self._fail(part, str(error))
                close_if_open(opened)
                self._start(_Attempt(part), MAX_PAUSE_S)
            else:
                self._working.append((part, opened))
        for part, opened in list(self._working):
            if not (words := part.fault(opened)):
                self._recover(part)
                continue
            self._fail(part, words)
            if part.leave is not None:
                part.leave(opened)
                self._working.remove((part, opened))
                self._start(_Attempt(part), MAX_PAUSE_S)

    def _recover(self, part: Part) -> None:
        if self.faults and self.faults.pop(part.name, None) is not None:
            self._report(PART_JOINED, part, f"{part.name} is working")

    def _report(self, event: str, part: Part, message: str) -> None:
        self._tell(Event(self._clock.time(), event, message, {"part": part.name}))

    def has(self, kind: str) -> bool:
        """Return whether a part of this kind works; ToktError if a strict start lacks it."""
        if any(part.kind == kind for part, _ in self._working):
            return True
        if self._strict:
            raise ToktError("; ".join(self.faults.values()))
        return False

    @property
    def health(self) -> tuple[str, str]:
        """The parts that are not working, for the health of every verdict: at length, and short."""
        faults = [(name.partition(" ")[0], words) for name, words in list(self.faults.items())]
        if not faults:
            return "", ""
        long = (f"{WITHOUT}{option}: {words}".replace("; ", ", ") for option, words in faults)
        return "; ".join(long), WITHOUT + ", ".join(option for option, _ in faults)

    def close(self) -> None:
        """Open nothing any more, and close what was opened too late to be put to work."""
        self._closing.set()
        with suppress(IndexError):  # another thread closes the last one
            while self._opened:
                close_if_open(self._opened.popleft()[1])


def close_if_open(opened: Any) -> None:
    """Close what a part opened, if that is something to close."""
    if hasattr(opened, "close"):
        opened.close()


def _words(error: Exception) -> str:
    """Return why a part cannot be opened."""
    if isinstance(error, ToktError):
        return str(error)
    if isinstance(error, OSError):
        return os_words(error)
    return str(ToktError(f"{type(error).__name__}: {error}"))
