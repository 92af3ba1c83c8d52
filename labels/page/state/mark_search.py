"""The search for marks that never move, such as a clock, in a camera's pictures."""

import threading
from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from tokt.features.common.errors import ToktError
from tokt.features.extractors.frame_pictures import FramePictures
from tokt.features.frames.fixed_marks import FixedMarks
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.features.frames.mission import Mission
from tokt.labels.page.background import Background
from tokt.labels.page.frames import for_background, read_frame

PICTURES = 40
"""Spread over the dive: many more than `FEWEST_PICTURES`, and read in seconds."""


class MarkSearch:
    """Searches that run beside the page, one picture after the other. For any number of threads."""

    def __init__(self, mission: Mission, grid: Grid) -> None:
        self._given = mission
        self._mission: Mission | None = None
        self._grid = grid
        self._lock = threading.Lock()
        self._waiting: dict[str, tuple[FixedMarks, Iterator[int]]] = {}
        self._found: dict[str, list[int]] = {}
        self.background = Background("tokt-marks", self._step)

    def start(self, camera: str) -> None:
        """Search a camera's pictures, unless that is being done."""
        with self._lock:
            if camera in self._waiting:
                return
            frames = self._given.frames(camera)
            spread = np.linspace(0, len(frames) - 1, min(len(frames), PICTURES))
            chosen = (frames[at] for at in spread.round().astype(int))
            self._found.pop(camera, None)
            self._waiting[camera] = FixedMarks(), chosen
            if self._mission is None:
                self._mission = for_background(self._given)
                self.background.start()
        self.background.wake()

    def found(self, camera: str) -> list[int] | None:
        """The patches in which marks were found; None while they are being searched for."""
        with self._lock:
            return self._found.get(camera)

    def _step(self) -> bool:
        with self._lock:
            camera = next(iter(self._waiting), None)
        if camera is None or self._mission is None:
            return False
        marks, frames = self._waiting[camera]
        frame = next(frames, None)
        if frame is not None:
            with suppress(ToktError):  # it cannot be read: the others are enough
                picture = read_frame(self._mission, camera, frame)
                marks.add(FramePictures(picture, DEFAULT_GRID).rounded)
            return True
        patches = marks.patches(self._grid)
        with self._lock:
            self._found[camera] = np.flatnonzero(patches).tolist()
            del self._waiting[camera]
        return True
