"""A mission's frames as label files name them: by image file, and in pixels."""

import re
from bisect import bisect_left
from pathlib import PurePosixPath
from typing import NamedTuple
from urllib.parse import unquote

from tokt.features.common.arrays import U8
from tokt.features.frames.mission import FolderMission, Mission

from .boxes import Size

_UPLOADED = re.compile(r"[0-9a-f]{8}-")  # what Label Studio puts before the name of an upload


class FrameKey(NamedTuple):
    """One frame of a mission."""

    camera: str
    frame: int


class MissionImages:
    """File names and pixel sizes of a mission's frames; `name` is its name in label records."""

    def __init__(self, mission: Mission, name: str | None = None) -> None:
        self.mission = mission
        self.name = name or mission.name
        self._names = _file_names(mission)
        self._sizes: dict[FrameKey, Size] = {}
        self._frames = {camera: mission.frames(camera) for camera in mission.cameras}
        self._by_name = _lookup(self._names)

    @property
    def is_video(self) -> bool:
        """Whether the frames have no files of their own."""
        return self.mission.path.is_file()

    def file_name(self, key: FrameKey) -> str | None:
        """The frame's file below the mission's folder, with ``/``; None for no such frame.

        Frames of a video have no file; they are called ``NAME_FRAME.png``.
        """
        return self._names.get(key)

    def find(self, text: str) -> FrameKey | None:
        """The frame that a file of another tool calls `text`: a path, a URL or a bare name."""
        path = unquote(text.rpartition("?d=")[2]).replace("\\", "/").lower()
        parts = PurePosixPath(path).parts[-2:]
        name = PurePosixPath(parts[-1] if parts else "")
        bare = PurePosixPath(_UPLOADED.sub("", name.name, count=1))
        forms = ("/".join(parts), name.name, name.stem, bare.name, bare.stem)
        return next((self._by_name[form] for form in forms if form in self._by_name), None)

    def at(self, camera: str, position: int) -> FrameKey | None:
        """The frame at a position of the camera's sequence, counted from 0."""
        frames = self._frames.get(camera, [])
        return FrameKey(camera, frames[position]) if 0 <= position < len(frames) else None

    def position(self, key: FrameKey) -> int:
        """The opposite of `at`."""
        return bisect_left(self._frames[key.camera], key.frame)

    def pixels(self, key: FrameKey) -> U8:
        """The frame as the camera gave it; raises FrameError."""
        return self.mission.read(key.frame, key.camera)

    def size(self, key: FrameKey) -> Size:
        """Height and width in pixels; raises FrameError. Frames may differ, so each is read."""
        if key not in self._sizes:
            self._sizes[key] = Size(*self.pixels(key).shape[:2])
        return self._sizes[key]


def _file_names(mission: Mission) -> dict[FrameKey, str]:
    keys = [FrameKey(camera, n) for camera in mission.cameras for n in mission.frames(camera)]
    if not isinstance(mission, FolderMission):
        return {key: f"{mission.name}_{key.frame:06d}.png" for key in keys}
    files = {key: mission.file(key.frame, key.camera) for key in keys}
    return {key: file.relative_to(mission.path).as_posix() for key, file in files.items()}


def _lookup(names: dict[FrameKey, str]) -> dict[str, FrameKey]:
    """Frames by path, by file name and by file name without ending, where these are unique."""
    forms: dict[str, set[FrameKey]] = {}
    for key, name in names.items():
        path = PurePosixPath(name.lower())
        for form in {str(path), path.name, path.stem, f"{key.camera}/{path.name}"}:
            forms.setdefault(form, set()).add(key)
    return {form: next(iter(keys)) for form, keys in forms.items() if len(keys) == 1}
