"""Files and folders that appear whole or not at all, whenever the process is killed."""

import errno
import math
import os
import shutil
import sys
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from .errors import UnavailableError, os_words

ABANDONED_S = 24 * 3600.0
"""A partial file or folder that old has no writer any more."""

OPEN_S = 2.0 if sys.platform == "win32" else 0.0
"""How long a rename waits for whoever has the file open: Windows refuses it meanwhile."""

_PARTIAL = ".partial-"
_POLL_S = 0.02
_FULL = {errno.ENOSPC, errno.EDQUOT}


class NotDurableError(OSError):
    """An error after a rename: the new content is in place, but a power cut may undo it."""


def _partial_name(target: Path) -> Path:
    return target.parent / f"{_PARTIAL}{uuid.uuid4().hex[:12]}-{target.name}"


def fsync_folder(folder: Path) -> None:
    """Make a rename inside `folder` durable, or raise NotDurableError; a no-op on Windows."""
    if os.name == "nt":
        return
    try:
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError as error:
        words = (
            f"{os_words(error)} as folder {folder.name} was synced; its new content is in place, "
        )
        raise NotDurableError(error.errno, words + "but a power cut may undo it") from None


def rename(old: Path, new: Path) -> None:
    """Give a file or a folder its name; a file that has it is replaced."""
    until = time.monotonic() + OPEN_S
    while True:
        try:
            old.replace(new)
            return
        except PermissionError:
            if time.monotonic() >= until:
                raise
        time.sleep(_POLL_S)


def write_bytes(target: Path, data: bytes, spare: Path | None = None, mode: int = 0o666) -> None:
    """Write `data` to `target` through a temporary name, synced, then renamed into place.

    Where the disk is full, `data` takes the place of `spare` (a file of `keep_spare` beside it),
    which becomes the target. `mode` says who may read and write it, less what the umask takes; on
    Windows nothing.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        with new_file(target, mode) as handle:
            handle.write(data)
    except OSError as error:
        # One that is too short was perhaps cut by a process that was killed here: it has its block.
        full = error.errno in _FULL and not isinstance(error, NotDurableError)
        if spare is None or not full or not spare.is_file():
            raise
        with spare.open("r+b") as handle:
            handle.write(data)
            handle.truncate()
            handle.flush()
            os.fsync(handle.fileno())
        rename(spare, target)
        fsync_folder(target.parent)


def write_text(target: Path, text: str, spare: Path | None = None, mode: int = 0o666) -> None:
    """`write_bytes` of UTF-8 text."""
    write_bytes(target, text.encode("utf-8"), spare, mode)


@contextmanager
def new_file(target: Path, mode: int = 0o666) -> Iterator[BinaryIO]:
    """Yield a file to write, which becomes `target` when the block ends without an exception."""
    partial = _partial_name(target)
    try:
        # Path.open takes no opener, and a file made first would be open to all for a moment.
        with open(partial, "wb", opener=lambda name, flags: os.open(name, flags, mode)) as handle:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        rename(partial, target)
    except BaseException:
        with suppress(OSError):  # the first error is the one to tell
            partial.unlink(missing_ok=True)
        raise
    fsync_folder(target.parent)


def keep_spare(spare: Path, least: int, size: int) -> None:
    """Keep `size` bytes on the disk in a file, for `write_bytes` when the disk is full.

    A file of fewer than `least` bytes is made anew. A file system that copies what is written over
    (Btrfs, ZFS) keeps no place by that.
    """
    if not spare.is_file() or spare.stat().st_size < least:
        write_bytes(spare, bytes(size))


@contextmanager
def scratch_folder(beside: Path) -> Iterator[Path]:
    """Yield an empty folder next to `beside`, gone when the block ends unless published."""
    beside.parent.mkdir(parents=True, exist_ok=True)
    partial = _partial_name(beside)
    partial.mkdir()
    try:
        yield partial
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def publish_folder(folder: Path, target: Path) -> None:
    """Sync every file in a scratch folder, then rename it to `target`, which must not exist."""
    for path in folder.rglob("*"):
        if path.is_file():
            with path.open("r+b") as handle:  # Windows syncs no file that is open for reading
                os.fsync(handle.fileno())
    rename(folder, target)
    fsync_folder(target.parent)


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """Yield an empty folder that becomes `target` when the block ends without an exception.

    Every file in it is synced before the rename, so `target` never holds half of its content.

    Raises FileExistsError if `target` is there already.
    """
    if target.exists():
        raise FileExistsError(target)
    with scratch_folder(target) as folder:
        yield folder
        publish_folder(folder, target)


def _modified_s(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except FileNotFoundError:  # its writer has finished meanwhile
        return math.inf


def remove_partials(folder: Path, older_than_s: float = 0.0) -> int:
    """Delete what a killed process left half-written in `folder`; return how many were found.

    What was begun less than `older_than_s` seconds ago is left: somebody may be writing it.
    """
    latest = time.time() - older_than_s
    found = list(folder.glob(f"{_PARTIAL}*")) if folder.is_dir() else []
    leftovers = [path for path in found if _modified_s(path) <= latest]
    for path in leftovers:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
    return len(leftovers)


if sys.platform == "win32":
    import msvcrt
else:
    import fcntl


def _take(handle: int) -> None:
    """Lock an open file, or raise BlockingIOError (on Windows PermissionError) where it is held."""
    if sys.platform == "win32":
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    else:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _give_back(handle: int) -> None:
    if sys.platform == "win32":
        msvcrt.locking(handle, msvcrt.LK_UNLCK, 1)
    else:
        fcntl.flock(handle, fcntl.LOCK_UN)


@contextmanager
def locked(file: Path, wait_s: float) -> Iterator[None]:
    """Hold the lock on `file`, which is made where it is missing.

    The operating system keeps the lock, so a killed process leaves none behind. Raises ToktError if
    another process keeps it longer than `wait_s` seconds.
    """
    deadline = time.monotonic() + wait_s
    with file.open("ab") as opened:
        handle = opened.fileno()
        while True:
            try:
                _take(handle)
                break
            except (BlockingIOError, PermissionError):
                if time.monotonic() > deadline:
                    raise UnavailableError(
                        f"{file.parent}: another tokt has been writing to it for {wait_s:g} s; "
                        "nothing was changed, try again"
                    ) from None
            time.sleep(_POLL_S)
        try:
            yield
        finally:
            _give_back(handle)
