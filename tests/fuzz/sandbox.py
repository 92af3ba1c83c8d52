"""The folder that a case may write to, and a watch on everything it does elsewhere."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

EVIL = Path("/tmp/tokt-fuzz-evil")
"""The absolute path that changed zip members name."""
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_ONE_PATH = {"os.mkdir", "os.remove", "os.rmdir", "os.truncate", "os.chmod", "sqlite3.connect"}
_TWO_PATHS = {"os.rename", "os.link", "os.symlink"}
_OWN_PICKLES = ("concurrent.futures.", "tokt.", "numpy", "pathlib")
"""Modules of what a child process of ours sends back."""
_NEVER = {"subprocess.Popen", "os.system", "os.exec", "socket.connect"}


class _Watch:
    """What Python's audit events say while it is on (PEP 578)."""

    def __init__(self) -> None:
        self.allowed: str | None = None
        self.found: list[str] = []
        self.hooked = False

    def hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Note what is written outside; hooks cannot be taken away, so it can be off."""
        if self.allowed is None:
            return
        if event == "open":
            path, _, flags = arguments
            if isinstance(flags, int) and flags & _WRITING:
                self._check(event, path)
        elif event in _ONE_PATH:
            self._check(event, arguments[0])
        elif event in _TWO_PATHS:
            self._check(event, arguments[0])
            self._check(event, arguments[1])
        elif event in _NEVER or (
            event == "pickle.find_class" and not arguments[0].startswith(_OWN_PICKLES)
        ):
            self.found.append(f"{event} {arguments!r:.200}")

    def _check(self, event: str, path: Any) -> None:
        if isinstance(path, int) or self.allowed is None:
            return
        # "..": before any link is followed, as the system would see a path that is new.
        full = os.path.normpath(os.path.join(os.getcwd(), os.fsdecode(path)))  # noqa: PTH109, PTH118
        if full != "/dev/null" and not f"{full}/".startswith(f"{self.allowed}/"):
            self.found.append(f"{event} {full[:200]!r}")


_WATCH = _Watch()


class Sandbox:
    """A box with the working folder, a home and a folder for temporary files.

    Parameters
    ----------
    box : Path
        An empty folder. The case's own folder in it is `case`.
    """

    def __init__(self, box: Path) -> None:
        self.box = box.resolve()
        self.case = self.box / "cwd" / "case"
        self.home, self.temporary = self.box / "home", self.box / "tmp"
        self._own = {self.box / "cwd", self.case, self.home, self.temporary}
        for folder in self._own:
            folder.mkdir(parents=True, exist_ok=True)
        if not _WATCH.hooked:
            sys.addaudithook(_WATCH.hook)
            _WATCH.hooked = True

    def enter(self) -> None:
        """Make this process live in the box; for processes that do nothing else."""
        os.chdir(self.case.parent)
        os.environ.update(HOME=str(self.home), TMPDIR=str(self.temporary))
        tempfile.tempdir = None
        sys.dont_write_bytecode = True

    @contextmanager
    def watched(self) -> Iterator[list[str]]:
        """Yield the list that what is done outside the case's folder is added to."""
        _WATCH.found = []
        before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
        _WATCH.allowed = str(self.case)
        try:
            yield _WATCH.found
        finally:
            _WATCH.allowed = None
            sys.dont_write_bytecode = before
            _WATCH.found += self._strangers()

    def _strangers(self) -> list[str]:
        """Files and folders of the box that no case may make, and the one at `EVIL`."""
        found = [] if not EVIL.exists() else [str(EVIL)]
        pending = [self.box]
        while pending:
            with os.scandir(pending.pop()) as entries:
                for entry in entries:
                    path = Path(entry.path)
                    if path not in self._own:
                        found.append(str(path))
                    elif path != self.case:
                        pending.append(path)
        return found
