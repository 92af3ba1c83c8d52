"""tokt's texture model for pictures that are not the mission's: learnt from all its labels.

Held-out models (`held_out_texture`) judge the mission's own frames. A picture of somewhere else
may be judged by a model that learnt from every labelled frame; where the picture is a frame of
the mission after all, nothing within the embargo of it is learnt from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.features.extractors.extractor import Extractor
from tokt.inference.frame_checks import frame_fault
from tokt.models.linear import LinearModel
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.inputs import StudyInputs
from tokt.training.datasets.splits import EMBARGO_FRAMES
from tokt.training.fitting.classifier import fit_classifier, linear_model
from tokt.training.fitting.presets import (
    DEFAULT_EXTRACTOR,
    Hyperparameters,
    extractor_for,
    settings_named,
)
from tokt.training.rig.calibrate.frame_selection import evenly_spaced

from .curves import PRESET
from .patch_scores import Flags, truth_by_labels

_MAX_FRAMES = 60
"""Learnt from, spread over the labelled ones: neighbours in time are near copies."""
_PENALTY = 1.0
"""C; not searched for, as the picture judged is no part of the mission."""


@dataclass(frozen=True)
class AllLabelsTexture:
    """A texture model and what it learnt from.

    Parameters
    ----------
    words : str
    """

    words: str
    _extractor: Extractor
    _model: LinearModel

    def judge(self, frame: NDArray[np.uint8]) -> Flags | str:
        """Obstacle patches, bool (n_patches,), or why the frame cannot be judged."""
        fault = frame_fault(frame)
        if fault:
            return str(fault)
        values = self._model.decision_values(self._extractor.describe(frame, GRID))
        return self._model.obstacle_patches(values)


def train_on_all_labels(inputs: StudyInputs, near: int | None = None) -> AllLabelsTexture:
    """Learn from the mission's labelled frames.

    Parameters
    ----------
    inputs : StudyInputs
    near : int, optional
        A frame from which to stay away by more than the embargo.

    Raises
    ------
    ToktError
        If the labels do not show both obstacles and clear water.
    """
    numbers = [
        number
        for number in inputs.obstacle_patches
        if near is None or abs(number - near) > EMBARGO_FRAMES
    ]
    chosen = evenly_spaced(numbers, _MAX_FRAMES)
    settings = settings_named(PRESET)
    extractor = extractor_for(DEFAULT_EXTRACTOR, PRESET)
    rows, targets = [], []
    for number, frame in inputs.decoded(chosen):
        truth = truth_by_labels(inputs.truth(number))
        if truth is not None:
            rows.append(extractor.describe(frame, GRID)[truth.sure])
            targets.append(truth.obstacle[truth.sure].astype(np.int64))
    known = np.concatenate(targets) if targets else np.zeros(0, np.int64)
    if len(np.unique(known)) < 2:
        raise ToktError("there are no labels of both obstacles and clear water to learn from")
    pipeline = fit_classifier(np.vstack(rows), known, Hyperparameters(_PENALTY), settings)
    model = linear_model(pipeline, ("ocean", "obstacle"), (False, True))
    left_out = f", none within {EMBARGO_FRAMES} of frame {near}" if near is not None else ""
    words = (
        f"learnt from {len(rows)} labelled frames spread over the mission{left_out} (the features "
        f"of preset {PRESET}, C = {_PENALTY:g}, no search)"
    )
    return AllLabelsTexture(words, extractor, model)
