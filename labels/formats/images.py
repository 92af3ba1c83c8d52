"""A mission's frames as label files name them: by folder and file, by time, and in pixels."""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import NamedTuple
from urllib.parse import parse_qs, unquote, urlsplit

from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError, os_errors_as
from tokt.features.common.names import same_text
from tokt.features.frames.image_file import SUFFIXES
from tokt.features.frames.mission import LEFT, RIGHT, FolderMission, Mission, VideoMission

from .boxes import Size

_UPLOADED = re.compile(r"^(?=[0-9]*[a-f])[0-9a-f]{8}-")  # Label Studio's before an upload's name
_UPLOADS = re.compile(
    r"(.*/)?data/upload/\d+/(?:[0-9a-f]{8}-)?"
)  # the folder that it keeps them in
_LOCAL_FILE = "d"  # what names the file in the address of Label Studio's local storage
_HEADED = frozenset({".jpg", ".jpeg", ".png"})
_TURNED = range(5, 9)
"""Exif 2.32, orientation: values by which width and height change places."""
_ORIENTATION = 0x112
_PLAIN_FOLDERS = frozenset(
    {
        *("annotations", "data", "default", "frames", "image", "images", "img", "imgs"),
        *("jpegimages", "media", "obj_train_data", "test", "train", "training"),
        *("upload", "uploads", "val", "valid", "validation"),
    }
)
"""Folders that tools make for pictures of any dive: they say nothing of which one it is."""


class FrameKey(NamedTuple):
    """One frame of a mission."""

    camera: str
    frame: int


@dataclass(frozen=True)
class NamedFrame:
    """The frame that a file of another tool names, or the reason why there is none."""

    key: FrameKey | None = None
    folder: str = ""  # the dive that the name says, where that is another one than the mission
    remark: str = ""  # what of the name was passed over


class MissionImages:
    """File names and pixel sizes of a mission's frames.

    Parameters
    ----------
    mission : Mission
    name : str, optional
        Its name in label records; by default its own.
    folder : str, optional
        What label files call the mission's folder, besides its name and that of its folder.
    """

    def __init__(
        self, mission: Mission, name: str | None = None, folder: str | None = None
    ) -> None:
        self.mission = mission
        self.name = same_text(name or mission.name)
        self._names = _file_names(mission)
        self._sizes: dict[FrameKey | None, Size] = {}
        self._frames = {camera: mission.frames(camera) for camera in mission.cameras}
        self._positions = {
            FrameKey(camera, frame): position
            for camera, frames in self._frames.items()
            for position, frame in enumerate(frames)
        }
        path = mission.path.resolve()
        self._own_folder = _folded(path.name) if path.is_dir() else ""
        above = path
        while _folded(above.name) in (LEFT, RIGHT, *_PLAIN_FOLDERS):
            above = above.parent
        called = [self.name, mission.name, above.stem if self.is_video else above.name]
        self._folders = {_folded(each) for each in called} - _PLAIN_FOLDERS
        self._folders |= {_folded(folder)} if folder else set()
        self._by_name: dict[str, list[FrameKey]] = {}
        self._by_stem: dict[str, list[FrameKey]] = {}
        for key, file in self._names.items():
            file_name = _folded(file.rpartition("/")[2])
            self._by_name.setdefault(file_name, []).append(key)
            self._by_stem.setdefault(file_name.rpartition(".")[0], []).append(key)
        self._found: dict[str, NamedFrame] = {}

    @property
    def is_video(self) -> bool:
        """Whether the frames have no files of their own."""
        return self.mission.path.is_file()

    @property
    def frames_per_second(self) -> float | None:
        """The rate of a video, as its file says it."""
        mission = self.mission
        return mission.frames_per_second if isinstance(mission, VideoMission) else None

    def file_name(self, key: FrameKey) -> str | None:
        """The frame's file below the mission's folder, with ``/``; None for no such frame.

        Frames of a video have no file; they are called ``NAME_FRAME.png``.
        """
        return self._names.get(key)

    def find(self, text: str) -> NamedFrame:
        """Tell which frame a file of another tool calls `text`: a path, a URL or a bare name.

        The file's name decides, in any case of letters. A folder in it must be the mission's, or
        the camera's in it: a name such as ``dive_2/frame_1.jpg`` is of no other dive.
        """
        if text not in self._found:
            self._found[text] = self._find(text)
        return self._found[text]

    def _find(self, text: str) -> NamedFrame:
        paths = list(_paths(text))
        found = [self._find_path(*path) for path in paths]
        right = (each for each in found if each.key is not None)
        foreign = (each for each in found if each.folder)
        return next(right, None) or next(foreign, NamedFrame())

    def _find_path(self, folders: list[str], name: str) -> NamedFrame:
        for called in (name, _UPLOADED.sub("", name, count=1)):
            if keys := self._by_name.get(_folded(called)):
                exact = [key for key in keys if self._names[key].rpartition("/")[2] == called]
                return self._in_folders(exact or keys, folders)
        for called in (name, _UPLOADED.sub("", name, count=1)):
            stem, _, ending = _folded(called).rpartition(".")
            if keys := self._by_stem.get(stem if f".{ending}" in SUFFIXES else _folded(called)):
                found = self._in_folders(keys, folders)
                return replace(found, remark="whose names end otherwise than the frames' files")
        return NamedFrame()

    def _in_folders(self, keys: list[FrameKey], folders: list[str]) -> NamedFrame:
        """The frame, of those that have the file's name, that is in the folders."""
        above, own = [_folded(folder) for folder in folders], self._own_folder
        if above and above[-1] in (LEFT, RIGHT):
            camera = above.pop()
            if own in (LEFT, RIGHT):
                keys = keys if camera == own else []
            else:
                keys = [key for key in keys if key.camera == camera]
            if not keys:
                return NamedFrame(folder=folders[-1])
        plain = [folder for folder in above if folder in _PLAIN_FOLDERS - self._folders]
        while above and above[-1] in plain:
            above.pop()
        if above and above[-1] not in self._folders:
            return NamedFrame(folder=folders[len(above) - 1])
        if len(keys) > 1:
            return NamedFrame()
        told = plain and not above
        remark = f"in a folder {plain[-1]!r}, taken for the mission's" if told else ""
        return NamedFrame(keys[0], remark=remark)

    def at(self, camera: str, position: int) -> FrameKey | None:
        """The frame at a position of the camera's sequence, counted from 0."""
        frames = self._frames.get(camera, [])
        return FrameKey(camera, frames[position]) if 0 <= position < len(frames) else None

    def position(self, key: FrameKey) -> int:
        """The opposite of `at`."""
        return self._positions[key]

    def pixels(self, key: FrameKey) -> U8:
        """The frame as the camera gave it; raises FrameError."""
        return self.mission.read(key.frame, key.camera)

    def size(self, key: FrameKey) -> Size:
        """Height and width in pixels; raises FrameError.

        Frames may differ, so each file's header is read. A video's frames have one size.
        """
        if self.is_video and key not in self._names:
            raise FrameError(f"mission {self.name} has no {key.camera} frame {key.frame}")
        which = None if self.is_video else key
        if which not in self._sizes:
            self._sizes[which] = self._size_in_header(key) or Size(*self.pixels(key).shape[:2])
        return self._sizes[which]

    def _size_in_header(self, key: FrameKey) -> Size | None:
        """The size by the picture's header, turned as Exif says; None where it must be decoded."""
        if not isinstance(self.mission, FolderMission):
            return None
        file = self.mission.file(key.frame, key.camera)
        if file.suffix.lower() not in _HEADED or find_spec("PIL") is None:
            return None
        from PIL import Image

        try:
            with os_errors_as(str(file), FrameError), Image.open(file) as picture:
                width, height = picture.size
                turned = picture.getexif().get(_ORIENTATION) in _TURNED
        except (FrameError, Image.DecompressionBombError, SyntaxError, ValueError, struct.error):
            return None  # decoding it tells what is wrong
        return Size(width, height) if turned else Size(height, width)


def _folded(text: str) -> str:
    """Text by which names are compared: as files call each other on Windows, macOS and Linux."""
    return same_text(text).casefold()


def _paths(text: str) -> Iterator[tuple[list[str], str]]:
    """The folders and the file name that a text may say: as a URL, and as it stands."""
    texts = [text, unquote(text)] if "%" in text else [text]
    if "://" in text or "?" in text:
        try:
            address = urlsplit(text)
            local = parse_qs(address.query).get(_LOCAL_FILE, [])
            texts = [*local, unquote(address.path), *texts]
        except ValueError:  # such as of brackets without an end
            pass
    for each in texts:
        path = _UPLOADS.sub("", same_text(each).replace("\\", "/"), count=1)
        parts = [part for part in path.split("/") if part not in ("", ".", "..")]
        if parts:
            yield [part for part in parts[:-1] if not part.endswith(":")], parts[-1]


def _file_names(mission: Mission) -> dict[FrameKey, str]:
    keys = [FrameKey(camera, n) for camera in mission.cameras for n in mission.frames(camera)]
    if not isinstance(mission, FolderMission):
        return {key: f"{mission.name}_{key.frame:06d}.png" for key in keys}
    files = {key: mission.file(key.frame, key.camera) for key in keys}
    return {key: file.relative_to(mission.path).as_posix() for key, file in files.items()}
