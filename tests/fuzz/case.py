"""A case: a changed input, the box it is read in, and every kind of defect that is looked for."""

import faulthandler
import os
import resource
import shutil
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

from tokt.features.common.errors import ToktError

from .changes import changed_file

Files = dict[str, bytes]  # an input: its files, by path below the case's folder

MAX_LINE = 1000  # characters of an error message: a screen of it helps nobody
HANG_S = 60.0
"""Seconds on the clock that a case may take: it needs some milliseconds on a quiet machine."""
_MAX_MEMORY = 3 << 30  # bytes of address space beyond what the process has when it begins

EVIL = Path("/tmp/tokt-fuzz-evil")  # the absolute path that changed zip members name
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_PATHS = {"os.mkdir": 1, "os.remove": 1, "os.rmdir": 1, "os.truncate": 1, "os.chmod": 1}
_PATHS |= {"sqlite3.connect": 1, "os.rename": 2, "os.link": 2, "os.symlink": 2}
"""Audit events that write, and how many of their arguments are paths."""
_NEVER = {"subprocess.Popen", "os.system", "os.exec", "socket.connect"}
_OWN_PICKLES = ("concurrent.futures.", "tokt.", "numpy", "pathlib")
"""Modules of what a child process of ours sends back."""


class DefectError(AssertionError):
    """A reader did with an input what it must not do."""


def change_one(files: Files, rng: Random, others: Sequence[bytes]) -> Files:
    name = rng.choice(list(files))
    return {**files, name: changed_file(name, files[name], rng, others)}


@dataclass(frozen=True)
class Kind:
    name: str
    seeds: Callable[[], Sequence[Files]]  # sound inputs
    read: Callable[[Path], object]
    """Given the folder of the input, the only one it may write to. Raises ToktError where it
    refuses, and anything else where there is a defect."""
    share: float  # percent of the cases that `make fuzz` asks for
    few: int = 12  # cases in a run of all tests
    change: Callable[[Files, Random, Sequence[bytes]], Files] = change_one
    """Given a sound input, the random numbers that hypothesis chooses, and what to splice with: the
    files of all sound inputs, and `splices`."""
    splices: Callable[[], Sequence[bytes]] = tuple

    def make(self, rng: Random) -> Files:
        seeds = self.seeds()
        others = [*self.splices(), *(data for files in seeds for data in files.values())]
        return self.change(rng.choice(seeds), rng, others)


def sound(name: str, *contents: bytes | str) -> Callable[[], Sequence[Files]]:
    data = [one.encode() if isinstance(one, str) else one for one in contents]
    return lambda: [{name: one} for one in data]


def alone(read: Callable[[Path], object]) -> Callable[[Path], object]:
    """What reads inputs of one file each, given what reads such a file."""
    return lambda folder: read(*folder.iterdir())


def write_files(files: Files, folder: Path) -> None:
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
    return f"a message of {len(text)} characters: {text!r:.300}" if len(text) > MAX_LINE else ""


class _Watch:
    """What Python's audit events say while it is on (PEP 578)."""

    allowed: str | None = None
    found: list[str]
    hooked = False

    def hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Note what is written outside; hooks cannot be taken away, so it can be off."""
        if self.allowed is None:
            return
        paths = arguments[: _PATHS.get(event, 0)]
        if event == "open" and isinstance(arguments[2], int) and arguments[2] & _WRITING:
            paths = arguments[:1]
        for path in paths:
            if isinstance(path, int):
                continue
            # "..": before any link is followed, as the system would see a path that is new.
            full = os.path.normpath(os.path.join(os.getcwd(), os.fsdecode(path)))  # noqa: PTH109, PTH118
            if full != "/dev/null" and not f"{full}/".startswith(f"{self.allowed}/"):
                self.found.append(f"outside: {event} {full[:200]!r}")
        if event in _NEVER or (
            event == "pickle.find_class" and not arguments[0].startswith(_OWN_PICKLES)
        ):
            self.found.append(f"outside: {event} {arguments!r:.200}")


_WATCH = _Watch()


class Box:
    """A folder with the working folder, a home and a place for temporary files.

    An input is read in `case`, and stays there until the next one: after a defect, a crash or a
    hang it is found there, with hypothesis the smallest that was found. The box is an empty folder,
    `terminal` the file descriptor that the stack of a hang is written to.
    """

    def __init__(self, box: Path, terminal: int = 2) -> None:
        self.box, self._terminal = box.resolve(), terminal
        self.case = self.box / "cwd" / "case"
        self._own = [self.box / name for name in ("cwd", "cwd/case", "home", "tmp")]
        self._empty()
        if not _WATCH.hooked:
            sys.addaudithook(_WATCH.hook)
            _WATCH.hooked = True

    def read(self, kind: Kind, files: Files) -> str:
        """Have an input read: its refusal in words, empty where it was accepted.

        Raises DefectError for all else. A crash or a hang ends the process, after its stack is
        written.
        """
        self._empty()
        write_files(files, self.case)
        with warnings.catch_warnings(record=True) as warned, self._watched() as outside:
            warnings.simplefilter("always")
            try:
                kind.read(self.case)
                refusal, fault = "", ""
            except ToktError as error:
                refusal, fault = str(error), line_fault(str(error))
            except Exception:  # noqa: BLE001 - whatever else comes is what is looked for
                refusal, fault = "", traceback.format_exc(limit=-12)
        strangers = [f"outside: {path}" for path in self._strangers()]
        # On a command line a warning would be lines beside the one that says what is wrong.
        beside = [f"warning: {item.message}" for item in warned]
        if faults := [*outside, *strangers, *filter(None, [fault]), *beside]:
            kept = f"{kind.name}: the input is kept in {self.case}"
            raise DefectError("\n".join([*faults, kept]))
        return refusal

    @contextmanager
    def _watched(self) -> Iterator[list[str]]:
        """Yield the list that what is done outside the case's folder is added to."""
        faulthandler.dump_traceback_later(HANG_S, exit=True, file=self._terminal)
        before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
        _WATCH.found, _WATCH.allowed = [], str(self.case)
        try:
            yield _WATCH.found
        finally:
            _WATCH.allowed = None
            sys.dont_write_bytecode = before
            faulthandler.cancel_dump_traceback_later()

    def _strangers(self) -> list[Path]:
        """Files and folders of the box that no case may make, and the one at `EVIL`."""
        folders = (self.box, *(folder for folder in self._own if folder != self.case))
        found = [path for folder in folders for path in folder.iterdir() if path not in self._own]
        return [*found, EVIL] if EVIL.exists() else found

    def _empty(self) -> None:
        for folder in self._own:
            folder.mkdir(parents=True, exist_ok=True)
        for path in (*self._strangers(), *self.case.iterdir()):
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


@contextmanager
def limited_memory() -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
    limit = pages * resource.getpagesize() + _MAX_MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def peak_mb(reset: bool = False) -> float:
    """The most memory the process has had since the last reset (Linux: proc(5), clear_refs)."""
    if reset:
        Path("/proc/self/clear_refs").write_text("5", "ascii")
    status = Path("/proc/self/status").read_text("ascii")
    found = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    return int(found.split()[1]) / 1024
