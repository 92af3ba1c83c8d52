"""Readers with each defect that is looked for, for the test of the fuzzer itself."""

from __future__ import annotations

import os
import signal
import time
import warnings
from pathlib import Path
from random import Random

from tokt.features.errors import ToktError

from .case import LONGEST_LINE, Files, Kind


def nothing(rng: Random) -> Files:
    return {"file": b"%d" % rng.randrange(10)}


def traceback(files: Files, folder: Path) -> object:
    return {}["missing"]


def long(files: Files, folder: Path) -> object:
    error = ToktError("short")
    error.args = ("x" * (LONGEST_LINE + 1),)
    raise error


def outside(files: Files, folder: Path) -> object:
    return (folder.parent / "beside").write_bytes(b"")


def outside_and_gone(files: Files, folder: Path) -> object:
    (folder.parents[1] / "gone").write_bytes(b"")
    (folder.parents[1] / "gone").unlink()
    return None


def warns(files: Files, folder: Path) -> object:
    return warnings.warn("careful", stacklevel=1)


def refuses(files: Files, folder: Path) -> object:
    raise ToktError("no good")


def crash(files: Files, folder: Path) -> object:
    if files["file"] == b"3":
        os.kill(os.getpid(), signal.SIGSEGV)
    return None


def hang(files: Files, folder: Path) -> object:
    if files["file"] == b"3":
        time.sleep(60)
    return None


KINDS = {
    "crash": Kind("crash", "more", 1, nothing, crash),
    "hang": Kind("hang", "more", 1, nothing, hang),
}
