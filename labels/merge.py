"""One label a patch out of several annotators' labels, as a dataset needs it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from .record import Cell, LabelRecord
from .taxonomy import UNSURE


@dataclass(frozen=True)
class Merged:
    """What `merge_annotators` found.

    Attributes
    ----------
    records : list of LabelRecord
        One a patch, in order of mission, camera, frame, grid, row, col.
    conflicts : list of Cell
        Patches where two annotators are sure of different classes; ``unsure`` in `records`.
    """

    records: list[LabelRecord]
    conflicts: list[Cell]


def merge_annotators(records: Iterable[LabelRecord]) -> Merged:
    """Merge the labels in force of any number of annotators.

    A patch that one annotator labelled keeps that record. Where all who are sure agree, their
    class holds, also against an ``unsure`` of somebody else. Where they disagree, or nobody is
    sure, the patch is ``unsure``: it is neither trained nor scored on. A merged record names its
    annotators joined by ``+`` and carries the latest of their times.

    Parameters
    ----------
    records : iterable of LabelRecord
        As `LabelStore.current` returns them: human, with a label, one a patch and annotator.
    """
    by_cell: dict[Cell, list[LabelRecord]] = {}
    for record in records:
        by_cell.setdefault(record.cell, []).append(record)
    merged: list[LabelRecord] = []
    conflicts: list[Cell] = []
    for cell in sorted(by_cell, key=lambda cell: (*cell[:3], str(cell.grid), *cell[4:])):
        said = by_cell[cell]
        sure = {record.label for record in said} - {UNSURE}
        if len(sure) > 1:
            conflicts.append(cell)
        merged.append(_merge(said, sure.pop() if len(sure) == 1 else UNSURE))
    return Merged(merged, conflicts)


def _merge(said: list[LabelRecord], label: str | None) -> LabelRecord:
    if len(said) == 1:
        return said[0]
    versions = {record.model_version for record in said}
    return replace(
        said[0],
        label=label,
        annotator="+".join(sorted(record.annotator for record in said)),
        time=max(record.time for record in said),
        model_version=versions.pop() if len(versions) == 1 else None,
    )
