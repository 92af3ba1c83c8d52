"""Files as they were when a run began, held by its watchdog: a restart reads no other."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path

_held: dict[str, bytes] = {}
"""The content of each held file, by its absolute path."""


def hold(files: Mapping[str, bytes]) -> None:
    """Let `file_bytes` give these contents, by their files' absolute paths."""
    _held.update(files)


def read_all(paths: Iterable[Path]) -> dict[str, bytes]:
    """Read files, by their absolute paths; those that cannot be read are left out."""
    contents = {}
    for path in paths:
        with suppress(OSError):
            contents[str(path.absolute())] = path.read_bytes()
    return contents


def file_bytes(path: Path | str, at_most: int = -1) -> bytes:
    """Return a file's content, as it was when the run began; OSError if it cannot be read.

    Of a file that is not held it reads `at_most` bytes, or all of them.
    """
    path = Path(path)
    held = _held.get(str(path.absolute())) if _held else None
    if held is not None:
        return held
    with path.open("rb") as file:
        return file.read(at_most)


def changed_files() -> Iterator[str]:
    """Yield one line for each held file that is another one on the disk now, or gone."""
    for name, content in _held.items():
        try:
            changed = "has changed" if Path(name).read_bytes() != content else ""
        except OSError:
            changed = "is gone"
        if changed:
            yield f"{name} {changed} since the run began, which goes on with what it began with"
