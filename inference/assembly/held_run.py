"""A watched run as it began: its options and the files that verdicts depend on.

::

    watchdog: HeldRun ──pipe──> standard input of the runtime, at every start
"""

from __future__ import annotations

import os
import pickle
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tokt.features.common.held_files import hold, listing, read_all
from tokt.features.frames.mask_file import mask_file
from tokt.inference.config import OPTIONS, RunConfig
from tokt.inference.monitoring.watchdog import LENGTH, WATCHDOG_VARIABLE

_STDIN = 0
_PATIENCE_S = 1.0
"""Seconds that a start waits for a disk: a restart goes on with what is held already."""


@dataclass(eq=False)
class HeldRun:
    """What a run began with; for a process of the same program, over a pipe of its own."""

    options: dict[str, Any]  # by name, those that were given
    paths: tuple[Path, ...]  # files that are held as soon as they are there
    listings: dict[str, bytes]  # by path, what is too large to be held
    files: dict[str, bytes] = field(default_factory=dict)  # by path

    @classmethod
    def of(cls, config: RunConfig, config_file: Path | None) -> HeldRun:
        """Hold a run of these options, which the command line and perhaps a file gave."""
        # Whole paths: the folder that the program was started in may be gone at a restart.
        options = {name: _whole(name, config.value(name)) for name in config.given}
        config = RunConfig.of(options)
        sharp = config.model.sharp_frames
        listings = {} if sharp is None else {str(sharp): listing(sharp)}
        file = [] if config_file is None else [config_file.absolute()]
        return cls(options | {"watchdog": False}, (*file, *_files_of(config)), listings)

    def to_bytes(self) -> bytes:
        """Return it for `take_over`; a file that was not there before is read now."""
        missing = [path for path in self.paths if str(path) not in self.files]
        reading = threading.Thread(target=lambda: self.files.update(read_all(missing)), daemon=True)
        reading.start()
        reading.join(_PATIENCE_S)
        return pickle.dumps((self.options, dict(self.files), self.listings))


def take_over() -> RunConfig | None:
    """Read what the watchdog holds from standard input: the options, and the files from now on.

    None where it holds nothing, or nobody watches. Raises EOFError if the watchdog has died.
    """
    if WATCHDOG_VARIABLE not in os.environ:
        return None
    (length,) = LENGTH.unpack(b"".join(_read(LENGTH.size)))
    if length == 0:
        return None
    options, files, listings = pickle.loads(b"".join(_read(length)))  # of this user's own process
    hold(files, listings)
    return RunConfig.of(options)


def _read(length: int) -> Iterator[bytes]:
    while length:
        data = os.read(_STDIN, length)
        if not data:
            raise EOFError("the watchdog has ended")
        length -= len(data)
        yield data


def _whole(name: str, value: Any) -> Any:
    """Return an option's value with whole paths; what names no file stays as it is."""
    if OPTIONS[name].kind is Path and value is not None:
        # A model that comes with the package has a name alone.
        return value if name == "shadow" and not value.exists() else value.absolute()
    if name == "source" and Path(value).exists():
        return str(Path(value).absolute())
    if name == "mask" and value is not None:
        sides_and_paths = [_mask_path(text) for text in value]
        return [
            f"{side}{path.absolute()}" if path.is_file() else text
            for text, (side, path) in zip(value, sides_and_paths, strict=True)
        ]
    if name == "anchor_from" and value is not None:
        picture, _, box = value.rpartition(":")
        return f"{Path(picture).absolute()}:{box}" if Path(picture).is_file() else value
    return value


def _mask_path(text: str) -> tuple[str, Path]:
    """Return what a mask's text begins with, ``left:``, ``right:`` or nothing, and its path."""
    side = next((each for each in ("left:", "right:") if text.startswith(each)), "")
    return side, Path(text.removeprefix(side))


def _files_of(config: RunConfig) -> Iterable[Path]:
    """The files that verdicts depend on, as far as the options name files."""
    stereo, policy, source = config.stereo, config.policy, Path(config.source.source)
    named = [config.model.file, stereo.calibration, stereo.odometry, config.model.shadow]
    named += [_mask_path(text)[1] for text in config.source.mask or []]
    if policy.anchor_from is not None:
        named.append(Path(policy.anchor_from.rpartition(":")[0]))
    if mask_file(source).is_file():
        named.append(mask_file(source))
    return filter(None, named)
