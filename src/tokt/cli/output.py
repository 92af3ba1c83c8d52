"""The results of a command on its terminal: lines, figures and progress."""

import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from tokt.features.common.errors import printable
from tokt.features.common.terminal import print_json, say

T = TypeVar("T")
_MAX_SILENCE_S = 30.0


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
        print_line(f"  obstacle patches: {scores(patch)}")
    if patch["f1"] is None or len(patch["per_class"]) > 2:
        by_class = ", ".join(
            f"{name} {figure(row['f1'])}" for name, row in patch["per_class"].items()
        )
        print_line(f"  classes: macro-F1 {figure(patch['macro_f1'])} ({by_class})")


def scores(patch: dict[str, Any], between: str = "") -> str:
    """The figures of obstacle patches; `between` follows F1."""
    f1, precision, recall, average = (
        figure(patch[key]) for key in ("f1", "precision", "recall", "average_precision")
    )
    return f"F1 {f1}{between}, precision {precision}, recall {recall}, AP {average}"


def figure(value: float | None) -> str:
    """A figure with three decimals, or ``-`` where it is undefined."""
    return "-" if value is None else f"{value:.3f}"
