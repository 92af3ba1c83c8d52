"""Options and results that the readers and writers of all formats share."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.features.frames.mission import LEFT
from tokt.labels.record import SETTLED, LabelRecord
from tokt.labels.taxonomy import Taxonomy

from .images import MissionImages

Progress = Callable[[Iterable[Any], int, str], Iterator[Any]]
Notes = Mapping[tuple[tuple[object, ...], str], str]
"""Texts by place and annotator, as `LabelStore.notes` gives them."""


def no_progress(items: Iterable[Any], total: int, what: str) -> Iterator[Any]:
    """Show nothing."""
    yield from items


@dataclass(frozen=True)
class ReadOptions:
    """How to read a file."""

    taxonomy: Taxonomy  # the classes a label may have, besides ``unsure``
    # Who labelled, where the file does not say; by default the file's name without ending.
    annotator: str | None = None
    grid: Grid = DEFAULT_GRID  # of boxes that are not patches of ours
    images: MissionImages | None = None  # the frames, which boxes that are not patches of ours need
    # The file's name of a class to ours; to nothing for a class to leave out.
    classes: Mapping[str, str] = field(default_factory=dict)
    camera: str = LEFT  # of a file that names frames by their position only


@dataclass(frozen=True)
class WriteOptions:
    """How to write a file: classes in their order, frames of the one mission, notes (full CSV)."""

    taxonomy: Taxonomy
    images: MissionImages | None = None
    full: bool = False
    notes: Notes = field(default_factory=dict)
    progress: Progress = no_progress


@dataclass(frozen=True)
class ImportResult:
    """What a file says, and in `lost`, a line each, what of it could not be taken over."""

    records: list[LabelRecord]
    lost: list[str]


@dataclass(frozen=True)
class ExportResult:
    """How many labels were written, and in `lost`, a line each, what the format cannot hold."""

    labels: int
    lost: list[str]


def label_of(record: LabelRecord) -> str:
    """The label of a record; ValueError if it takes one back, as files hold labels in force."""
    if record.label is None:
        raise ValueError(f"{record.cell} has no label")
    return record.label


def in_order(records: Iterable[LabelRecord]) -> list[LabelRecord]:
    """Records by patch, of each the settlement last."""
    return sorted(
        records,
        key=lambda r: (
            *(r.mission, r.camera, r.frame, str(r.grid), r.row, r.col),
            *(r.source == SETTLED, r.annotator, r.source),
        ),
    )


def mission_images(options: ReadOptions | WriteOptions, what: str) -> MissionImages:
    """The frames, or a ToktError that says why `what` needs them."""
    if options.images is None:
        raise ToktError(f"{what}; give the mission's frames by --mission-dir DIR")
    return options.images


Remarks = Counter[tuple[str, str]]
"""How many of something, and what about them: ``("box", "left out: without area")``."""


def lines(remarks: Remarks) -> list[str]:
    """One line a remark."""
    return [f"{count(n, noun)} {what}" for (noun, what), n in remarks.items() if n]


def count(n: int, noun: str) -> str:
    """``1 patch``, ``2 patches``."""
    if n == 1:
        return f"1 {noun}"
    return f"{n} {noun}es" if noun.endswith(("ch", "x", "s")) else f"{n} {noun}s"
