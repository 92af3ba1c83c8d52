"""Logs of JSON lines: on disk as soon as they are written, bounded in size, read over all files.

::

    run.jsonl     written now             run.jsonl    (new)
    run.1.jsonl   before it        ──>    run.1.jsonl  was run.jsonl
    run.2.jsonl   oldest                  run.2.jsonl  was run.1.jsonl; what was run.2.jsonl is gone

Each step of a rotation is a rename, the oldest first: a process that is killed between two of them
leaves a number that no file has, and every line where it was.
"""

import contextlib
import json
import math
import os
import queue
import stat
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Any, BinaryIO

from tokt.features.common.errors import ToktError, counted, os_errors_as, os_words
from tokt.inference.config import RecordingConfig

MAX_KEPT = 99
"""Older files; their numbers have no more digits, so that ``run.2016.jsonl`` is none of them."""

_RETRY_BYTES = 1_000_000
_TRIES = 100
_LOST = {"lost_lines", "why"}
_HANGS = "the disk hangs"


@dataclass(frozen=True)
class LogRotation:
    """Limits of a log; ToktError if the size is not positive, or `keep` is not 1 to 99."""

    max_mb: float = RecordingConfig.log_max_mb  # 10^6 bytes of one file; no line is cut to fit
    keep: int = RecordingConfig.log_keep  # older files beside the one that is written

    def __post_init__(self) -> None:
        if not 0 < self.max_mb < math.inf:
            raise ToktError(f"a log file's size is a positive number of MB, not {self.max_mb}")
        if not 1 <= self.keep <= MAX_KEPT:
            raise ToktError(f"1 to {MAX_KEPT} older log files can be kept, not {self.keep}")


def json_line(value: Mapping[str, Any]) -> bytes:
    """A line of a log: an object as JSON in ASCII."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode("ascii") + b"\n"


class JsonLines:
    """A file of JSON lines that is added to, never rewritten: a log of an earlier dive stays.

    A line that cannot be written is counted and does not stop the runtime. The first one that can
    be again follows a line ``{"lost_lines": 12, "why": "No space left on device"}``.

    A file that somebody deletes, replaces or cuts short is opened again, and the lines of this
    process that were in it are counted as lost; `tell` is given a line for people. The new file
    starts with the lines in `header_lines`.

    One process at a time writes the file; without a rotation it grows without end. ToktError if it
    cannot be opened, unless that is left for later: to `open`, or to the first line.
    """

    def __init__(
        self,
        path: Path | str,
        rotation: LogRotation | None = None,
        later: bool = False,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.failed = 0  # lines that could not be written, such as on a full disk
        self.last_error = ""  # what went wrong last, lines lost or not
        self.fault = ""  # why the newest line is not on the disk
        self.header_lines: dict[str, dict[str, Any]] = {}
        self._tell = tell
        self._lines = 0  # in this file, of this process
        self._reopened = self._is_gone = False
        self._path = Path(path)
        self._rotation = rotation
        self._lost = 0
        self._file: FileIO | None = None
        self._size = 0
        self._torn = False
        self._rotate_at = math.inf
        if not later:
            self.open()

    def open(self) -> None:
        """Open the file, or raise ToktError; `write` does it too, and counts where it cannot."""
        with os_errors_as(f"log {self._path} cannot be written"):
            self._open()

    def write(self, value: dict[str, Any]) -> None:
        """Add one line, or count why not."""
        try:
            line = json_line(value)
        except (ValueError, TypeError, RecursionError) as error:
            self._fail(f"not JSON: {error}")
            return
        try:
            self._check_file()
            self._write(line)
        except OSError as error:
            self._fail(os_words(error))
            self.close()  # opened anew for the next line: the disk may have been taken out

    @property
    def is_open(self) -> bool:
        """Whether the file is open: it is not where it could not be opened again."""
        return self._file is not None

    def look(self) -> None:
        """Check that the file is still the one that was opened; open it where it is closed."""
        try:
            self._check_file()
            if self._file is None:
                self._open()
        except OSError as error:
            self.last_error = self.fault = os_words(error)
            self.close()

    def _check_file(self) -> None:
        if self._file is None:
            return
        ours = os.fstat(self._file.fileno())
        try:
            is_ours = os.path.samestat(ours, self._path.stat())
        except OSError:
            is_ours = False
        if is_ours and (ours.st_size >= self._size or not stat.S_ISREG(ours.st_mode)):
            return
        # A file that has been given another name keeps its lines.
        is_gone = ours.st_nlink == 0
        lost = self._lines if is_ours or is_gone else 0
        what = "was cut short" if is_ours else "was deleted" if is_gone else "was moved away"
        self.failed += lost
        self.lose(lost, f"the file {what}")
        self._tell(f"log {self._path} {what} and is reopened: {counted(lost, 'line')} lost")
        self._reopened = True
        self._is_gone = is_gone
        self.close()

    def lose(self, lines: int, why: str) -> None:
        """Say before the next line that so many are not there."""
        self._lost += lines
        self.last_error = why

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            with contextlib.suppress(OSError):  # what it could not keep was told by `write`
                self._file.close()
        self._file = None

    def _write(self, line: bytes) -> None:
        file = self._file or self._open()
        if self._rotation and self._size and self._size + len(line) > self._rotate_at:
            file = self._rotate(self._rotation)
        before = b"\n" if self._torn else b""
        if self._reopened:
            before += b"".join(map(json_line, self.header_lines.values()))
        if self._lost:
            lost = {"lost_lines": self._lost, "why": self.last_error}
            before += json_line(lost)
        data = before + line
        written = file.write(data) or 0
        self._size += written
        if written:
            self._torn = data[written - 1 : written] != b"\n"
        if written >= len(before):
            self._lost, self._reopened, self._is_gone = 0, False, False
        if written < len(data):
            self._fail("the disk took a part of the line only")
        else:
            self._lines, self.fault = self._lines + 1, ""

    def _fail(self, why: str) -> None:
        self.failed += 1
        self._lost += 1
        self.last_error = self.fault = why

    def _rotate(self, rotation: LogRotation) -> FileIO:
        """Begin the next file, or go on in this one if that cannot be."""
        self.close()  # Windows renames no open file
        fault = ""
        try:
            rotate_files(self._path, rotation.keep)
        except OSError as error:
            fault = f"the next file cannot be begun: {os_words(error)}"
        file = self._open()
        if fault:
            self.last_error = fault
            self._rotate_at = self._size + _RETRY_BYTES
        return file

    def _open(self) -> FileIO:
        if self._is_gone:  # a folder that is away as a whole, with its disk, may come back
            self._path.parent.mkdir(exist_ok=True)
        # Unbuffered: a line is the operating system's once `write` returns.
        self._file = file = self._path.open("ab", buffering=0)
        self._size, self._lines = os.fstat(file.fileno()).st_size, 0
        self._torn = False
        if self._size:  # a process that died may have left its last line half-written
            with self._path.open("rb") as handle:
                handle.seek(-1, os.SEEK_END)
                self._torn = handle.read(1) != b"\n"
        self._rotate_at = 1e6 * self._rotation.max_mb if self._rotation else math.inf
        return file


_MAX_WAITING = 1000
_PATIENCE_S = 1.0
_LINE_S = 0.1
_LOOK_S = 0.5  # between two looks at a file that nothing is written to


class LinesApart:
    """`JsonLines` that a thread of its own opens and writes: a disk that hangs holds nobody else.

    A line is waited for, as a process that is killed shall lose none, but for a moment only: those
    after it wait in memory, and where there is no more room they count as lost. ToktError if it
    turns out within a second that the file cannot be opened.
    """

    def __init__(
        self,
        path: Path | str,
        rotation: LogRotation | None = None,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._lines = JsonLines(path, rotation, later=True, tell=tell)
        self.header_lines = self._lines.header_lines
        self._fault: ToktError | None = None
        self._left_out = self._untold = self._given = self._written = 0
        self._waiting: queue.Queue[dict[str, Any] | int | None] = queue.Queue(_MAX_WAITING)
        self._opened = threading.Event()
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._write_all, name="tokt log", daemon=True)
        self._thread.start()
        self._wait_until_open()

    def _wait_until_open(self) -> None:
        self._opened.wait(_PATIENCE_S)
        if self._fault is not None:
            self._waiting.put(None)
            raise self._fault

    @property
    def failed(self) -> int:
        """Lines that could not be written."""
        return self._left_out + self._lines.failed

    @property
    def fault(self) -> str:
        """Why lines are not on the disk at present."""
        hangs = self._untold or not self._opened.is_set()
        return _HANGS if hangs else self._lines.fault

    @property
    def is_open(self) -> bool:
        """Whether the file is open."""
        return self._lines.is_open

    def look(self) -> None:
        """Do nothing: the writing thread checks the file."""

    def write(self, value: dict[str, Any]) -> None:
        """Have one line added, or count why not."""
        keeps_up = self._written == self._given
        try:
            if self._untold:
                self._waiting.put_nowait(self._untold)
                self._given, self._untold = self._given + 1, 0
            self._waiting.put_nowait(value)
            self._given += 1
        except queue.Full:
            self._untold += 1
            self._left_out += 1
        if keeps_up:
            with self._changed:
                self._changed.wait_for(lambda: self._written == self._given, _LINE_S)

    def close(self) -> None:
        """Close the file, after what still waits; not after a disk that hangs."""
        with contextlib.suppress(queue.Full):
            self._waiting.put_nowait(None)
        self._thread.join(_PATIENCE_S)
        self._left_out += self._given - self._written

    def _write_all(self) -> None:
        try:
            self._lines.open()
        except ToktError as error:
            self._fault = error  # after the second, each line tries again
        finally:
            self._opened.set()
        while (value := self._next()) is not None:
            if isinstance(value, int):
                self._lines.lose(value, _HANGS)
            else:
                self._lines.write(value)
            with self._changed:
                self._written += 1
                self._changed.notify()
        self._lines.close()

    def _next(self) -> dict[str, Any] | int | None:
        """What is to be written next; the file is looked after meanwhile."""
        while True:
            try:
                return self._waiting.get(timeout=_LOOK_S)
            except queue.Empty:
                self._lines.look()


def older_file(path: Path, number: int) -> Path:
    """The `number`-th file before `path`, from 1."""
    return path.with_name(f"{path.stem}.{number}{path.suffix}")


def rotate_files(path: Path, keep: int) -> None:
    """Make `path` the newest of at most `keep` older files, so that it is free.

    Where OSError says that a file cannot be renamed no line is lost, and the next call goes on.
    """
    if not path.exists():
        return
    numbers = range(1, keep + 1)
    free = next((n for n in numbers if not older_file(path, n).exists()), keep)
    for number in range(free, 1, -1):
        older_file(path, number - 1).replace(older_file(path, number))
    path.replace(older_file(path, 1))


@dataclass(frozen=True)
class LogGap:
    """A place in a log where something is missing."""

    file: Path
    line: int  # from 1
    words: str

    def __str__(self) -> str:
        return f"{self.file} line {self.line}: {self.words}"


def read_log(path: Path | str, gaps: list[LogGap] | None = None) -> Iterator[dict[str, Any]]:
    """Every whole line of a log, over its older files, oldest first.

    It may be written meanwhile: no line is left out or given twice as files step on. A last line
    that is not whole yet is left out.

    Parameters
    ----------
    path : Path or str
        The newest file's name.
    gaps : list of LogGap, optional
        Gets the damaged lines, and the places where lines could not be written, as they are met.

    Yields
    ------
    dict
        A frame's line or a heartbeat's, by the names of its fields.

    Raises
    ------
    ToktError
        If there is no such log, or it cannot be read.
    """
    path = Path(path)
    with ExitStack() as opened:
        with os_errors_as(f"log {path} cannot be read"):
            files = _open_together(path, opened)
        if not files:
            raise ToktError(f"log {path} does not exist")
        for name, file in reversed(files):
            for number, line in enumerate(file, 1):
                value, fault = _parsed(line)
                if value is not None:
                    yield value
                elif gaps is not None and (name != path or line.endswith(b"\n")):
                    gaps.append(LogGap(name, number, fault))


def _open_together(path: Path, opened: ExitStack) -> list[tuple[Path, BinaryIO]]:
    """The files, newest first, with no step to a next file while they were opened."""
    for _ in range(_TRIES):
        newest = file_id(path)
        with ExitStack() as trial:
            files = _open_all(path, trial)
            if file_id(path) == newest:
                opened.push(trial.pop_all())
                return files
    raise OSError("its files step on too fast")


def _open_all(path: Path, opened: ExitStack) -> list[tuple[Path, BinaryIO]]:
    """The files, newest first; one met twice, as it was just renamed, is taken once."""
    files: dict[tuple[int, int], tuple[Path, BinaryIO]] = {}
    for name in (path, *(older_file(path, number) for number in range(1, MAX_KEPT + 1))):
        try:
            file = opened.enter_context(name.open("rb"))
        except FileNotFoundError:
            continue
        status = os.fstat(file.fileno())
        files.setdefault((status.st_dev, status.st_ino), (name, file))
    return list(files.values())


def file_id(path: Path) -> tuple[int, int] | None:
    """Return what tells a file from any other that has its name later; None without one."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    return status.st_dev, status.st_ino


def _parsed(line: bytes) -> tuple[dict[str, Any] | None, str]:
    """The line's object, or why there is none."""
    try:
        value = json.loads(line.decode("utf-8"))
    except (ValueError, RecursionError):
        return None, "damaged"
    if not isinstance(value, dict):
        return None, "not a JSON object"
    if value.keys() == _LOST:
        return None, f"lines that could not be written here: {value['lost_lines']} ({value['why']})"
    return value, ""
