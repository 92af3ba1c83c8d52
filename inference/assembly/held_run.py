"""A watched run as it began: its options and the files that verdicts depend on.

::

    watchdog: HeldRun ──pipe──> standard input of the runtime, at every start
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tokt.features.common.held_files import hold, read_all
from tokt.inference.config import RunConfig
from tokt.inference.monitoring.watchdog import LENGTH, WATCHDOG_VARIABLE

_STDIN = 0


@dataclass(eq=False)
class HeldRun:
    """What a run began with; for a process of the same program, over a pipe of its own."""

    options: dict[str, Any]  # by name, those that were given
    paths: tuple[Path, ...]  # files that are held as soon as they are there
    files: dict[str, bytes] = field(default_factory=dict)  # by absolute path

    @classmethod
    def of(cls, config: RunConfig, config_file: Path | None) -> HeldRun:
        """Hold a run of these options, which the command line and perhaps a file gave."""
        options = {name: config.value(name) for name in config.given} | {"watchdog": False}
        paths = (*filter(None, [config_file]), *_files_of(config))
        return cls(options, paths)

    def to_bytes(self) -> bytes:
        """Return it for `take_over`; a file that was not there before is read now."""
        missing = (path for path in self.paths if str(path.absolute()) not in self.files)
        self.files |= read_all(missing)
        return pickle.dumps((self.options, self.files))


def take_over() -> RunConfig | None:
    """Read what the watchdog holds from standard input: the options, and the files from now on.

    None where it holds nothing, or nobody watches. Raises EOFError if the watchdog has died.
    """
    if WATCHDOG_VARIABLE not in os.environ:
        return None
    (length,) = LENGTH.unpack(b"".join(_read(LENGTH.size)))
    if length == 0:
        return None
    options, files = pickle.loads(b"".join(_read(length)))  # of this user's own process
    hold(files)
    return RunConfig.of(options)


def _read(length: int) -> Iterator[bytes]:
    while length:
        data = os.read(_STDIN, length)
        if not data:
            raise EOFError("the watchdog has ended")
        length -= len(data)
        yield data


def _files_of(config: RunConfig) -> Iterable[Path]:
    """The files that verdicts depend on, as far as the options name files."""
    stereo, policy = config.stereo, config.policy
    named: list[Path | None] = [config.model.file, stereo.calibration, stereo.odometry]
    named += [config.model.shadow]
    named += [Path(text.split(":", 1)[-1]) for text in config.source.mask or []]
    if policy.anchor_from is not None:
        named.append(Path(policy.anchor_from.rpartition(":")[0]))
    return filter(None, named)
