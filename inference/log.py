"""The runtime's log: one JSON object a frame, on disk as soon as it is said."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..features.errors import ToktError


class JsonLines:
    """A file of JSON lines that is added to, never rewritten: a log of an earlier dive stays.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    failed : int
        Lines that could not be written, such as on a full disk. A log that fails does not stop
        the runtime.
    last_error : str

    Raises
    ------
    ToktError
        If the file cannot be opened.
    """

    def __init__(self, path: Path | str) -> None:
        self.failed = 0
        self.last_error = ""
        try:
            # Unbuffered: a line is the operating system's once `write` returns.
            self._file = Path(path).open("ab", buffering=0)  # noqa: SIM115
            self._torn = _ends_inside_a_line(Path(path))
        except OSError as error:
            raise ToktError(f"log {path} cannot be written: {error.strerror or error}") from None

    def write(self, value: dict[str, Any]) -> None:
        """Add one line, or count why not."""
        line = json.dumps(value, separators=(",", ":"), allow_nan=False).encode("ascii") + b"\n"
        if self._torn:
            line = b"\n" + line
        try:
            self._torn = self._file.write(line) != len(line)
        except OSError as error:
            self.failed += 1
            self.last_error = error.strerror or str(error)
        else:
            self.failed += self._torn

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _ends_inside_a_line(path: Path) -> bool:
    """Whether a process that died left its last line half-written."""
    if not path.is_file() or path.stat().st_size == 0:
        return False
    with path.open("rb") as handle:
        handle.seek(-1, 2)
        return handle.read(1) != b"\n"
