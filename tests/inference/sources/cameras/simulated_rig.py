"""The simulated rig as tests see it: its controls, its pictures, and what comes from it."""

import ctypes
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tests.waiting import MAX_S, until
from tokt.inference.frame import Frame
from tokt.inference.report import Event
from tokt.inference.sources.cameras.capture import Capture
from tokt.inference.sources.cameras.live_source import CameraSource

FOLDERS = {"x86_64": "x86_64bit", "aarch64": "arm_64bit"}  # as pymba looks for them
WIDTH, HEIGHT, RATE_HZ = 64, 48, 50.0  # the simulator's own
LEFT_ID, RIGHT_ID = "DEV_000F31000001", "DEV_000F31000002"


class Simulator:
    """The simulated rig, ruled through its two extra symbols (vimba_simulator/control.c)."""

    def __init__(self, path: str) -> None:
        self._library = ctypes.CDLL(path)
        self._library.SimSet.argtypes = (ctypes.c_int, ctypes.c_char_p, ctypes.c_double)
        self._library.SimCount.argtypes = (ctypes.c_int, ctypes.c_char_p)
        self._library.SimCount.restype = ctypes.c_long
        self._library.SimFeature.argtypes = (ctypes.c_int, ctypes.c_char_p)
        self._library.SimFeature.restype = ctypes.c_double

    def reset(self) -> None:
        self._library.SimReset()

    def set(self, camera: int, **settings: float) -> None:
        for name, value in settings.items():
            assert self._library.SimSet(camera, name.encode(), float(value)) == 0, name

    def count(self, camera: int, name: str) -> int:
        counted = int(self._library.SimCount(camera, name.encode()))
        assert counted >= 0, name
        return counted

    def feature(self, camera: int, name: str) -> float:
        return float(self._library.SimFeature(camera, name.encode()))

    @property
    def opened(self) -> list[int]:
        return [self.count(camera, "opened") for camera in (0, 1)]


def pattern(camera: int, moment: int, size: int) -> NDArray[np.uint8]:
    """The bytes that vimba_simulator/pattern.c draws."""
    index = np.arange(size, dtype=np.uint64)
    drawn = ((131 * index + 17 * moment + 89 * camera) % 256).astype(np.uint8)
    drawn[:8] = [camera, *moment.to_bytes(7, "little")]
    return drawn


def seen(picture: NDArray[np.uint8]) -> tuple[int, int]:
    """Which camera and moment a picture is of; every byte of it must be of these."""
    raw = picture.reshape(-1)
    camera, moment = int(raw[0]), int.from_bytes(raw[1:8].tobytes(), "little")
    assert np.array_equal(raw, pattern(camera, moment, raw.size)), (camera, moment)
    return camera, moment


class Delivered:
    """Takes captures, on any thread."""

    def __init__(self) -> None:
        self.captures: list[Capture] = []

    def __call__(self, capture: Capture) -> None:
        self.captures.append(capture)

    def wait(self, count: int) -> list[Capture]:
        until(lambda: len(self.captures) >= count, lambda: f"{len(self.captures)} of {count}")
        return list(self.captures)


class Live:
    """An opened source, its events, and its frames one after the other."""

    def __init__(self, source: CameraSource, events: list[Event]) -> None:
        self.source = source
        self.events = events
        self._frames = iter(source)

    def take(self, count: int) -> list[Frame]:
        return [next(self._frames) for _ in range(count)]

    def until(self, wanted: Callable[[Frame], bool]) -> list[Frame]:
        """Frames up to the first that is wanted, which is the last of them."""
        frames, end = [], time.monotonic() + MAX_S
        while time.monotonic() < end:
            frames.append(next(self._frames))
            if wanted(frames[-1]):
                return frames
        raise AssertionError([(frame.left_fault, frame.right_fault) for frame in frames[-5:]])

    @property
    def event_names(self) -> list[tuple[str, str]]:
        return [(event.name, event.fields["camera"]) for event in self.events]
