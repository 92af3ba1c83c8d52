"""Reading a mission's frames from several threads at once."""

import threading
from collections import OrderedDict
from contextlib import suppress
from weakref import WeakKeyDictionary

import cv2

from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError
from tokt.features.frames.mission import LEFT, Mission, VideoMission

KEPT_BYTES = 256 * 1024 * 1024
LOOK_BACK = 24
"""Frames before the wanted one that a step back keeps: going on so reads the file once in 25."""


def read_frame(mission: Mission, camera: str, frame: int) -> U8:
    """`Mission.read` for any number of threads, fast also in steps back. Raises FrameError."""
    if isinstance(mission, VideoMission) and camera == LEFT:
        return _kept(mission).read(mission, frame)
    return mission.read(frame, camera)


def is_near(mission: Mission, frame: int) -> bool:
    """Whether a frame can be had at once: a video has to be read up to it before."""
    return not isinstance(mission, VideoMission) or mission.is_near(frame)


def encoded_frame(mission: Mission, camera: str, frame: int) -> tuple[bytes, str]:
    """`Mission.encoded` for any number of threads, fast also in steps back. Raises FrameError."""
    if not isinstance(mission, VideoMission):
        return mission.encoded(frame, camera)
    good, data = cv2.imencode(".png", read_frame(mission, camera, frame))
    if not good:
        raise FrameError(f"{mission.path}: frame {frame} cannot be stored as PNG")
    return data.tobytes(), ".png"


def for_background(mission: Mission) -> Mission:
    """The mission that a thread which reads many frames in order should read from.

    A video knows one position: two readers of one would send each other back to its start. No
    frame of it is kept, as none is read twice.
    """
    if not isinstance(mission, VideoMission):
        return mission
    own = VideoMission(mission.path)
    with _kept_lock:
        _kept_of[own] = _KeptFrames(0)
    return own


class _KeptFrames:
    """Decoded frames of one video, the last used ones.

    It does not hold the video itself, whose life it would prolong. Frames that are kept, at most
    `max_bytes` of them together, are read while another thread waits for the file.
    """

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._frames: OrderedDict[int, U8] = OrderedDict()
        self._bytes = 0
        self._frames_lock = threading.Lock()
        self._last = 0  # that was asked of the file
        self._look_back = 0
        self._file_lock = threading.Lock()

    def read(self, video: VideoMission, frame: int) -> U8:
        """`VideoMission.read`."""
        image = self._get(frame)
        if image is None:
            with self._file_lock:
                image = self._get(frame)  # another thread may have read it meanwhile
                if image is None:
                    image = self._read_on(video, frame)
        return image.copy()

    def _read_on(self, video: VideoMission, frame: int) -> U8:
        if frame <= self._last:
            for before in range(max(1, frame - self._look_back), frame):
                if self._get(before) is None:
                    with suppress(FrameError):  # said when somebody asks for that frame
                        self._put(before, video.read(before))
        self._last = frame
        image = video.read(frame)
        self._put(frame, image)
        # What is read in one go must not push itself out, nor all of what was there.
        self._look_back = min(LOOK_BACK, self._max_bytes // image.nbytes // 2)
        return image

    def _get(self, frame: int) -> U8 | None:
        with self._frames_lock:
            if frame in self._frames:
                self._frames.move_to_end(frame)
            return self._frames.get(frame)

    def _put(self, frame: int, image: U8) -> None:
        with self._frames_lock:
            self._frames[frame] = image
            self._bytes += image.nbytes
            while self._bytes > self._max_bytes:
                self._bytes -= self._frames.popitem(last=False)[1].nbytes


_kept_of: WeakKeyDictionary[VideoMission, _KeptFrames] = WeakKeyDictionary()
_kept_lock = threading.Lock()


def _kept(video: VideoMission) -> _KeptFrames:
    with _kept_lock:
        if video not in _kept_of:
            _kept_of[video] = _KeptFrames(KEPT_BYTES)
        return _kept_of[video]
