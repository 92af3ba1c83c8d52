"""Frame statuses at an operating point against what the labels say the frames hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.models.operating_point import MofNRule
from tokt.training.datasets.dataset import DatasetVersion

from .frame_scores import KEYS, FrameScores, FrameTable, frame_table, windowed


def frame_figures(
    dataset: DatasetVersion,
    score: NDArray[np.float64],
    fold: NDArray[np.int64],
    rules: Sequence[MofNRule],
) -> dict[str, Any]:
    """False statuses and detections, each frame judged by its fold's rule.

    An *ocean frame* has every patch labelled, all of them clear. An *obstacle frame* has a patch
    labelled as an obstacle. Frames with neither are not judged, but count among the last frames
    of a k-of-n rule.

    Parameters
    ----------
    dataset : DatasetVersion
    score : array of float64, shape (n_patches,)
        `LinearModel.obstacle_score`; not looked at where the fold is -1.
    fold : array of int, shape (n_patches,)
        The fold a patch was tested in; -1 for none.
    rules : sequence of MofNRule
        One a fold.

    Returns
    -------
    dict
        ocean_frames, false_status, obstacle_frames, detected (counts); false_status_frames,
        missed_frames (obstacle frames without the status; ``mission:frame``); by mission,
        first_obstacle_frame and first_detection (the first of three frames in a row with the
        status, or None); latency_frames (the most that a fold's rule adds).
    """
    frames = frame_table(dataset)
    tested = fold >= 0
    of_frame = np.full(len(frames), -1)
    of_frame[frames.of_patch[tested]] = fold[tested]
    said = _statuses(FrameScores.of(frames, dataset, score, tested), of_frame, rules)
    judged = of_frame >= 0
    ocean, obstacle = frames.ocean & judged, (frames.obstacles > 0) & judged
    three = windowed(said[:, None].astype(np.float64), frames.place, 3, 3)[:, 0] == 1
    return {
        "ocean_frames": int(ocean.sum()),
        "false_status": int((ocean & said).sum()),
        "false_status_frames": frames.names(ocean & said),
        "obstacle_frames": int(obstacle.sum()),
        "detected": int((obstacle & said).sum()),
        "missed_frames": frames.names(obstacle & ~said),
        "first_obstacle_frame": _first(frames, obstacle),
        "first_detection": _first(frames, np.append(three[2:], [False, False])[: len(frames)]),
        "latency_frames": max(rule.latency_frames for rule in rules),
    }


def _statuses(
    scores: FrameScores, of_frame: NDArray[np.int64], rules: Sequence[MofNRule]
) -> NDArray[np.bool_]:
    """Whether each frame's status is obstacle by its fold's rule."""
    said = np.zeros(len(scores.frames), bool)
    for index, rule in enumerate(rules):
        # At a fold's first frames the last ones are of another fold's model.
        found = scores.statistic(rule.min_patches, rule.m, rule.n) > rule.margin
        if rule.instant_margin is not None:
            found |= scores.statistic(1, 1, 1) > rule.instant_margin
        said[of_frame == index] = found[of_frame == index]
    return said


def _first(frames: FrameTable, chosen: NDArray[np.bool_]) -> dict[str, int | None]:
    """The first chosen frame of each mission, of whichever camera."""
    marked = frames.keys[KEYS].assign(number=frames.keys.frame.where(chosen))
    first = marked.groupby("mission").number.min()
    return {str(name): None if np.isnan(at) else int(at) for name, at in first.items()}
