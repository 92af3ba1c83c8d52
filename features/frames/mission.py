"""A mission's frames on disk: a stereo folder, a flat folder, or a video file."""

import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterable
from functools import cached_property
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError, ToktError, counted, os_errors_as
from tokt.features.common.names import is_utf8, same_text

from .image_file import OTHER_PICTURES, SUFFIXES, check_bits, decode_image
from .numbering import Numbers, numbered_files
from .view_mask import CameraMasks, read_masks

LEFT, RIGHT = "left", "right"
VIDEO_SUFFIXES = frozenset({".mp4", ".avi", ".mkv", ".mov", ".mpg", ".mpeg", ".m4v", ".webm"})
_MAX_RANGE = 10_000_000  # frames; four days at 30 a second
_MARK_EVERY = 16  # frames; the pictures of these are compared after a seek
_FAR = 100  # frames from which a seek is faster than reading on
_BITS_16 = 16  # the last letter of FFmpeg's four for a pixel format of that many bits
_NAMED = re.compile(r"(\w[\w.-]*)=(.+)", re.DOTALL)


class Mission(Protocol):
    """One dive's frames. A frame is named by its camera and its number."""

    @property
    def name(self) -> str:
        """The mission's name, as label records carry it."""

    @property
    def path(self) -> Path:
        """The folder or file it was opened from."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """``("left", "right")`` or ``("left",)``."""

    @property
    def masks(self) -> CameraMasks:
        """What is no view in its cameras' pictures, by the file beside its frames."""

    def frames(self, camera: str = LEFT) -> list[int]:
        """Frame numbers of one camera, in the dive's order.

        Of a folder the order is that of the files' whole names: mostly the numbers', not always.
        """

    def place(self, frame: int) -> int:
        """Return the place of a frame of any camera in the dive, from 0."""

    def file_name(self, frame: int, camera: str = LEFT) -> str | None:
        """Return the whole name of a frame's own file, without folders; None where it has none."""

    def read(self, frame: int, camera: str = LEFT) -> U8:
        """One frame as the camera gave it: uint8, gray or BGR. Raises FrameError."""

    def encoded(self, frame: int, camera: str = LEFT) -> tuple[bytes, str]:
        """One frame as an image file that decodes to `read`'s pixels: (bytes, suffix)."""


def open_mission(path: Path | str, name: str | None = None) -> Mission:
    """Open a folder with ``Left/`` (and ``Right/``), a flat folder of images, or a video file.

    Parameters
    ----------
    path : Path or str
        As users give it, see `named_path`.
    name : str, optional
        The mission's name; by default the one given with the path, else the folder's or file's own.

    Raises
    ------
    ToktError
        If there is nothing there, or no image in it.
    """
    given, path = named_path(path)
    mission: FolderMission | VideoMission
    if path.is_file():
        if path.suffix.lower() not in VIDEO_SUFFIXES:
            if path.suffix.lower() in SUFFIXES:
                raise ToktError(f"{path} is one picture: give the folder that it is in")
            raise ToktError(f"{path} is neither a folder of frames nor a video file")
        mission = VideoMission(path)
    elif path.is_dir():
        mission = FolderMission(path)
    else:
        raise ToktError(f"mission {path} does not exist")
    mission.name = same_text(name or given or mission.name)
    return mission


def named_path(text: Path | str) -> tuple[str | None, Path]:
    """Read ``[NAME=]DIR``: the name, or None, and the path; what is there as written is a path."""
    path = Path(text)
    match = None if path.exists() else _NAMED.fullmatch(str(text))
    return (match[1], Path(match[2])) if match else (None, path)


class FolderMission:
    """A mission kept as one image file a frame."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.name = path.resolve().name
        self.passed_over: Counter[str] = Counter()  # pictures that cannot be read, by ending
        by_name = {child.name.lower(): child for child in path.iterdir() if child.is_dir()}
        # An empty Right/ is no camera: whoever takes its first frame would find none.
        pictures = {
            camera: files
            for camera in (LEFT, RIGHT)
            if camera in by_name and (files := self._pictures(by_name[camera]))
        }
        pictures = pictures or {LEFT: self._pictures(path)}
        if not pictures.get(LEFT):
            raise ToktError(
                f"mission {path} has no frames (looked for images in it and in Left/)"
                f"{'; it has ' if self.passed_over else ''}{self.passed_over_words()}"
            )
        self._found = pictures
        self._number()
        self.cameras = tuple(self._files)
        self.masks = read_masks(path)

    def _number(self, known: Numbers | None = None) -> None:
        numbered = numbered_files(self.path, self._found, known)
        self._files, self._places = numbered.by_camera, numbered.places

    @cached_property
    def _numbers(self) -> dict[tuple[str, str], int | None]:
        """Frame numbers by camera and file name, with and without its ending where that is one."""
        stems: dict[tuple[str, str], int | None] = {}
        names: dict[tuple[str, str], int | None] = {}
        for camera, files in self._files.items():
            for number, file in files.items():
                stem = camera, same_text(file.stem)
                stems[stem] = None if stem in stems else number
                names[camera, same_text(file.name)] = number
        return {**stems, **names}

    def keep_numbers(self, known: Numbers) -> None:
        """Give files the numbers by which their labels know them, and keep these beside the frames.

        Nothing is written where they have these numbers.
        """
        named = ((camera, file, n) for camera, some in known.items() for file, n in some.items())
        if any(self.number_of(file, camera) not in (None, n) for camera, file, n in named):
            self._number(known)
            del self._numbers

    def _pictures(self, folder: Path) -> list[Path]:
        """The image files of a folder."""
        found = []
        for path in folder.iterdir():
            suffix = path.suffix.lower()
            if path.name.startswith("."):
                continue
            if suffix in SUFFIXES:
                found.append(path)
            elif suffix in OTHER_PICTURES:
                self.passed_over[suffix] += 1
        names = Counter(same_text(path.name) for path in found)
        if twice := [name for name, times in names.items() if times > 1]:
            raise ToktError(f"{folder} has two files of one name, {twice[0]!r}: rename one")
        return found

    def passed_over_words(self) -> str:
        """Pictures of the folder that cannot be read, for people; empty where there are none."""
        if not self.passed_over:
            return ""
        endings = ", ".join(sorted(self.passed_over))
        what = counted(self.passed_over.total(), "picture")
        return f"{what} of a kind that tokt does not read ({endings}): convert to PNG"

    def place(self, frame: int) -> int:
        """Return the place of a frame in the dive, from 0, by the whole names of its files."""
        return self._places[frame]

    def file_name(self, frame: int, camera: str = LEFT) -> str | None:
        """The whole name of a frame's file, without folders; None where there is none."""
        file = self._files.get(camera, {}).get(frame)
        return same_text(file.name) if file is not None and is_utf8(file.name) else None

    def number_of(self, file_name: str, camera: str = LEFT) -> int | None:
        """The number of the frame that a file is; None where there is no such file.

        A picture that was converted, so that its name ends otherwise, is the same frame.
        """
        number = self._numbers.get((camera, same_text(file_name)))
        stem = camera, same_text(Path(file_name).stem)
        return self._numbers.get(stem) if number is None else number

    def file(self, frame: int, camera: str = LEFT) -> Path:
        """The image file of one frame. Raises FrameError if there is no such frame."""
        file = self._files.get(camera, {}).get(frame)
        if file is None:
            raise FrameError(f"mission {self.name} has no {camera} frame {frame}")
        return file

    def frames(self, camera: str = LEFT) -> list[int]:
        """Frame numbers of one camera, in the dive's order."""
        return list(self._files.get(camera, {}))

    def read(self, frame: int, camera: str = LEFT) -> U8:
        """One frame: uint8, gray (height, width) or BGR (height, width, 3)."""
        return decode_image(self.encoded(frame, camera)[0], str(self.file(frame, camera)))

    def encoded(self, frame: int, camera: str = LEFT) -> tuple[bytes, str]:
        """The frame's own file, untouched, and its suffix."""
        file = self.file(frame, camera)
        with os_errors_as(str(file), FrameError):
            return file.read_bytes(), file.suffix.lower()


class VideoMission:
    """A mission kept as a video of one camera; frames are numbered from 1 in file order."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.name = path.stem
        self.cameras = (LEFT,)
        self._open()
        self._prints: list[tuple[float, int | None]] = []  # of all frames read so far, see _grab
        self._seeks = True
        count = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if not self._capture.isOpened() or count < 1:
            raise ToktError(f"{path} is not a video that can be read")
        self._count = self._readable = count
        kind = int(self._capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT))
        self._has_16_bits = kind >> 24 == _BITS_16
        self.masks = read_masks(path)
        self.frames_per_second = float(self._capture.get(cv2.CAP_PROP_FPS)) or None

    def frames(self, camera: str = LEFT) -> list[int]:
        """Frame numbers 1..n; other cameras than ``"left"`` have none."""
        return list(range(1, self._count + 1)) if camera == LEFT else []

    def read(self, frame: int, camera: str = LEFT) -> U8:
        """One frame, BGR. Fast in order, and in steps back where the file can be sought in.

        Seeking by frame number is not exact for many codecs. So it goes only to frames that were
        read in order before, whose pictures and times are compared. Once one differs, this file
        is read from its start again: the same number is always the same picture.
        """
        if camera != LEFT or not 1 <= frame <= self._count:
            raise FrameError(f"mission {self.name} has no {camera} frame {frame}")
        known = self._seeks and frame <= len(self._prints)
        if frame < self._next or (known and frame > self._next + _FAR):
            self._rewind(frame)
        while self._next <= min(frame, self._readable):
            if self._grab():
                self._next += 1
            elif self._sought:
                self._seeks = False
                self._open()
            else:
                # What a further grab would give has lost its number.
                self._readable = self._next - 1
        good, image = self._capture.retrieve() if frame <= self._readable else (False, None)
        if not good or image is None:
            raise FrameError(f"{self.path}: frame {frame} cannot be decoded")
        if self._has_16_bits:
            check_bits(int(image.max()), f"{self.path}: frame {frame}")
        return np.asarray(image, np.uint8)

    def place(self, frame: int) -> int:
        """Return the place of a frame in the video, from 0."""
        return frame - 1

    def file_name(self, frame: int, camera: str = LEFT) -> str | None:
        """None: a video's frames have no files of their own."""
        return None

    def is_near(self, frame: int) -> bool:
        """Whether a frame can be had without reading much of the file first."""
        first = 1 if self._seeks else self._next
        return first <= frame <= len(self._prints) + _FAR

    def _open(self) -> None:
        self._capture = cv2.VideoCapture(str(self.path))
        self._next, self._sought = 1, False

    def _rewind(self, frame: int) -> None:
        mark = (frame - 1) // _MARK_EVERY * _MARK_EVERY + 1
        if self._seeks and mark > 1:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, mark - 1)
            self._next, self._sought = mark, True
        else:
            self._open()

    def _grab(self) -> bool:
        """Go on by one frame; whether there is one, and it is what it was when first read."""
        if not self._capture.grab():
            return False
        picture = None
        if self._next % _MARK_EVERY == 1:
            good, image = self._capture.retrieve()
            picture = zlib.crc32(np.asarray(image, np.uint8).data) if good else 0
        found = (self._capture.get(cv2.CAP_PROP_POS_MSEC), picture)
        if self._next > len(self._prints):
            self._prints.append(found)
        return self._prints[self._next - 1] == found

    def encoded(self, frame: int, camera: str = LEFT) -> tuple[bytes, str]:
        """The frame as a lossless PNG."""
        good, data = cv2.imencode(".png", self.read(frame, camera))
        if not good:
            raise FrameError(f"{self.path}: frame {frame} cannot be stored as PNG")
        return data.tobytes(), ".png"


def frame_size(
    mission: Mission, camera: str = LEFT, read: Callable[[int, str], U8] | None = None
) -> tuple[int, int]:
    """Width and height of a camera's first frame that can be read; ToktError if none can.

    `read` is by default the mission's own.
    """
    why = ""
    for frame in mission.frames(camera):
        try:
            image = (read or mission.read)(frame, camera)
        except FrameError as error:
            why = why or f": {error}"
            continue
        return image.shape[1], image.shape[0]
    raise ToktError(f"mission {mission.path}: no {camera} frame can be read{why}")


def chosen_frames(mission: Mission, asked: Iterable[int] | None, *cameras: str) -> list[int]:
    """Return the frames that some cameras have, or those asked for, in the dive's order.

    Raises ToktError if there is not each of these: it lists what there is.
    """
    there = {number for camera in cameras for number in mission.frames(camera)}
    wanted = there if asked is None else set(asked)
    if missing := wanted - there:
        has, lacks = format_frames(there), format_frames(missing)
        raise ToktError(f"mission {mission.name} has frames {has}, not {lacks}")
    return sorted(wanted, key=mission.place)


def parse_frames(text: str) -> list[int]:
    """The numbers of ``"1-99,132-246"``, sorted, unique; ToktError if a part is no rising range."""
    frames: set[int] = set()
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,19})\s*(?:-\s*(\d{1,19})\s*)?", part)
        if match is None or (match[2] and int(match[2]) < int(match[1])):
            raise ToktError(f"not a list of frames: {text!r} (write for example 1-99,132-246)")
        first, last = int(match[1]), int(match[2] or match[1])
        if last - first >= _MAX_RANGE:
            raise ToktError(f"frames {part.strip()}: too long a range for one mission")
        frames.update(range(first, last + 1))
    return sorted(frames)


def format_frames(frames: Iterable[int]) -> str:
    """The opposite of `parse_frames`: ``[1, 2, 3, 7]`` gives ``"1-3,7"``."""
    runs: list[list[int]] = []
    for frame in sorted(set(frames)):
        if runs and frame == runs[-1][1] + 1:
            runs[-1][1] = frame
        else:
            runs.append([frame, frame])
    return ",".join(str(a) if a == b else f"{a}-{b}" for a, b in runs)
