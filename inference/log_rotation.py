"""Names of a log's older files, and the step from one file to the next.

::

    run.jsonl     written now             run.jsonl    (new)
    run.1.jsonl   before it        ──>    run.1.jsonl  was run.jsonl
    run.2.jsonl   oldest                  run.2.jsonl  was run.1.jsonl; what was run.2.jsonl is gone

Each step is a rename, the oldest first: a process that is killed between two of them leaves a
number that no file has, and every line where it was.
"""

from __future__ import annotations

from pathlib import Path

MOST_KEPT = 99
"""Older files; their numbers have no more digits, so that ``run.2016.jsonl`` is none of them."""


def older_file(path: Path, number: int) -> Path:
    """The `number`-th file before `path`, from 1."""
    return path.with_name(f"{path.stem}.{number}{path.suffix}")


def every_name(path: Path) -> list[Path]:
    """All names that files of a log can have, newest first."""
    return [path, *(older_file(path, number) for number in range(1, MOST_KEPT + 1))]


def step(path: Path, keep: int) -> None:
    """Make `path` the newest of at most `keep` older files, so that it is free.

    Raises
    ------
    OSError
        If a file cannot be renamed. Then no line is lost, and the next call goes on.
    """
    if not path.exists():
        return
    numbers = range(1, keep + 1)
    free = next((n for n in numbers if not older_file(path, n).exists()), keep)
    for number in range(free, 1, -1):
        older_file(path, number - 1).replace(older_file(path, number))
    path.replace(older_file(path, 1))
