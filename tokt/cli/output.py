"""What commands print: JSON for scripts, progress on a terminal, plain lines elsewhere."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

T = TypeVar("T")


def print_json(value: Any) -> None:
    """Print one JSON object on standard output."""
    print(json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False))


def say(text: str) -> None:
    """Print a line for people on standard error, so that standard output stays for results."""
    print(text, file=sys.stderr, flush=True)


def progress(items: Iterable[T], total: int, what: str) -> Iterator[T]:
    """Yield `items`, showing a bar on a terminal and a few plain lines elsewhere."""
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import track

        yield from track(items, what, total, console=Console(stderr=True), transient=True)
        return
    step = max(1, total // 4)
    for done, item in enumerate(items, 1):
        yield item
        if done % step == 0 or done == total:
            say(f"{what}: {done}/{total}")
