"""Frames in the order of the dive: statuses of each model's patches under a frame rule."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np
import pandas as pd

from tokt.features.common.arrays import F64, I64, Bools
from tokt.features.frames.mission import LEFT
from tokt.models.operating_point import (
    OBSTACLE,
    UNKNOWN,
    MofNRule,
    MofNState,
    frame_step,
    missed_before,
)
from tokt.training.datasets.dataset import DIVE_ORDER
from tokt.training.datasets.folds import block_of, positions_of
from tokt.training.evaluation.approaches import (
    NOTHING_STATED,
    AtSea,
    KnownDistances,
    approach_figures,
    approaches,
    false_status_per_hour,
)
from tokt.training.evaluation.evaluate import first_detection
from tokt.training.evaluation.frame_scores import frame_names

OCEAN, OBSTACLE_FRAME, NEITHER = "ocean", "obstacle", "neither"


@dataclass(frozen=True)
class FrameSeries:
    """The frames that are compared, dive by dive and camera by camera, in order."""

    # Columns mission, camera, frame, position, kind (as above), fold (-1 for none), and block:
    # frames of different ones are no near copies.
    table: pd.DataFrame
    starts: I64  # rows at which another dive or camera begins
    gaps: I64  # (n_frames,): frames missing just before each one, in its own sequence

    @classmethod
    def of(cls, table: pd.DataFrame, step: int | None = None) -> FrameSeries:
        """Order the rows of a table; `step` is the dives' `frame_step`, or the frames show it.

        They come in the order of their positions, or of their numbers in a table without these.
        """
        table = table.assign(position=positions_of(table))
        if "block" not in table:
            keys = zip(table.mission, table.position, strict=True)
            table = table.assign(block=[block_of(*key) for key in keys])
        table = table.sort_values(DIVE_ORDER, ignore_index=True)
        new = (table[["mission", "camera"]] != table[["mission", "camera"]].shift()).any(axis=1)
        starts = np.flatnonzero(new)
        missing: list[int] = []
        parts = np.split(table.position.to_numpy(), starts[1:])
        for positions in (part.tolist() for part in parts):
            missing += missed_before(positions, step or frame_step(positions))
        return cls(table, starts, np.asarray(missing, np.int64))

    def kind(self, name: str) -> Bools:
        """Which frames are of a kind."""
        return np.asarray(self.table.kind == name)

    def of_frames(self, frames: Bools) -> FrameSeries:
        """Whole dives or cameras alone."""
        starts = np.flatnonzero(np.isin(np.flatnonzero(frames), self.starts))
        return FrameSeries(self.table[frames].reset_index(drop=True), starts, self.gaps[frames])

    def ocean_apart(self, window: int) -> Bools:
        """Ocean frames with no obstacle frame in the `window` of frames that ends with each."""
        found = self.kind(OCEAN).copy()
        for rows in self.sequences():
            place = np.cumsum(1.0 + self.gaps[rows])
            obstacle = np.where(self.kind(OBSTACLE_FRAME)[rows], place, -np.inf)
            found[rows] &= place - np.maximum.accumulate(obstacle) >= window
        return found

    def sequences(self) -> list[slice]:
        """Rows of each dive and camera."""
        return [slice(a, b) for a, b in pairwise([*self.starts.tolist(), len(self.table)])]


def labelled_approaches(table: pd.DataFrame) -> list[tuple[int, int]]:
    """Of `approaches`, in the frames of one dive and camera, in order."""
    number, kind = table.frame, table.kind
    sides = (set(number[kind == name].tolist()) for name in (OCEAN, OBSTACLE_FRAME))
    return approaches(number.tolist(), *sides)


def statuses(
    series: FrameSeries, scores: F64, judged: Bools, rules: Sequence[MofNRule], white: int = 1
) -> I64:
    """The status of each frame, as the runtime would give it frame after frame.

    Scores, judged and white are as in `ModelPredictions`. There is one rule for all frames, or one
    a fold: then a frame's own fold's rule looks back over the frames before, whichever fold these
    are of.
    """
    found = np.full(len(scores), UNKNOWN)
    fold = series.table.fold.to_numpy() if len(rules) > 1 else np.zeros(len(scores), int)
    for (index, rule), rows in product(enumerate(rules), series.sequences()):
        state = MofNState(rule)
        for row in range(rows.start, rows.stop):
            state.skip(int(series.gaps[row]))
            status = state.add(scores[row] if judged[row] else None, white)
            if fold[row] == index:
                found[row] = status
    return found


def frame_figures(
    series: FrameSeries,
    status: I64,
    ranges: Mapping[str, KnownDistances] | None = None,
    stated: AtSea = NOTHING_STATED,
) -> dict[str, Any]:
    """Statuses against what the labels say a frame holds.

    Counts as `tokt evaluate` gives them, `approaches` and `false_status_per_hour` too, and in
    `sequences`, for each dive and camera, its first obstacle frame, the first of three frames in a
    row with status 1, and whether that came before any labelled obstacle.
    """
    ocean, obstacle = series.kind(OCEAN), series.kind(OBSTACLE_FRAME)
    said = status == OBSTACLE
    first, coming = [], []
    for rows in series.sequences():
        numbers = series.table.frame.to_numpy()[rows]
        place = {number: place for place, number in enumerate(numbers.tolist())}
        labelled = next(iter(numbers[obstacle[rows]].tolist()), None)
        gaps = series.gaps[rows].tolist()
        found = first_detection(numbers.tolist(), gaps, status[rows].tolist())
        row = series.table.iloc[rows.start]
        names = {"mission": str(row.mission), "camera": str(row.camera)}
        known = (ranges or {}).get(row.mission) if row.camera == LEFT else None
        spans = labelled_approaches(series.table[rows])
        of = numbers.tolist(), gaps, status[rows].tolist(), spans, known or KnownDistances()
        coming += [{**names, **one} for one in approach_figures(*of, stated.stopping_m)]
        first.append(
            {
                **names,
                "first_obstacle_frame": labelled,
                "first_detection": found,
                "false": found is not None and (labelled is None or place[found] < place[labelled]),
            }
        )
    block = series.table.block.to_numpy()
    hourly = false_status_per_hour(
        int((said & ocean).sum()),
        int(ocean.sum()),
        len(set(block[said & ocean])),
        len(set(block[ocean])),
        stated.frames_per_second,
    )
    return {
        "n": len(status),
        "ocean_frames": int(ocean.sum()),
        "false_status": int((said & ocean).sum()),
        "false_status_frames": frame_names(series.table[said & ocean]),
        "obstacle_frames": int(obstacle.sum()),
        "detected": int((said & obstacle).sum()),
        "unknown": int((status == UNKNOWN).sum()),
        "not_judged": int((~ocean & ~obstacle).sum()),
        "sequences": first,
        "approaches": coming,
        "false_status_per_hour": hourly,
    }
