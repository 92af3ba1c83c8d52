"""A recording on disk, and its room there: a mission folder for ``tokt label``, what was judged.

::

    DIR/<run>/Left/<run>_L_17.png      the picture that was judged, to the last bit
              Right/<run>_R_17.png     where there was a right one
              recording.jsonl          {"recording": 1, "run": ...}, then a line a frame, and events

A frame's line is that of the log (`frame_line`), and ``judged``: how many frames the run had judged
with it, so that consecutive numbers tell that none is left out between; ``moment``: the number of
its clip, whose frames were kept together; ``files``: its pictures' names by side.

Whatever happens to the process, each line's pictures are there and whole: pictures are written
before their line, and removed after it. Pictures without a line are those of a frame that was cut
off in between.
"""

import contextlib
import math
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2

from tokt.features.common.arrays import U8
from tokt.features.common.atomic import write_bytes
from tokt.features.common.errors import ToktError, check_format

from .log import LogGap, json_line, read_log

BLOCK_BYTES = 4096
_MARGIN_BYTES = 8 * BLOCK_BYTES
"""For what is not counted one by one: the heads of files of lines, and their last blocks."""


class DiskBudget:
    """Keep count of a folder that one process writes to, in megabytes (10^6 bytes).

    Its files come to `most_mb` at most, in whole blocks of 4 KiB, and `reserve_mb` stay free on its
    disk; ToktError where one is not a size.
    """

    def __init__(self, folder: Path, most_mb: float, reserve_mb: float) -> None:
        if not 0 < most_mb < math.inf or not 0 <= reserve_mb < math.inf:
            raise ToktError(f"{most_mb:g} MB with {reserve_mb:g} MB to spare is no limit")
        self._folder = folder
        self.most_bytes, self._reserve_bytes = 1e6 * most_mb, 1e6 * reserve_mb
        self.used_bytes = 0  # once it was counted

    def count(self) -> None:
        """Look at the disk: somebody may have taken something away."""
        self.used_bytes = 0
        for place, _, names in os.walk(self._folder):
            for name in names:
                with contextlib.suppress(OSError):  # taken away meanwhile
                    self.used_bytes += whole_blocks((Path(place) / name).stat().st_size)

    def lacking(self, size: int) -> float:
        """Bytes that have to go before so many more fit; 0 or less if they do."""
        return self.used_bytes + size + _MARGIN_BYTES - self.most_bytes

    def keeps_reserve(self, size: int) -> bool:
        """Whether the disk has its reserve after so many more; OSError if the folder is gone."""
        return shutil.disk_usage(self._folder).free - size >= self._reserve_bytes


def whole_blocks(size: int) -> int:
    """Bytes that a file of this size takes of the disk."""
    return -(-size // BLOCK_BYTES) * BLOCK_BYTES


RECORDING_FORMAT = 1
"""To change the format: raise this, keep reading the older ones, and prove it with a test."""

FILE_NAME = "recording.jsonl"
SIDES = {"left": ("Left", "L"), "right": ("Right", "R")}


@dataclass(frozen=True)
class EncodedFrame:
    """A frame as files."""

    clip: int
    files: Mapping[str, bytes]  # PNGs by their names within the folder
    lines: bytes  # the events before it and its own line
    told: int  # how many events were told before these

    @property
    def disk_bytes(self) -> int:
        """What it takes of the disk at most: lines count twice, as they are written anew beside
        the old ones when a clip is removed.
        """
        return sum(whole_blocks(len(data)) for data in self.files.values()) + 2 * len(self.lines)


class _WrittenFrame(NamedTuple):
    clip: int
    files: tuple[str, ...]
    lines_bytes: int
    told: int
    disk_bytes: int


class RecordingFolder:
    """One run's recording, ``DIR/<run>``, as it grows and as its oldest clips make room.

    The folder appears with the first frame.
    """

    def __init__(self, folder: Path, run: str) -> None:
        self.folder = folder
        self._file = folder / FILE_NAME
        self._run = run
        self._head = json_line({"recording": RECORDING_FORMAT, "run": run})
        self._events: list[bytes] = []
        self._written_events = 0
        self._kept: list[_WrittenFrame] = []
        self.lines_bytes = 0
        self.taken = 0  # frames that somebody took away, or deleted, with their recording

    def tell(self, line: Mapping[str, Any]) -> None:
        """Write an event's line before the next frame's."""
        self._events.append(json_line(line))

    def encode(
        self, number: int, clip: int, pictures: Mapping[str, U8], line: Mapping[str, Any]
    ) -> EncodedFrame:
        """A frame as files, in memory; ValueError if a picture cannot be a PNG.

        Each frame has a number of its own, and clips rise: frames of one are removed together.
        Pictures go by side, ``"left"`` and ``"right"``, those that are there.
        """
        self.look()
        files = {}
        for side, picture in pictures.items():
            folder, letter = SIDES[side]
            files[f"{folder}/{self._run}_{letter}_{number}.png"] = _png(picture)
        names = {Path(name).parent.name.lower(): name for name in files}
        whole = json_line({**line, "moment": clip, "files": names})
        told = self._written_events
        return EncodedFrame(clip, files, b"".join([*self._events[told:], whole]), told)

    def write(self, encoded: EncodedFrame) -> None:
        """Put a frame on disk, whole or not at all; OSError if the disk does not take it."""
        try:
            for name, data in encoded.files.items():
                write_bytes(self.folder / name, data)
            self._append(encoded.lines)
        except OSError:
            self._unlink(encoded.files)
            raise
        self._written_events = len(self._events)
        kept = (tuple(encoded.files), len(encoded.lines), encoded.told, encoded.disk_bytes)
        self._kept.append(_WrittenFrame(encoded.clip, *kept))

    def remove_oldest(self, wanted_bytes: float, clip: int) -> int:
        """Remove the oldest clips before `clip` until so much is free; what became free.

        Where OSError says that the lines cannot be written anew nothing is removed.
        """
        count = freed = 0
        for index, kept in enumerate(self._kept):
            begins = index == 0 or kept.clip != self._kept[index - 1].clip
            if begins and (freed >= wanted_bytes or kept.clip >= clip):
                break
            count, freed = index + 1, freed + kept.disk_bytes
        if count == 0:
            return 0
        gone, left = self._kept[:count], self._kept[count:]
        tail = self._file.read_bytes()[self.lines_bytes - sum(kept.lines_bytes for kept in left) :]
        told = left[0].told if left else self._written_events
        lines = b"".join([self._head, *self._events[:told], tail])
        write_bytes(self._file, lines)
        self._kept, self.lines_bytes = left, len(lines)
        for kept in gone:
            self._unlink(kept.files)
        return freed

    def look(self) -> None:
        """Begin anew where somebody has taken the recording away: what is left is theirs."""
        size = self._file.stat().st_size if self._file.exists() else 0
        if size != self.lines_bytes or size == 0:
            self.taken += len(self._kept)
            self._kept, self.lines_bytes, self._written_events = [], size, 0

    def _append(self, lines: bytes) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        data = lines if self.lines_bytes else self._head + lines
        with self._file.open("ab", buffering=0) as file:
            if os.fstat(file.fileno()).st_size != self.lines_bytes:
                # Taken away since `look`: what begins here would have no head.
                raise OSError(f"{self._file} was taken away")
            if file.write(data) != len(data):
                # A full disk takes a part only, and lets go of it.
                os.truncate(self._file, self.lines_bytes)
                raise OSError(f"{self._file}: no space left")
        self.lines_bytes += len(data)

    def _unlink(self, names: Iterable[str]) -> None:
        for name in names:
            (self.folder / name).unlink(missing_ok=True)


def read_recording(folder: Path, gaps: list[LogGap] | None = None) -> Iterator[dict[str, Any]]:
    """The lines of a recording, ``DIR/<run>``, frames' and events', in their order.

    `gaps` gets the damaged lines, as they are met. ToktError if the folder holds no recording, or
    one of a newer format.
    """
    path = folder / FILE_NAME
    if not path.is_file():
        raise ToktError(f"{folder} holds no recording (there is no {FILE_NAME} in it)")
    lines = read_log(path, gaps)
    version = next(lines, {}).get("recording")
    try:
        check_format(version, RECORDING_FORMAT, str(path))
    except ValueError:
        raise ToktError(f"{path} does not begin as a recording does") from None
    yield from lines


def _png(picture: U8) -> bytes:
    try:
        done, data = cv2.imencode(".png", picture)
    except cv2.error as error:
        raise ValueError(f"a picture of shape {picture.shape}: {error.err}") from None
    if not done:
        raise ValueError(f"a picture of shape {picture.shape} has no PNG")
    return data.tobytes()
