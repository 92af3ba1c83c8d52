"""The missions a workspace labelled, with marks of their frames: labels hold a name only.

``missions.json`` in the workspace::

    {"format": 1,
     "missions": {"dive": {"path": "/data/dive", "frames": {"left 1": "4711 0a1b2c3d"}}}}

``path`` is where the mission was when it was last labelled. ``frames`` are up to 50 of its frames,
each with its file's size in bytes and the CRC-32 of 4 KiB in the file's middle: uncompressed
pictures are all of one size. A video is kept as its frame 1.
"""

import json
import os
import re
import zlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tokt.features.common.atomic import write_text
from tokt.features.common.errors import FrameError, ToktError, check_format, os_errors_as
from tokt.features.frames.mission import LEFT, FolderMission, Mission

FILE_NAME = "missions.json"

FORMAT = 1
"""To change the format: raise this, keep reading the older ones, and prove it with a test."""

_MAX_FRAMES = 50
_MARK_BYTES = 4096
_FRAME = re.compile(r"(left|right) (\d{1,18})")


@dataclass(frozen=True)
class _Entry:
    path: str
    frames: dict[str, str]


def note_mission(workspace: Path, mission: Mission) -> None:
    """Note that the workspace's labels of this name belong to these frames.

    At the path noted before, any frames are taken: more are recorded, one is repaired. At another
    path they must be a copy: what is there of the frames noted before is the same, and that is one
    frame at least.

    Raises ToktError if the labels of this name belong to another dive, or the file is damaged, of a
    newer format or cannot be written.
    """
    entries = _read(workspace / FILE_NAME)
    _check(workspace, mission, entries.get(mission.name))
    entry = _Entry(str(mission.path.resolve()), _marks(mission))
    if entries.get(mission.name) != entry:
        # If two start at once the later one wins: the other mission is noted at its next start.
        _write(workspace / FILE_NAME, {**entries, mission.name: entry})


def check_mission(workspace: Path, mission: Mission) -> None:
    """Refuse a mission as `note_mission` does, and write nothing; one never noted is taken."""
    _check(workspace, mission, _read(workspace / FILE_NAME).get(mission.name))


def _check(workspace: Path, mission: Mission, entry: _Entry | None) -> None:
    if entry is None or entry.path == str(mission.path.resolve()):
        return
    both = [
        (noted, mark)
        for name, noted in entry.frames.items()
        if (mark := _mark(_file(mission, name))) is not None
    ]
    if not both or any(noted != mark for noted, mark in both):
        raise ToktError(
            f"the labels of mission {mission.name!r} in {workspace} belong to the frames in"
            f" {entry.path}; give another dive its own name (NAME=DIR) or another --workspace"
        )


def _marks(mission: Mission) -> dict[str, str]:
    """Marks of frames spread over the whole mission, by name."""
    names = [f"{LEFT} 1"]
    if isinstance(mission, FolderMission):
        names = [f"{camera} {n}" for camera in mission.cameras for n in mission.frames(camera)]
    n = min(len(names), _MAX_FRAMES)
    chosen = [names[i * len(names) // n] for i in range(n)]
    marks = {name: _mark(_file(mission, name)) for name in chosen}
    return {name: mark for name, mark in marks.items() if mark is not None}


def _file(mission: Mission, name: str) -> Path | None:
    if not isinstance(mission, FolderMission):
        return mission.path if name == f"{LEFT} 1" else None
    camera, _, frame = name.partition(" ")
    try:
        return mission.file(int(frame), camera)
    except FrameError:
        return None


def _mark(file: Path | None) -> str | None:
    if file is None:
        return None
    try:
        with file.open("rb") as opened:
            size = opened.seek(0, os.SEEK_END)
            opened.seek(max(0, (size - _MARK_BYTES) // 2))
            return f"{size} {zlib.crc32(opened.read(_MARK_BYTES)):08x}"
    except OSError:
        return None  # a frame that cannot be read, which pages say


def _read(file: Path) -> dict[str, _Entry]:
    try:
        value = json.loads(file.read_bytes())
        check_format(value["format"], FORMAT, str(file))
        return {name: _entry(entry) for name, entry in value["missions"].items()}
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise ToktError(f"{file}: {error.strerror or error}") from None
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise ToktError(
            f"{file} is damaged; without it missions are noted anew as they are labelled"
        ) from None


def _entry(value: Any) -> _Entry:
    path, frames = value["path"], value["frames"]
    texts = (path, *frames.values())
    if not all(isinstance(text, str) for text in texts) or not all(map(_FRAME.fullmatch, frames)):
        raise ValueError(value)
    return _Entry(path, dict(frames))


def _write(file: Path, entries: dict[str, _Entry]) -> None:
    missions = {name: asdict(entry) for name, entry in sorted(entries.items())}
    with os_errors_as(str(file)):
        write_text(file, json.dumps({"format": FORMAT, "missions": missions}, indent=1) + "\n")
