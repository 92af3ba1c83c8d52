"""A command and its terminal: JSON, lines, progress, figures, and its end at Ctrl-C."""

import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, TypeVar

from tokt.features.common.errors import printable

T = TypeVar("T")
_MAX_SILENCE_S = 30.0


def print_json(value: Any) -> None:
    """Print one JSON object on standard output; a string's unprintable characters as escapes."""
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)
    signs = (one if one.isprintable() or one == "\n" else json.dumps(one)[1:-1] for one in text)
    print("".join(signs))


def print_line(text: str = "") -> None:
    """Print a line for people on standard output, `printable` whatever file it comes from.

    The modules of this room import it as ``print``.
    """
    print(printable(text), flush=True)  # somebody may wait for it


def answer(as_json: bool, value: Any, show: Callable[[], object]) -> None:
    """Print a command's result: as a JSON object where that is asked for, else as `show` does."""
    if as_json:
        print_json(value)
    else:
        show()


def say(text: str) -> None:
    """Print a line for people on standard error, so that standard output stays for results.

    Work goes on where nobody reads it any more: a terminal that was closed ends no watchdog.
    """
    try:
        print(printable(text), file=sys.stderr, flush=True)
    except OSError:
        # What could not be written would be tried again at the end, and change the exit code.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def progress(items: Iterable[T], total: int, what: str) -> Iterator[T]:
    """Yield `items`, showing how far it is and how long it will take.

    A bar on a terminal; elsewhere a line each quarter, and at least every half minute.
    """
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import track

        yield from track(items, what, total, console=Console(stderr=True), transient=True)
        return
    step = max(1, total // 4)
    began = said = time.monotonic()
    for done, item in enumerate(items, 1):
        yield item
        now = time.monotonic()
        if done % step == 0 or done == total or now - said > _MAX_SILENCE_S:
            said = now
            say(f"{what}: {done}/{total}{_remaining((now - began) / done * (total - done))}")


def _remaining(seconds: float) -> str:
    """A rough time to go, where it is long enough to matter."""
    if seconds < _MAX_SILENCE_S:
        return ""
    minutes = math.ceil(seconds / 60)
    if minutes < 120:
        return f", about {minutes} min left"
    return f", about {math.ceil(minutes / 60)} h left"


def print_patches(patch: dict[str, Any]) -> None:
    """Obstacle figures where they mean something, and those by class for several classes."""
    if patch["f1"] is not None:
        print_line(
            f"  obstacle patches: F1 {figure(patch['f1'])}, precision "
            f"{figure(patch['precision'])}, recall {figure(patch['recall'])}, "
            f"AP {figure(patch['average_precision'])}"
        )
    if patch["f1"] is None or len(patch["per_class"]) > 2:
        by_class = ", ".join(
            f"{name} {figure(row['f1'])}" for name, row in patch["per_class"].items()
        )
        print_line(f"  classes: macro-F1 {figure(patch['macro_f1'])} ({by_class})")


def figure(value: float | None) -> str:
    """A figure with three decimals, or ``-`` where it is undefined."""
    return "-" if value is None else f"{value:.3f}"


@contextmanager
def stop_on_signal(stop: Callable[[], None]) -> Iterator[None]:
    """Call `stop` at the first Ctrl-C or SIGTERM, so that nothing is cut off half-way.

    A second Ctrl-C interrupts at once, for a loop that hangs. Only for the main thread.
    """

    def handle(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        stop()

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
