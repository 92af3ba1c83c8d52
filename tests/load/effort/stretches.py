"""Stretches of labelled dives: a model of all the rest, and what it must reproduce of one."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tokt.cli.output import progress
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import LEFT, format_frames
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import UNSURE, Taxonomy
from tokt.models.registry.registry import Registry
from tokt.training.datasets.dataset import write_dataset
from tokt.training.datasets.folds import EMBARGO_FRAMES, FOLDS
from tokt.training.datasets.mission_source import LabelledMission, plan_from_missions
from tokt.training.datasets.split import Split
from tokt.training.fitting.presets import extractor_for, settings_named
from tokt.training.fitting.tracking import log_and_register
from tokt.training.fitting.train import TrainRequest, fit_and_measure

from .session import FREE, Target

FRAMES = 36  # frames of a stretch; the rest of a dive is a shorter one
_GAP = 20  # frame numbers between two labelled frames that are of one stretch
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
    free = () if unsure else (UNSURE,)
    return {
        number: [FREE if label in free else label for label in labels[number]] for number in numbers
    }


def most_frequent_obstacle(labels: Target) -> str:
    """The class that a model's "obstacle" stands for; any one where no patch is one."""
    taxonomy = Taxonomy.load()
    said = Counter(label for row in labels.values() for label in row)
    return max(filter(taxonomy.is_obstacle, taxonomy.names), key=said.__getitem__)


@dataclass(frozen=True)
class Stretch:
    dive: LabelledMission
    held: list[int]

    @property
    def name(self) -> str:
        return f"{self.dive.name} {format_frames(self.held)}"

    @property
    def labels(self) -> Target:
        return labels_by_frame(self.dive.records)


def stretches_of(dive: LabelledMission, most: int = FRAMES) -> list[Stretch]:
    rows: list[list[int]] = []
    for number in labels_by_frame(dive.records):
        if not rows or len(rows[-1]) == most or number - rows[-1][-1] > _GAP:
            rows.append([])
        rows[-1].append(number)
    return [Stretch(dive, row) for row in rows]


def train_without(dives: Sequence[LabelledMission], stretch: Stretch, folder: Path) -> Path:
    """Train as ``tokt train`` does on all but a stretch, and export the bundle."""
    held = {(stretch.dive.name, number) for number in stretch.held}
    learnt = [
        replace(dive, records=[one for one in dive.records if (dive.name, one.frame) not in held])
        for dive in dives
    ]
    plan, _ = plan_from_missions(
        "rest", "binary", [dive for dive in learnt if dive.records], Taxonomy.load()
    )
    dataset = write_dataset(plan, folder / "datasets", progress)
    request = TrainRequest(
        *(dataset, "rest", extractor_for(_EXTRACTOR, _PRESET), _EXTRACTOR),
        *(settings_named(_PRESET), Split.of(dataset, FOLDS, EMBARGO_FRAMES)),
    )
    registry = Registry(folder, create=True, own=True)
    log_and_register(fit_and_measure(request, folder / "cache", progress, jobs=-1), registry)
    bundle = folder / "rest.tokt"
    bundle.write_bytes(registry.bundle("rest").data)
    return bundle
