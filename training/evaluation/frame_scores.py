"""The frames of a dataset: one number each from its patches' scores, and statuses by a rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from tokt.features.common.arrays import F64, I64, Bools
from tokt.inference.texture.detector import min_mask_patches
from tokt.models.operating_point import (
    CLEAR,
    MAX_WINDOW,
    OBSTACLE,
    MofNRule,
    frame_step,
    missed_before,
)
from tokt.training.datasets.dataset import DIVE_ORDER, FRAME_KEY, DatasetVersion

from .approaches import KnownDistances, approach_figures, approaches, false_status_per_hour


@dataclass(frozen=True)
class FrameTable:
    """The labelled frames of a dataset, by mission, camera and number."""

    keys: pd.DataFrame  # columns mission, camera, frame, group, position; one row a frame
    of_patch: I64  # (n_patches,): row of `keys` for each patch of the dataset
    obstacles: I64  # (n_frames,): patches labelled as an obstacle
    # (n_frames,): every patch is labelled, as clear. Never so in a dataset of single patches.
    ocean: Bools
    min_mask_patches: I64  # (n_frames,): of the detector's function of that name
    # (n_frames,): counts frames as they followed each other: 1 more than the frame before where
    # none is missing in between, and far from it in another mission or camera.
    place: I64

    def __len__(self) -> int:
        return len(self.keys)


def frame_names(frames: pd.DataFrame) -> list[str]:
    """``mission:frame`` of rows with `FRAME_KEY`; with the camera where it is not the left one."""
    return [
        f"{mission}:{frame}" if camera == "left" else f"{mission}:{camera}:{frame}"
        for mission, camera, frame in frames[FRAME_KEY].itertuples(index=False, name=None)
    ]


def frame_table(dataset: DatasetVersion) -> FrameTable:
    """The frames of a dataset."""
    grouped = dataset.patches.assign(obstacle=dataset.obstacles()).groupby(DIVE_ORDER)
    of_patch = grouped.ngroup().to_numpy(np.int64)
    found = grouped.agg(
        obstacles=("obstacle", "sum"), n=("obstacle", "size"), group=("group", "first")
    ).reset_index()
    grid = dataset.grid
    view = [dataset.patches_in_view(index) for index in range(len(dataset.frames))]
    sizes = dataset.frames.assign(view=view).drop_duplicates(FRAME_KEY).set_index(FRAME_KEY)
    sizes = sizes.loc[pd.MultiIndex.from_frame(found[FRAME_KEY]), ["height", "width", "view"]]
    whole = (found.n == sizes.pop("view").to_numpy()) & (dataset.block_frames is not None)
    least = cache(lambda *size: min_mask_patches(grid, *grid.resized(*size)))
    return FrameTable(
        found[[*FRAME_KEY, "group", "position"]],
        of_patch,
        found.obstacles.to_numpy(np.int64),
        (whole & (found.obstacles == 0)).to_numpy(bool),
        np.array([least(*size) for size in sizes.itertuples(index=False, name=None)], np.int64),
        _places(found),
    )


def _places(found: pd.DataFrame) -> I64:
    places, last = np.zeros(len(found), np.int64), -MAX_WINDOW
    for rows in found.groupby(["mission", "camera"]).indices.values():
        positions = found.position.to_numpy()[rows].tolist()
        missed = np.asarray(missed_before(positions, frame_step(positions)), np.int64)
        # More missing frames than any window holds are as good as that many.
        steps = 1 + np.minimum(missed, MAX_WINDOW)
        places[rows] = last + MAX_WINDOW + np.cumsum(steps)
        last = places[rows[-1]]
    return places


@dataclass(frozen=True)
class FrameScores:
    """The obstacle scores of a dataset's patches, frame by frame."""

    frames: FrameTable
    scores: F64  # (n_frames, n_patches), by place in the grid; -inf where a patch was not tested
    tested: Bools  # (n_frames,)

    @classmethod
    def of(
        cls, frames: FrameTable, dataset: DatasetVersion, score: F64, tested: Bools
    ) -> FrameScores:
        """Lay out one score a patch; see `choose_frame_rule`."""
        scores = np.full((len(frames), dataset.grid.n_patches), -np.inf)
        cell = (dataset.patches.row * dataset.grid.cols + dataset.patches.col).to_numpy()
        scores[frames.of_patch[tested], cell[tested]] = score[tested]
        judged = np.zeros(len(frames), bool)
        judged[frames.of_patch[tested]] = True
        return cls(frames, scores, judged)

    def of_some(self, chosen: Bools) -> FrameScores:
        """The same, as if only these frames had been tested."""
        tested = self.tested & chosen
        return FrameScores(self.frames, np.where(tested[:, None], self.scores, -np.inf), tested)

    def statistic(self, least_patches: int, hits: int, window: int) -> F64:
        """The value a margin must stay below for an obstacle status, shape (n_frames,).

        The `least_patches`-th largest, over the patches, of the `hits`-th largest of a patch's
        last `window` scores: `MofNState` calls an obstacle exactly where it exceeds the
        margin. -inf where there are too few; a frame that is missing exceeds nothing.
        """
        confirmed = windowed(self.scores, self.frames.place, hits, window)
        needed = np.maximum(least_patches, self.frames.min_mask_patches)
        found = np.full(len(self.frames), -np.inf)
        enough = (needed <= confirmed.shape[1]) & self.tested
        ranked = -np.sort(-confirmed[enough], axis=1)
        found[enough] = ranked[np.arange(len(ranked)), needed[enough] - 1]
        return found


def windowed(values: F64, place: I64, hits: int, window: int) -> F64:
    """The `hits`-th largest of the values in each frame and the `window` - 1 places before it.

    Column by column, of values (n_frames, n_columns). Places are those of `FrameTable`; where they
    are without a frame they hold -inf.
    """
    if window == 1 or not len(values):
        return values
    line = np.full((int(place[-1] - place[0]) + window, values.shape[1]), -np.inf)
    at = place - place[0] + window - 1
    line[at] = values
    last = np.stack([line[at - back] for back in range(window)])
    return np.asarray(np.sort(last, axis=0)[window - hits])


def frame_figures(
    dataset: DatasetVersion, score: F64, fold: I64, rules: Sequence[MofNRule]
) -> dict[str, Any]:
    """False statuses and detections, each frame judged by its fold's rule.

    An *ocean frame* has every patch labelled, all of them clear. An *obstacle frame* has a patch
    labelled as an obstacle. Frames with neither are not judged, but count among the last frames
    of a frame rule.

    Given are of each patch, (n_patches,), `LinearModel.obstacle_score` and the fold it was tested
    in, -1 for none, and of each fold a rule. Found are ocean_frames, false_status, obstacle_frames,
    detected (counts); false_status_frames, missed_frames (obstacle frames without the status;
    ``mission:frame``); by mission, first_obstacle_frame and first_detection (the first of three
    frames in a row with the status, or None; not of single pictures); latency_frames (the most that
    a fold's rule adds); approaches (`approach_figures`, with mission and camera) and
    false_status_per_hour.
    """
    frames = frame_table(dataset)
    tested = fold >= 0
    of_frame = np.full(len(frames), -1)
    of_frame[frames.of_patch[tested]] = fold[tested]
    scores, said = FrameScores.of(frames, dataset, score, tested), np.zeros(len(frames), bool)
    for index, rule in enumerate(rules):
        # At a fold's first frames the last ones are of another fold's model.
        found = scores.statistic(rule.min_patches, rule.m, rule.n) > rule.margin
        if rule.instant_margin is not None:
            found |= scores.statistic(1, 1, 1) > rule.instant_margin
        said[of_frame == index] = found[of_frame == index]
    judged = of_frame >= 0
    ocean, obstacle = frames.ocean & judged, (frames.obstacles > 0) & judged
    keys = frames.keys[["mission", "position"]].itertuples(index=False, name=None)
    blocks = np.array([dataset.independent_block(*key) for key in keys], object)
    three = windowed(said[:, None].astype(np.float64), frames.place, 3, 3)[:, 0] == 1
    followed_by_two = np.append(three[2:], [False, False])[: len(frames)]
    return {
        "ocean_frames": int(ocean.sum()),
        "false_status": int((ocean & said).sum()),
        "false_status_frames": frame_names(frames.keys[ocean & said]),
        "obstacle_frames": int(obstacle.sum()),
        "detected": int((obstacle & said).sum()),
        "missed_frames": frame_names(frames.keys[obstacle & ~said]),
        "first_obstacle_frame": _first(frames, obstacle),
        "first_detection": {
            mission: frame
            for mission, frame in _first(frames, followed_by_two).items()
            if mission not in dataset.single_pictures
        },
        "latency_frames": max(rule.latency_frames for rule in rules),
        "approaches": _approaches(frames, ocean, obstacle, said),
        "false_status_per_hour": false_status_per_hour(
            int((ocean & said).sum()),
            int(ocean.sum()),
            len({*blocks[ocean & said]}),
            len({*blocks[ocean]}),
            None,  # frames a second: of 1,000 frames instead
        ),
    }


def _approaches(
    frames: FrameTable, ocean: Bools, obstacle: Bools, said: Bools
) -> list[dict[str, Any]]:
    """What is left at the first status of each approach, of each camera."""
    found = []
    for (mission, camera), rows in frames.keys.groupby(["mission", "camera"]).indices.items():
        numbers = frames.keys.frame.to_numpy()[rows]
        spans = approaches(numbers.tolist(), *({*numbers[of[rows]]} for of in (ocean, obstacle)))
        positions = frames.keys.position.to_numpy()[rows].tolist()
        missed = missed_before(positions, frame_step(positions))
        status = np.where(said[rows], OBSTACLE, CLEAR).tolist()
        told = numbers.tolist(), missed, status, spans, KnownDistances(), None
        names = {"mission": str(mission), "camera": str(camera)}
        found += [{**names, **one} for one in approach_figures(*told)]
    return found


def _first(frames: FrameTable, chosen: Bools) -> dict[str, int | None]:
    """Return the first chosen frame of each mission, of whichever camera."""
    found: dict[str, int | None] = {str(name): None for name in frames.keys.mission.unique()}
    in_order = frames.keys[chosen].sort_values(["mission", "position"])
    first = in_order.drop_duplicates("mission")
    return found | {str(row.mission): int(row.frame) for row in first.itertuples()}
