"""Read a mission's frames from several threads at once."""

from __future__ import annotations

import threading
from contextlib import nullcontext
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ...features.mission import Mission, VideoMission, open_mission

_video_locks: WeakKeyDictionary[VideoMission, threading.Lock] = WeakKeyDictionary()
_locks_lock = threading.Lock()


def read_frame(mission: Mission, camera: str, frame: int) -> NDArray[np.uint8]:
    """`Mission.read`, one thread at a time where the mission is a video. Raises FrameError."""
    with _lock(mission):
        return mission.read(frame, camera)


def encoded_frame(mission: Mission, camera: str, frame: int) -> tuple[bytes, str]:
    """`Mission.encoded`, one thread at a time where the mission is a video. Raises FrameError."""
    with _lock(mission):
        return mission.encoded(frame, camera)


def for_background(mission: Mission) -> Mission:
    """What a thread that reads many frames in order should read from.

    A video knows one position: two readers of one would send each other back to its start.
    """
    return open_mission(mission.path) if isinstance(mission, VideoMission) else mission


def _lock(mission: Mission) -> threading.Lock | nullcontext[None]:
    if not isinstance(mission, VideoMission):
        return nullcontext()
    with _locks_lock:
        return _video_locks.setdefault(mission, threading.Lock())
