"""Features of patches of changed frames, and the patches whose labels hold for them.

An augmentation by name (``jpeg_60``) changes each frame once and leaves its patches where they are.
``random_9`` changes each frame 9 times at random (`frame_changes`), a long dive's frames less
often, and keeps some of their patches.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64, I64, Bools
from tokt.features.extractors.extractor import build_extractor
from tokt.features.frames.grid import Grid
from tokt.features.frames.view_mask import ViewMask

from .augmentations import RANDOM, parse_augmentation
from .dataset import FRAME_KEY, DatasetVersion, read_stored_frame
from .feature_cache import cached_features, cached_table, feature_key
from .frame_changes import at_width, changed
from .frame_rows import SUFFIX as ROWS
from .frame_rows import read_frame_rows

PATCHES_A_FRAME = 25
"""Labelled patches of a changed frame that are kept, drawn at random: neighbours say the same."""
STORED_CHANGES = 2
"""Changes of a frame without a picture: as many times `PATCHES_A_FRAME` patches are kept of it."""
FRAMES_A_DIVE = 24
"""Frames of a dive that are changed as often as asked; those of longer dives share as many."""


@dataclass(frozen=True)
class ChangedPatches:
    """Features of patches of changed frames, and what they are changed from."""

    features: F64  # (n, dim)
    source: I64  # (n,): the row of the dataset's patches whose label holds, -1 for none

    def of(self, patches: I64) -> I64:
        """Rows of this table that come from some of the dataset's patches."""
        return np.flatnonzero(np.isin(self.source, patches))

    def part(self, patches: I64) -> "ChangedPatches":
        """The table for a dataset of these patches only, in their order."""
        rows = self.of(patches)
        order = np.argsort(patches, kind="stable")
        source = order[np.searchsorted(patches, self.source[rows], sorter=order)]
        return ChangedPatches(self.features[rows], source)


def changed_patches(
    dataset: DatasetVersion,
    spec: dict[str, Any],
    name: str,
    cache: Path,
    progress: Callable[..., Any],
    jobs: int = -1,
    dask: str | None = None,
) -> ChangedPatches:
    """Features of a dataset's patches in frames changed by an augmentation.

    Parameters are those of `cached_features`; `name` is ``random_N`` or an augmentation's.
    """
    kind, _ = parse_augmentation(name)
    if kind != RANDOM:
        table = cached_features(dataset, spec, cache, progress, jobs, dask, name)
        return ChangedPatches(table, np.arange(len(table)))
    tasks = _tasks(dataset, spec, name)
    dim = build_extractor(spec).dim
    path = cache / f"{dataset.name}-{feature_key(dataset, spec, name)}.npy"
    rows = np.arange(len(tasks) * PATCHES_A_FRAME).reshape(-1, PATCHES_A_FRAME)
    parts = list(zip(rows, tasks, strict=True))
    what = f"features, {name}"
    shape = rows.size, dim + 1
    table = cached_table(parts, _describe_changed, path, shape, what, progress, jobs, dask)
    return ChangedPatches(table[:, :dim], table[:, dim].astype(np.int64))


@dataclass(frozen=True)
class _Task:
    """One change of one frame."""

    path: Path
    digest: str
    mask: ViewMask | None
    spec: dict[str, Any]
    grid: Grid
    row_of: I64  # (n_patches,): each patch's row in the dataset's patches, -1 for one without label
    obstacle: Bools  # (n_patches,)
    number: int  # of the change, so that each is another one
    changes: str  # ``random_N``


def _tasks(dataset: DatasetVersion, spec: dict[str, Any], name: str) -> list[_Task]:
    """The changes of a dataset's frames, in their order."""
    often = int(parse_augmentation(name)[1])
    patches, frames, grid = dataset.patches, dataset.frames, dataset.grid
    cell, obstacle = (patches.row * grid.cols + patches.col).to_numpy(), dataset.obstacles()
    rows_of = patches.groupby(FRAME_KEY).indices
    keys = list(frames[FRAME_KEY].itertuples(index=False, name=None))
    folder, tasks = dataset.path.resolve() / "frames", list[_Task]()
    for places in frames.reset_index(drop=True).groupby("mission").indices.values():
        labelled = [place for place in places.tolist() if keys[place] in rows_of]
        for place, number in _schedule(labelled, dataset.pictured, often):
            rows, frame = rows_of[keys[place]], frames.iloc[place]
            row_of, solid = np.full(grid.n_patches, -1), np.zeros(grid.n_patches, bool)
            row_of[cell[rows]], solid[cell[rows]] = rows, obstacle[rows]
            file = folder / frame.file, frame.digest, dataset.mask(place)
            tasks.append(_Task(*file, spec, grid, row_of, solid, number, name))
    return tasks


def _schedule(labelled: Sequence[int], pictured: Bools, often: int) -> list[tuple[int, int]]:
    """Return which frames of a dive are changed, and the number of each change."""
    stored = [place for place in labelled if not pictured[place]]
    if stored:
        return [(place, number) for place in stored for number in range(STORED_CHANGES)]
    total = often * min(len(labelled), FRAMES_A_DIVE)
    return [(labelled[number * len(labelled) // total], number) for number in range(total)]


def stored_rows(changed: ChangedPatches, patches: I64, cells: I64) -> tuple[F64, I64]:
    """Return what a file of rows keeps of a frame's changed patches, and which patch each shows.

    Parameters
    ----------
    changed : ChangedPatches
        Of the whole dataset.
    patches : array of int, shape (n,)
        The frame's rows of the dataset's patches, rising.
    cells : array of int, shape (n,)
        Their places in the grid.
    """
    rows = changed.of(patches)[: STORED_CHANGES * PATCHES_A_FRAME]
    return changed.features[rows], cells[np.searchsorted(patches, changed.source[rows])]


def _stored_changes(task: _Task) -> F64:
    """Return what `_describe_changed` does, of a frame without a picture."""
    rows = read_frame_rows(task.path, task.digest, task.spec, task.changes)
    some = slice(task.number * PATCHES_A_FRAME, (task.number + 1) * PATCHES_A_FRAME)
    values, cells = rows.changed[some], rows.cells[some]
    out = np.zeros((PATCHES_A_FRAME, rows.values.shape[1] + 1))
    out[:, -1] = -1
    out[: len(cells), :-1], out[: len(cells), -1] = values, task.row_of[cells]
    return out


def _describe_changed(task: _Task) -> F64:
    """Features of some patches of a changed frame, and last the row of each one's source."""
    if task.path.suffix == ROWS:
        return _stored_changes(task)
    frame = read_stored_frame(task.path, task.digest, task.mask)
    rng = np.random.default_rng([int(task.digest[:16], 16), task.number])
    shape = task.grid.rows, task.grid.cols
    solid, known = task.obstacle.reshape(shape), (task.row_of >= 0).reshape(shape)
    made = changed(at_width(frame), solid, known, rng)
    source = np.where(made.source < 0, -1, task.row_of[made.source])
    kept = rng.permutation(np.flatnonzero(source >= 0))[:PATCHES_A_FRAME]
    extractor = build_extractor(task.spec)
    out = np.zeros((PATCHES_A_FRAME, extractor.dim + 1))
    out[:, -1] = -1
    out[: len(kept), :-1] = extractor.describe(made.frame, task.grid)[kept]
    out[: len(kept), -1] = source[kept]
    return out
