"""A program and its terminal: lines on standard error, JSON, and its end at Ctrl-C."""

import atexit
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, TextIO

from .canonical import exact_numbers
from .errors import printable

_STDERR = 2
_real_stderr: TextIO | None = None
_PASSED_ON_S = 0.5  # for what was said last, before a program ends without it


def open_standard_files() -> None:
    """Take the places of standard files that were closed (``2>&-``), before a socket or a log does.

    C libraries write their warnings to descriptor 2, whatever it is by then.
    """
    while (opened := os.open(os.devnull, os.O_RDWR)) <= _STDERR:
        continue
    os.close(opened)
    # Python has None where there was no file, and prints to standard output instead.
    sys.stderr = sys.stderr or os.fdopen(_STDERR, "w", closefd=False)


def live_without_terminal() -> None:
    """Go on whatever becomes of the terminal, and wait for standard error in no thread but one.

    ::

        say, a traceback, a C library ──> pipe ──> thread ──> terminal, file or pipe
              (none of them waits)    (64 KB; what does not go in is left out)

    A terminal that is held (Ctrl-S), a ``tee`` that is stuck or a disk that hangs keeps that thread
    waiting. One that is closed sends SIGHUP, which would end the process. Not on Windows.
    """
    global _real_stderr
    if sys.platform == "win32":
        return
    for number in (signal.SIGHUP, signal.SIGTTOU):
        signal.signal(number, signal.SIG_IGN)
    _real_stderr = os.fdopen(os.dup(_STDERR), "w")
    taken, given = os.pipe()
    os.set_blocking(given, False)
    os.dup2(given, _STDERR)
    os.close(given)
    where = (taken, _real_stderr.fileno())
    thread = threading.Thread(target=_pass_on, args=where, name="tokt stderr", daemon=True)
    thread.start()
    atexit.register(_end_of_stderr, thread)


def real_stderr() -> TextIO | None:
    """Where standard error goes in the end; None unless `live_without_terminal` is in between."""
    return _real_stderr


def _pass_on(taken: int, written: int) -> None:
    """Write out what comes through the pipe, until its other end is closed."""
    while data := os.read(taken, 65_536):
        with suppress(OSError):  # the terminal is closed, but the pipe has to be emptied
            while data:
                data = data[os.write(written, data) :]


def _end_of_stderr(thread: threading.Thread) -> None:
    """Let the thread write what is left, a moment long; then nothing more is written."""
    with suppress(OSError):
        sys.stderr.flush()
    os.dup2(os.open(os.devnull, os.O_WRONLY), _STDERR)
    thread.join(_PASSED_ON_S)


def print_json(value: Any) -> None:
    """Print one JSON object on standard output; a string's unprintable characters as escapes.

    Numbers beyond 2^53 are text, as in `exact_numbers`.
    """
    text = json.dumps(exact_numbers(value), indent=2, ensure_ascii=False, allow_nan=False)
    signs = (one if one.isprintable() or one == "\n" else json.dumps(one)[1:-1] for one in text)
    print("".join(signs))


def say(text: str) -> None:
    """Print a line for people on standard error, so that standard output stays for results.

    Work goes on where nobody reads it any more: a terminal that was closed ends no watchdog.
    """
    try:
        print(printable(text), file=sys.stderr, flush=True)
    except BlockingIOError:
        return  # `live_without_terminal`: nobody takes it
    except OSError:
        # What could not be written would be tried again at the end, and change the exit code.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


@contextmanager
def stop_on_signal(stop: Callable[[], None]) -> Iterator[list[int]]:
    """Call `stop` at the first Ctrl-C or SIGTERM, so that nothing is cut off half-way.

    A second Ctrl-C interrupts at once, for a loop that hangs. Only for the main thread. Yields the
    signals that have come.
    """
    came: list[int] = []

    def handle(number: int, _frame: FrameType | None) -> None:
        came.append(number)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        stop()

    numbers = [signal.SIGINT, signal.SIGTERM]
    if sys.platform == "win32":
        numbers.append(signal.SIGBREAK)  # Ctrl-Break, and what a service manager may send
    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
