"""A labelled mission in two halves: a model of one, and what it must reproduce of the other."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tokt.cli.output import progress
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import LEFT
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import UNSURE, Taxonomy
from tokt.models.registry.registry import Registry
from tokt.training.datasets.dataset import build_dataset
from tokt.training.datasets.mission_source import LabelledMission, plan_from_missions
from tokt.training.datasets.splits import BLOCK_FRAMES, EMBARGO_FRAMES, FOLDS
from tokt.training.fitting.cross_validation import Split
from tokt.training.fitting.presets import extractor_for, settings_named
from tokt.training.fitting.tracking import log_and_register
from tokt.training.fitting.train import TrainRequest, train

from .session import FREE, Target

_BLOCKS = 10
"""A mission with fewer blocks of the usual length is cut into shorter ones."""
_EXTRACTOR, _PRESET = "haralick", "best"


def labels_by_frame(records: Sequence[LabelRecord]) -> dict[int, list[str | None]]:
    """One annotator's labels of the left frames, one a patch; None where there is no label."""
    found: dict[int, list[str | None]] = {}
    for record in sorted(records, key=lambda record: record.frame):
        if record.camera == LEFT:
            labels = found.setdefault(record.frame, [None] * DEFAULT_GRID.n_patches)
            labels[record.row * DEFAULT_GRID.cols + record.col] = record.label
    return found


def target_of(labels: Target, numbers: Sequence[int], unsure: bool) -> Target:
    """What must be reproduced of some frames, with patches nobody was sure of or without."""
    free = () if unsure else (UNSURE,)
    return {
        number: [FREE if label in free else label for label in labels[number]] for number in numbers
    }


def most_frequent_obstacle(labels: Target) -> str:
    """The class that a model's "obstacle" stands for. Raises ToktError where no patch is one."""
    taxonomy = Taxonomy.load()
    said = Counter(label for row in labels.values() for label in row)
    most = max(filter(taxonomy.is_obstacle, taxonomy.names), key=said.__getitem__)
    if not said[most]:
        raise ToktError("no patch is labelled as an obstacle: there is nothing to suggest")
    return most


@dataclass(frozen=True)
class Half:
    """Frames to learn from, and frames to label."""

    learnt: list[int]
    held: list[int]
    block: int  # frames a block of either
    gap: int  # frames left out beside a held-out one


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


def train_on(mission, records, half, folder) -> tuple[str, Path]:
    """Train as ``tokt train`` does, and export the bundle; the extractor's name, and the bundle."""
    plan, _ = plan_from_missions(
        "half",
        "binary",
        [LabelledMission(mission, records)],
        Taxonomy.load(),
        frames=half.learnt,
        block_frames=half.block,
    )
    request = TrainRequest(
        build_dataset(plan, folder / "datasets", progress),
        "half",
        extractor_for(_EXTRACTOR, _PRESET),
        _EXTRACTOR,
        settings_named(_PRESET),
        Split(FOLDS, half.gap),
    )
    registry = Registry(folder, create=True, own=True)
    log_and_register(train(request, folder / "cache", progress), registry)
    bundle = folder / "half.tokt"
    bundle.write_bytes(registry.bundle("half").data)
    return request.extractor_name, bundle
