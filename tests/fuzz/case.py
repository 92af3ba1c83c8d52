"""One case: a changed input, what a reader makes of it, and whether that is as it should be."""

from __future__ import annotations

import shutil
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from random import Random

from tokt.features.errors import ToktError

from .sandbox import Sandbox

LONGEST_LINE = 1000
"""Characters of an error message: a screen of it helps nobody."""

Files = dict[str, bytes]
"""An input: its files, by path below the case's folder."""


class End(StrEnum):
    """How a case can end; all but the first two are defects."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    CRASH = "crashes"
    TRACEBACK = "tracebacks"
    HANG = "hangs"
    BAD_LINE = "bad lines"
    OUTSIDE = "files outside"


GOOD = (End.ACCEPTED, End.REFUSED)


@dataclass(frozen=True)
class Kind:
    """A kind of input and what reads it.

    Parameters
    ----------
    name : str
    group : {"bundles", "files", "stores", "more"}
        Which count it has a part of.
    share : float
        That part, in relation to the others of the group.
    make : callable
        Gives an input; the same one for the same random numbers.
    read : callable
        Given the files and the folder that it may write to; raises ToktError where it refuses,
        and anything else where there is a defect.
    most : int
        Cases it never has more of: for readers that take long.
    """

    name: str
    group: str
    share: float
    make: Callable[[Random], Files]
    read: Callable[[Files, Path], object]
    most: int = 10**9


@dataclass(frozen=True)
class Outcome:
    """How a case ended, in words too, and what it took in seconds of this process's time."""

    end: End
    words: str = ""
    seconds: float = 0.0


def randomness(seed: int, kind: str, number: int) -> Random:
    """The random numbers of one case, whatever was run before it."""
    return Random(f"{seed}/{kind}/{number}")


def write_files(files: Files, folder: Path) -> None:
    """Put an input where a reader of paths finds it."""
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def line_fault(text: str) -> str:
    """Why a text is not one line of a readable length, or an empty string."""
    if not text.strip():
        return "the message is empty"
    if not text.isprintable():
        return f"the message has control characters: {text!r:.300}"
    if len(text) > LONGEST_LINE:
        return f"the message has {len(text)} characters: {text!r:.300}"
    return ""


def run_case(kind: Kind, files: Files, sandbox: Sandbox) -> Outcome:
    """Have an input read, in this process, and say how it ended."""
    began = time.process_time()
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        with sandbox.watched() as outside:
            end, words = _end_of(kind, files, sandbox.case)
    seconds = time.process_time() - began
    for entry in sandbox.case.iterdir():
        shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
    if outside:
        end, words = End.OUTSIDE, "\n".join(outside)
    elif warned and end in GOOD:
        # On a command line it would be lines beside the one that says what is wrong.
        end, words = End.TRACEBACK, "\n".join(f"warning: {item.message}" for item in warned)
    return Outcome(end, words, seconds)


def _end_of(kind: Kind, files: Files, folder: Path) -> tuple[End, str]:
    try:
        kind.read(files, folder)
    except ToktError as error:
        fault = line_fault(str(error))
        return (End.BAD_LINE, fault) if fault else (End.REFUSED, str(error))
    except Exception:  # noqa: BLE001 - whatever else comes is what is looked for
        return End.TRACEBACK, traceback.format_exc(limit=-12)
    return End.ACCEPTED, ""
