"""The suggester: a model's suggestions for a mission's frames, computed beside the page."""

import hashlib
import json
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tokt.features.common.arrays import F64, I64, U8, Bools
from tokt.features.common.atomic import write_bytes
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import Mission, VideoMission
from tokt.features.frames.view_mask import CameraMasks, ViewMask
from tokt.labels.page.background import Background
from tokt.labels.page.frames import for_background
from tokt.labels.page.masks import covered_frame
from tokt.models.bundle.bundle import Bundle
from tokt.models.frame_sizes import size_fault
from tokt.models.linear import LinearModel
from tokt.models.sight import SightLimits, sight_to_json

from .suggestion_table import (
    FrameSuggestions,
    MissionSuggestions,
    SuggestionTable,
    mission_stamp,
    no_suggestions,
)

_OTHER_CAMERA = 50  # frames; so much nearer the shown camera's frames are computed first
_SAVE_EVERY_S = 60.0

Sight = Callable[[Sequence[SightLimits], U8, ViewMask | None], Sequence[str]]
"""Says why each patch of a covered picture is not seen, by a model's limits and the picture's mask;
an empty string where it is seen."""


class Suggester:
    """A model's suggestions, frame by frame, `background` computing those near the one shown first.

    For any number of threads. They are kept in the folder `cache` for the next time: valid for this
    bundle, these masks and these files, by their size and time. One that cannot be written only
    costs time. What is masked, by default as the mission says, is covered and gets no suggestion.
    What is not seen, by `sight`, is not suggested as clear.

    Raises ToktError if the model looks at frames through another grid than the one labelled in.
    """

    def __init__(
        self,
        bundle: Bundle,
        mission: Mission,
        grid: Grid,
        cache: Path,
        masks: CameraMasks | None = None,
        sight: Sight | None = None,
    ) -> None:
        if bundle.grid != grid:
            raise ToktError(
                f"model {bundle.label} has the grid {bundle.grid}, labelled is {grid}: its"
                " suggestions would be of other patches"
            )
        self.bundle = bundle
        self._mission = mission
        self._masks = mission.masks if masks is None else masks
        self._sight = sight
        self._own_mission = for_background(mission)
        self._table = SuggestionTable(mission, grid.n_patches, bundle.extractor.dim)
        self._lock = threading.Lock()
        self._near: F64 = np.arange(len(self._table.names), dtype=np.float64)
        place = hashlib.sha256(f"{bundle.sha256}\n{mission.path.resolve()}".encode()).hexdigest()
        self._file = cache / f"suggestions-{place[:16]}.npz"
        self._key: str | None = None
        self._saved, self._saved_at = -1, 0.0
        self.background = Background("tokt-suggestions", self._step)

    @property
    def progress(self) -> tuple[int, int]:
        """How many frames are known, and of how many."""
        return self._table.done, len(self._table.names)

    def close(self) -> None:
        """Stop, and keep what is known."""
        self.background.close()
        self._save()

    def prefer(self, camera: str, frame: int) -> None:
        """Say which frame is shown."""
        index = self._table.position.get((camera, frame), 0)
        distance = np.asarray(self._table.places - float(self._table.places[index]))
        if isinstance(self._mission, VideoMission):
            # A step back would read the file from its start again.
            distance[distance < 0] += 2.0**32
        self._near = np.abs(distance) + _OTHER_CAMERA * (self._table.cameras != camera)

    def of(self, camera: str, frame: int) -> FrameSuggestions | None:
        """The suggestions of a frame, computed now if need be; None if there is no such frame."""
        index = self._table.position.get((camera, frame))
        if index is None:
            return None
        with self._lock:
            if self._table.knows(index):
                return self._table.get(index)
        return self._compute(index, self._mission)

    def known(self) -> MissionSuggestions:
        """Everything known so far."""
        with self._lock:
            return self._table.known(len(self.bundle.model.classes) > 2)

    def faults(self) -> dict[tuple[str, int], str]:
        """Why each frame that the model could not judge so far has no suggestions."""
        with self._lock:
            return self._table.faults()

    def _step(self) -> bool:
        if self._saved < 0:
            self._load()
        to_do = self._table.to_do
        if not to_do.any():
            self._save()
            return False
        self._compute(int(np.where(to_do, self._near, np.inf).argmin()), self._own_mission)
        if time.monotonic() > self._saved_at + _SAVE_EVERY_S:
            self._save()
        return True

    def _compute(self, index: int, mission: Mission) -> FrameSuggestions:
        camera, frame = self._table.names[index]
        features = None
        try:
            image = covered_frame(mission, self._masks, camera, frame)
            height, width = image.shape[:2]
            found = no_suggestions(size_fault(height, width, self.bundle.frame_sizes))
            if not found.fault:
                grid, size = self.bundle.grid, image.shape[:2]
                features = self.bundle.extractor.describe(image, grid)
                found = suggestions(self.bundle.model, self.bundle.values_alone(features))
                masked = self._masks.patches(camera, grid, *size).reshape(-1)
                unknown = self._unknown(found.classes, image, self._masks.of(camera))
                found.values[masked | unknown] = np.nan
                features = features[~masked]
        except (ToktError, ValueError) as error:  # unreadable, or nothing the model can judge
            found, features = no_suggestions(str(error)), None
        with self._lock:
            self._table.put(index, found, features)
        return found

    def _unknown(self, classes: I64, image: U8, mask: ViewMask | None) -> Bools:
        """The patches that the model calls clear, though nobody can see what is there."""
        unseen = np.zeros(len(classes), bool)
        if self._sight is not None:
            unseen = np.array(self._sight(self.bundle.sight, image, mask)) != ""
        return np.asarray(unseen & ~np.array(self.bundle.model.obstacle)[classes])

    def _load(self) -> None:
        self._saved, self._saved_at = 0, time.monotonic()
        masks = json.dumps(self._masks.to_json()) if self._masks else ""
        # A model may run with the sight of another camera.
        sight = hashlib.sha256(json.dumps(sight_to_json(self.bundle.sight)).encode()).hexdigest()
        self._key = f"{self.bundle.sha256} {sight} {mission_stamp(self._mission)}{masks}"
        with self._lock:
            # What a page asked for meanwhile is in the file or will be computed again.
            if self._table.load(self._file, self._key):
                self._saved = self._table.done

    def _save(self) -> None:
        self._saved_at = time.monotonic()
        with self._lock:
            if self._key is None or self._table.done == self._saved:
                return
            self._saved = self._table.done
            data = self._table.to_bytes(self._key)
        try:
            write_bytes(self._file, data)
        except OSError:
            self._key = None  # no space or no permission: computed again next time


def suggestions(model: LinearModel, values: F64) -> FrameSuggestions:
    """A model's classes and margins for the patches of one frame.

    Parameters
    ----------
    model : LinearModel
    values : array of float64, shape (n_patches, n_outputs)
        Their decision values.
    """
    classes = model.predicted(values)
    excess = values - model.thresholds
    if excess.shape[1] == 1:
        margins = np.abs(excess[:, 0])
    else:
        best = np.sort(excess, axis=1)[:, -2:]
        margins = best[:, 1] - best[:, 0]
    return FrameSuggestions(classes, margins)
