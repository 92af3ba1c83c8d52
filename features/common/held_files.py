"""Files as they were when a run began, held by its watchdog: a restart reads no other."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path

_held: dict[str, bytes] = {}
"""The content of each held file, by its path as the run's options have it."""
_listings: dict[str, bytes] = {}
"""What stands for the content of what is too large to hold, such as a folder of frames."""


def hold(files: Mapping[str, bytes], listings: Mapping[str, bytes]) -> None:
    """Let `file_bytes` give these contents, and `has_changed` compare these listings."""
    _held.update(files)
    _listings.update(listings)


def read_all(paths: Iterable[Path]) -> dict[str, bytes]:
    """Read files, by their paths; what cannot be read, or is no regular file, is left out."""
    contents = {}
    for path in paths:
        with suppress(OSError):
            if path.is_file():
                contents[str(path)] = path.read_bytes()
    return contents


def listing(path: Path) -> bytes:
    """Return names, sizes and times of a file, or of those in a folder; empty where it is gone."""
    with suppress(OSError):
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        stats = [(file.name, file.stat()) for file in files]
        return repr([(name, stat.st_size, stat.st_mtime_ns) for name, stat in stats]).encode()
    return b""


def file_bytes(path: Path | str, at_most: int = -1) -> bytes:
    """Return a file's content, as it was when the run began; OSError if it cannot be read.

    Of a file that is not held it reads `at_most` bytes, or all of them.
    """
    held = _held.get(str(path))
    if held is not None:
        return held
    with Path(path).open("rb") as file:
        return file.read(at_most)


def is_held(path: Path) -> bool:
    """Return whether `file_bytes` gives a file's content, be it gone meanwhile."""
    return str(path) in _held


def has_changed(path: Path) -> bool:
    """Return whether a folder of frames is another one than when the run began."""
    return str(path) in _listings and listing(path) != _listings[str(path)]


def changed_files() -> Iterator[str]:
    """Yield one line for each held file that is another one on the disk now, or gone."""
    for name, content in _held.items():
        try:
            changed = "has changed" if Path(name).read_bytes() != content else ""
        except OSError:
            changed = "is gone"
        if changed:
            yield f"{name} {changed} since the run began; the run keeps using the original"
