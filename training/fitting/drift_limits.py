"""Limits of drift and novelty: what held-back frames differ by from those learnt from.

A window is some consecutive frames of one mission and camera, as long as the blocks of frames that
cross-validation holds out: what the runtime looks at, too. It is compared with all training patches
but its own and those near it (the gap that the split has; both cameras). Windows start at every
frame, as the runtime's go along with the frames. Patches marked unsure are not in a dataset: the
runtime sees them, the windows here do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from tokt.features.common.arrays import F64, I64
from tokt.models.distribution import (
    BINS,
    MAX_WINDOW_FRAMES,
    MIN_STRETCHES,
    MIN_TYPICAL,
    Distribution,
    ks_distances,
    quantile_edges,
)
from tokt.training.datasets.dataset import DIVE_ORDER, FRAME_KEY, DatasetVersion

NOVEL_RATE = 0.01
"""Part of the frames of known water that may be called unknown for a patch unlike all learnt."""
_MIN_FILLED = 0.5
"""Part of the frames of the fullest window: a window at a gap in the labels may have fewer."""


def novelty_limit(dataset: DatasetVersion, distance: F64 | None) -> tuple[float | None, str]:
    """The distance to the nearest landmark that clear patches of held-out frames stay below.

    Of every dive's frames, each dive counting the same, `NOVEL_RATE` may have a farther one.
    Distances are those of `HeldOutPredictions`. With the limit, None where there is no map, no
    whole frame or no clear patch, come the words how it was found.
    """
    clear = ~dataset.obstacles()
    if distance is None or dataset.block_frames is None:
        return None, ""
    known = clear & np.isfinite(distance)
    if not known.any():
        return None, ""
    frames = dataset.patches[FRAME_KEY].assign(far=distance)[known].groupby(FRAME_KEY).far.max()
    dives = frames.groupby("mission")
    weight = 1 / dives.transform("size") / dives.ngroups
    falling = frames.to_numpy().argsort()[::-1]
    beyond = np.cumsum(weight.to_numpy()[falling])
    limit = float(frames.to_numpy()[falling[np.searchsorted(beyond, NOVEL_RATE, side="right")]])
    over = int((frames > limit).sum())
    return limit, (
        f"A frame in which a clear patch is farther than {limit:.2f} from all that was learnt is "
        f"unknown. So were {over} of {len(frames)} held-out frames with water: at most "
        f"{100 * NOVEL_RATE:g} % where each of {dives.ngroups} dives counts the same. Another "
        "site's water can be farther in any frame."
    )


def training_distribution(
    dataset: DatasetVersion, features: F64, embargo_frames: int, rows: I64 | None = None
) -> Distribution | None:
    """The distribution of a dataset's features, and its held-back windows' distances from it.

    Features are finite, in the order of the dataset's patches, of which some `rows` may be taken. A
    window is not compared with the `embargo_frames` on either side of it. None where nothing says
    which patches belong together, frames are no sequence, or fewer than `MIN_STRETCHES` windows
    without a common frame can be held back.
    """
    if dataset.block_frames in (None, 1):
        return None
    length = min(dataset.block_frames, MAX_WINDOW_FRAMES)
    rows = np.arange(len(features)) if rows is None else rows
    grouped = dataset.patches.iloc[rows].groupby(DIVE_ORDER)
    of_patch = grouped.ngroup().to_numpy(np.int64)
    sizes = grouped.size()
    windows = _windows(sizes.index.to_frame(index=False), sizes.to_numpy(), length, embargo_frames)
    stretches = _stretches(windows, length + embargo_frames)
    if stretches < MIN_STRETCHES:
        return None
    dim = features.shape[1]
    edges, counts = np.empty((dim, BINS - 1)), np.empty((dim, BINS), np.int64)
    typical, largest = np.empty(dim), np.empty(dim)
    for feature in range(dim):
        values = features[rows, feature]
        edges[feature] = quantile_edges(values)
        cells = of_patch * BINS + np.searchsorted(edges[feature], values)
        by_frame = np.bincount(cells, minlength=len(sizes) * BINS).reshape(-1, BINS)
        counts[feature] = by_frame.sum(axis=0)
        distances = _held_back_distances(by_frame, windows)
        typical[feature] = max(float(distances.mean()), MIN_TYPICAL)
        largest[feature] = distances.max()
    factor = max(1.0, float((largest / typical).max()))
    return Distribution(edges, counts, typical, factor, length, len(windows.first), stretches)


@dataclass(frozen=True)
class _Windows:
    """Windows of frames, which are rows of one table in the order of `DIVE_ORDER`."""

    mission: I64  # (n_windows,)
    number: I64  # (n_windows,): the first frame's position
    first: I64  # (n_windows,): rows of the window's frames: from `first` to before `last`
    last: I64
    # (n_cameras, 2, n_windows): of each camera the rows, from and to before, that the window is not
    # compared with; an empty range for another mission's camera.
    near: I64


def _windows(frames: pd.DataFrame, patches: I64, length: int, embargo: int) -> _Windows:
    """All windows of sorted frames that are full enough and leave enough to compare with."""
    numbers = frames.position.to_numpy(np.int64)
    mission = pd.factorize(frames.mission)[0]
    camera = frames.groupby(["mission", "camera"]).ngroup().to_numpy()
    ends = np.append(np.flatnonzero(np.diff(camera)) + 1, len(frames))
    runs = list(zip(np.append(0, ends[:-1]).tolist(), ends.tolist(), strict=True))
    last = np.empty(len(frames), np.int64)
    near = np.zeros((len(runs), 2, len(frames)), np.int64)
    filled = np.zeros(len(frames), bool)
    for index, (start, end) in enumerate(runs):
        own = numbers[start:end]
        last[start:end] = start + np.searchsorted(own, own + length)
        count = last[start:end] - np.arange(start, end)
        filled[start:end] = count >= _MIN_FILLED * count.max()
        same = mission == mission[start]
        near[index, 0, same] = start + np.searchsorted(own, numbers[same] - embargo)
        near[index, 1, same] = start + np.searchsorted(own, numbers[same] + length + embargo)
    before = np.append(0, np.cumsum(patches))
    outside = before[-1] - (before[near[:, 1]] - before[near[:, 0]]).sum(axis=0)
    first = np.flatnonzero(filled & (outside >= before[last] - before[:-1]))
    return _Windows(mission[first], numbers[first], first, last[first], near[:, :, first])


def _stretches(windows: _Windows, apart: int) -> int:
    """How many windows can be chosen whose first frames are `apart` or more numbers apart."""
    count = 0
    for mission in np.unique(windows.mission):
        free = -np.inf
        for number in np.unique(windows.number[windows.mission == mission]).tolist():
            if number >= free:
                count, free = count + 1, number + apart
    return count


def _held_back_distances(by_frame: I64, windows: _Windows) -> F64:
    """Of one feature, (n_frames, BINS): each window's distance from what it is compared with."""
    before = np.vstack([np.zeros(BINS, np.int64), np.cumsum(by_frame, axis=0)])
    inside = before[windows.last] - before[windows.first]
    near = (before[windows.near[:, 1]] - before[windows.near[:, 0]]).sum(axis=0)
    return ks_distances(inside, before[-1] - near)
