"""A labelled mission in two halves: a model of one, and what it must reproduce of the other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import LEFT, Mission
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import UNSURE, Taxonomy
from tokt.models.registry.registry import Registry
from tokt.training.datasets.dataset import build_dataset
from tokt.training.datasets.mission_source import plan_from_missions
from tokt.training.datasets.splits import BLOCK_FRAMES, EMBARGO_FRAMES, FOLDS
from tokt.training.fitting.cross_validation import Split
from tokt.training.fitting.presets import extractor_for, settings_named
from tokt.training.fitting.tracking import log_and_register
from tokt.training.fitting.train import Trained, TrainRequest, train

from .page import FREE, NONE, Kinds, Labels, PageSuggestions
from .plan import ActionPlanner, LabellingTask, Tools

_BLOCKS = 10
"""A mission with fewer blocks of the usual length is cut into shorter ones."""
_EXTRACTOR, _PRESET = "haralick", "best"
KEEPS = (0.0, 1.0, 2.0, 3.0)
"""How long to keep what held in the frame before: what is tried on the training half."""


@dataclass(frozen=True)
class Labelled:
    """A mission's labels as a table.

    Parameters
    ----------
    numbers : tuple of int
        The labelled left frames.
    labels : array of int16, shape (n_frames, n_cells)
        Indices into `names`; NONE where there is no label.
    names : tuple of str
        The taxonomy's classes, and ``unsure``.
    kinds : Kinds
        A model's "obstacle" stands for the obstacle class with most labels.
    """

    numbers: tuple[int, ...]
    labels: Labels
    names: tuple[str, ...]
    kinds: Kinds

    def rows(self, numbers: Sequence[int]) -> Labels:
        """The labels of some frames."""
        place = {number: row for row, number in enumerate(self.numbers)}
        return self.labels[[place[number] for number in numbers]]

    def target(self, numbers: Sequence[int], unsure: bool) -> Labels:
        """What must be reproduced of some frames, with patches nobody was sure of or without."""
        rows = self.rows(numbers).copy()
        rows[(rows == NONE) | ((rows == self.kinds.unsure) & (not unsure))] = FREE
        return rows


def labelled(records: Sequence[LabelRecord], taxonomy: Taxonomy) -> Labelled:
    """The table of one annotator's labels of the left frames.

    Raises
    ------
    ToktError
        If none of them is an obstacle.
    """
    mine = [record for record in records if record.camera == LEFT]
    numbers = tuple(sorted({record.frame for record in mine}))
    names = (*taxonomy.names, UNSURE)
    row_of = {number: row for row, number in enumerate(numbers)}
    labels = np.full((len(numbers), DEFAULT_GRID.n_patches), NONE, np.int16)
    for record in mine:
        cell = record.row * DEFAULT_GRID.cols + record.col
        labels[row_of[record.frame], cell] = names.index(str(record.label))
    said = Counter(str(record.label) for record in mine)
    obstacles = [name for name in taxonomy.names if taxonomy.is_obstacle(name) and said[name]]
    if not obstacles:
        raise ToktError("no patch is labelled as an obstacle: there is nothing to suggest")
    clear = next(name for name in taxonomy.names if not taxonomy.is_obstacle(name))
    most = max(obstacles, key=lambda name: said[name])
    flags = (*map(taxonomy.is_obstacle, taxonomy.names), False)
    return Labelled(numbers, labels, names, Kinds(flags, names.index(clear), names.index(most)))


@dataclass(frozen=True)
class Half:
    """Frames to learn from, and frames to label.

    Parameters
    ----------
    learnt, held : list of int
    block, gap : int
        Frames a block of either; frames left out beside a held-out one.
    """

    learnt: list[int]
    held: list[int]
    block: int
    gap: int


def two_halves(numbers: Sequence[int]) -> list[Half]:
    """Whole blocks in turns, with a gap between: once each way round."""
    block = min(BLOCK_FRAMES, max(2, len(numbers) // _BLOCKS))
    gap = EMBARGO_FRAMES * block // BLOCK_FRAMES
    halves = []
    for side in (0, 1):
        held = [number for number in numbers if number // block % 2 != side]
        near = {number + step for number in held for step in range(-gap, gap + 1)}
        learnt = [number for number in numbers if number not in near]
        halves.append(Half(learnt, held, block, gap))
    return halves


def train_on(
    mission: Mission,
    records: Sequence[LabelRecord],
    half: Half,
    folder: Path,
    progress: Callable[..., Any],
) -> tuple[Trained, Path]:
    """Train as ``tokt train`` does, and export the bundle.

    Raises
    ------
    ToktError
        If these frames are too few to train and cross-validate on.
    """
    plan, _ = plan_from_missions(
        "half",
        "binary",
        [mission.path],
        records,
        Taxonomy.load(),
        frames=half.learnt,
        block_frames=half.block,
        labels_are_for_it=True,
    )
    dataset = build_dataset(plan, folder / "datasets", progress)
    request = TrainRequest(
        dataset,
        "half",
        extractor_for(_EXTRACTOR, _PRESET),
        _EXTRACTOR,
        settings_named(_PRESET),
        Split(FOLDS, half.gap),
    )
    trained = train(request, folder / "cache", progress)
    registry = Registry(folder, create=True, own=True)
    log_and_register(trained, registry)
    bundle = folder / "half.tokt"
    bundle.write_bytes(registry.bundle("half").data)
    return trained, bundle


def choose_keep(trained: Trained, table: Labelled, tools: Tools, sheet_frames: int) -> float:
    """How long to keep what held before: fewest actions on cross-validated values of this half."""
    patches = trained.request.dataset.patches
    numbers = tuple(sorted({int(number) for number in patches.frame}))
    row_of = {number: row for row, number in enumerate(numbers)}
    values: NDArray[np.float64] = np.zeros((len(numbers), DEFAULT_GRID.n_patches))
    cells = patches.row.to_numpy() * DEFAULT_GRID.cols + patches.col.to_numpy()
    rows = [row_of[int(number)] for number in patches.frame]
    values[rows, cells] = trained.model.obstacle_score(trained.held_out.values)
    target = table.target(numbers, unsure=False)
    task = LabellingTask(
        target, (DEFAULT_GRID.rows, DEFAULT_GRID.cols), table.kinds.clear, sheet_frames
    )

    def actions(keep: float) -> int:
        return len(
            ActionPlanner(task, tools).plan(PageSuggestions(values, numbers, table.kinds, keep))
        )

    return min(KEEPS, key=actions)
