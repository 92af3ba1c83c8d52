"""Merging several annotators' labels into one label a patch, as a dataset needs it."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from .record import SETTLED, Cell, LabelRecord
from .taxonomy import UNSURE


@dataclass(frozen=True)
class MergeResult:
    """The result of `merge_annotators`."""

    records: list[LabelRecord]  # one a patch, in order of mission, camera, frame, grid, row, col
    # Patches where two annotators are sure of different classes and nobody settled which; or where
    # two settlements differ. They are ``unsure`` in `records`.
    conflicts: list[Cell]


def merge_annotators(records: Iterable[LabelRecord]) -> MergeResult:
    """Merge the labels in force of any number of annotators.

    `records` are as `LabelStore.current_and_settled` returns them. A patch that one annotator
    labelled keeps that record. Where all who are sure agree, their class holds, also against an
    ``unsure`` of somebody else. Where they disagree, or nobody is sure, the patch is ``unsure``: it
    is neither trained nor scored on. What somebody settled holds whatever the annotators say. A
    merged record names its annotators, and who settled it, joined by ``+`` and carries the latest
    of their times.
    """
    by_cell: dict[Cell, list[LabelRecord]] = {}
    for record in records:
        by_cell.setdefault(record.cell, []).append(record)
    merged: list[LabelRecord] = []
    conflicts: list[Cell] = []
    for cell in sorted(by_cell, key=lambda cell: (*cell[:3], str(cell.grid), *cell[4:])):
        said = by_cell[cell]
        settled = [record for record in said if record.source == SETTLED]
        sure = {record.label for record in settled or said}
        if not settled:
            sure -= {UNSURE}
        if len(sure) > 1:
            conflicts.append(cell)
        label = sure.pop() if len(sure) == 1 else UNSURE
        merged.append(_merge(settled + [r for r in said if r.source != SETTLED], label))
    return MergeResult(merged, conflicts)


def _merge(said: list[LabelRecord], label: str | None) -> LabelRecord:
    if len(said) == 1:
        return said[0]
    versions = {record.model_version for record in said}
    return replace(
        said[0],
        label=label,
        annotator="+".join(sorted({record.annotator for record in said})),
        time=max(record.time for record in said),
        model_version=versions.pop() if len(versions) == 1 else None,
        blind=all(record.blind for record in said),
    )
