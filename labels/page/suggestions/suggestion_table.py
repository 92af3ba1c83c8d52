"""The table of a model's suggestions, kept in a file between runs of the server."""

import hashlib
import io
import json
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, F64, I64, Bools
from tokt.features.frames.mission import FolderMission, Mission

FORMAT = 2
_TO_DO, _JUDGED, _FAULTY = range(3)
_UNREADABLE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile)


@dataclass(frozen=True)
class FrameSuggestions:
    """A model's suggestions for one frame."""

    classes: I64  # (n_patches,): index into the model's classes
    # (n_patches,): how far the decision is on the side of that class, 0 and more: with two classes
    # the distance to the threshold, with more the lead over the second best. NaN where masked,
    # or where the class is clear and the patch is not seen: nothing is suggested there.
    values: F64
    fault: str = ""  # why there are no suggestions, the arrays being empty; or an empty string


@dataclass(frozen=True)
class MissionSuggestions:
    """Suggestions of all frames judged so far; row i of each array is frame i."""

    cameras: NDArray[np.str_]
    frames: I64
    values: F64  # (n, n_patches): as in `FrameSuggestions`
    features: F32  # (n, 2 * dim): mean and standard deviation of each over the patches in view
    several: bool = False  # whether the model has more than two classes
    # Where each frame number comes in the dive; a number that is not there is its own place.
    place_of: Mapping[int, int] = field(default_factory=dict)

    def places(self, frames: Iterable[int]) -> I64:
        """Return the places of frames in the dive."""
        return np.array([self.place_of.get(frame, frame) for frame in frames], np.int64)


class SuggestionTable:
    """Suggestions of a mission's frames, as far as they are known. Not for several threads."""

    def __init__(self, mission: Mission, n_patches: int, dim: int) -> None:
        every = [(camera, frame) for camera in mission.cameras for frame in mission.frames(camera)]
        self.names = every
        self.position = {name: index for index, name in enumerate(every)}
        self.cameras = np.array([camera for camera, _ in every])
        self.frames = np.array([frame for _, frame in every], np.int64)
        self._place_of = {frame: mission.place(frame) for _, frame in every}
        self.places = np.array([self._place_of[frame] for _, frame in every], np.int64)
        self.done = 0
        self._states = np.full(len(every), _TO_DO, np.uint8)
        self._classes = np.zeros((len(every), n_patches), np.int16)
        self._values = np.zeros((len(every), n_patches))
        self._features = np.zeros((len(every), 2 * dim), np.float32)
        self._faults: dict[int, str] = {}

    @property
    def to_do(self) -> Bools:
        """Which frames are not known yet."""
        return np.asarray(self._states == _TO_DO)

    def knows(self, index: int) -> bool:
        """Whether a frame is known, by its place in `names`."""
        return bool(self._states[index] != _TO_DO)

    def put(self, index: int, found: FrameSuggestions, features: F64 | None) -> None:
        """Keep what the model said of a frame; `features` of its patches in view, or None."""
        self.done += not self.knows(index)
        if found.fault or features is None:
            self._faults[index] = found.fault
            self._states[index] = _FAULTY
            return
        self._classes[index], self._values[index] = found.classes, found.values
        self._features[index] = np.concatenate([features.mean(axis=0), features.std(axis=0)])
        self._states[index] = _JUDGED

    def get(self, index: int) -> FrameSuggestions:
        """The suggestions of a frame that is known."""
        if self._states[index] == _FAULTY:
            return no_suggestions(self._faults[index])
        return FrameSuggestions(self._classes[index].astype(np.int64), self._values[index].copy())

    def faults(self) -> dict[tuple[str, int], str]:
        """Why each frame that cannot be judged has no suggestions, by its camera and number."""
        return {self.names[index]: fault for index, fault in self._faults.items()}

    def known(self, several: bool) -> MissionSuggestions:
        """A copy of everything known, without faulty frames."""
        known = self._states == _JUDGED
        return MissionSuggestions(
            self.cameras[known],
            self.frames[known],
            self._values[known],
            self._features[known],
            several,
            self._place_of,
        )

    def to_bytes(self, key: str) -> bytes:
        """Everything judged, as a file that `load` reads with the same key.

        Faulty frames are not in it: what could not be read once may be read the next time.
        """
        texts = json.dumps({"format": FORMAT, "key": key}).encode("utf-8")
        states = np.where(self._states == _JUDGED, self._states, np.uint8(_TO_DO))
        arrays = {**self._arrays(), "states": states}
        buffer = io.BytesIO()
        np.savez(buffer, texts=np.frombuffer(texts, np.uint8), **arrays)
        return buffer.getvalue()

    def load(self, path: Path, key: str) -> bool:
        """Take over what `to_bytes` wrote with the same key; False where there is no such thing.

        Any other content, or a damaged file, is as good as none: all of it can be computed.
        """
        own = self._arrays()
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in ("texts", *own)}
            texts = json.loads(arrays.pop("texts").tobytes())
            if (texts["format"], texts["key"]) != (FORMAT, key):
                return False
        except (*_UNREADABLE, TypeError, AttributeError):
            return False
        fits = all(
            (array.shape, array.dtype) == (own[name].shape, own[name].dtype)
            for name, array in arrays.items()
        )
        if not fits or not np.isin(arrays["states"], (_TO_DO, _JUDGED)).all():
            return False
        for name, array in arrays.items():
            own[name][...] = array
        self._faults.clear()
        self.done = int((self._states != _TO_DO).sum())
        return True

    def _arrays(self) -> dict[str, Any]:
        return {
            "states": self._states,
            "classes": self._classes,
            "values": self._values,
            "features": self._features,
        }


def no_suggestions(fault: str) -> FrameSuggestions:
    """The suggestions of a frame that cannot be judged: none, and why."""
    return FrameSuggestions(np.zeros(0, np.int64), np.zeros(0), fault)


def mission_stamp(mission: Mission) -> str:
    """A hash of the names, sizes and times of a mission's frames: other files, other stamp.

    Nothing else in its folder counts: a workspace in it changes with every label.
    """
    files = [mission.path]
    if isinstance(mission, FolderMission):
        names = ((frame, camera) for camera in mission.cameras for frame in mission.frames(camera))
        files = [mission.file(*name) for name in names]
    stamps = "\n".join(f"{file.relative_to(mission.path)}\0{_state(file)}" for file in files)
    return hashlib.sha256(stamps.encode("utf-8", "surrogateescape")).hexdigest()


def _state(file: Path) -> str:
    try:
        stat = file.stat()
    except OSError:
        return ""  # a frame that cannot be read, which pages say
    return f"{stat.st_size}\0{stat.st_mtime_ns}"
