"""Labels of the store as a file of any format, for the command line and the page."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from tokt.features.frames.grid import Grid

from .formats import CSV
from .formats.formats import FORMATS
from .formats.options import ExportResult, WriteOptions, count
from .record import HUMAN, LabelRecord, NoLabelsError
from .store.store import LabelStore


@dataclass(frozen=True)
class Wanted:
    """Which labels of the store: those of one mission, annotator, grid, camera; None is of all."""

    mission: str | None = None
    annotator: str | None = None
    grid: Grid | None = None
    camera: str | None = None


def export_labels(
    store: LabelStore, file: Path, chosen: str, wanted: Wanted, options: WriteOptions
) -> ExportResult:
    """Write the labels in force to a file (or folder) of a format.

    Raises ToktError if there are none, the format cannot say them, or the file cannot be written.
    """
    settled = options.full or chosen != CSV
    records, lost = _in_force(store, wanted, settled=settled)
    notes = {
        (place, who): text
        for mission in {record.mission for record in records}
        for (place, who), text in store.notes(mission).items()
        if wanted.annotator in (None, who) and wanted.camera in (None, place[1])
    }
    in_file = {(one.cell, one.annotator) for one in records if one.source == HUMAN}
    left = len(notes.keys() - in_file) if options.full and chosen == CSV else len(notes)
    if left:
        kept = "csv --full keeps those of an annotator on patches with that annotator's label"
        lost.append(f"{count(left, 'note')} left out: {kept}")
    written = FORMATS[chosen].write(file, records, replace(options, notes=notes))
    return ExportResult(written.labels, [*written.lost, *lost])


def listed(names: Iterable[str]) -> str:
    """Names for a message."""
    return ", ".join(names) or "(none)"


def _in_force(
    store: LabelStore, wanted: Wanted, *, settled: bool
) -> tuple[list[LabelRecord], list[str]]:
    """Labels in force, and a line each for what else the store has of them."""
    narrow = vars(wanted)
    records = store.current_and_settled(**narrow) if settled else store.current(**narrow)
    if not records:
        raise NoLabelsError(
            f"no such labels in {store.path}; it has missions {listed(store.missions())}"
            f" and annotators {listed(store.annotators())}"
        )
    lost = []
    left = [] if settled else store.settled(**narrow)
    if left:
        lost.append(f"{count(len(left), 'settlement')} left out (--full keeps them)")
    earlier = sum(
        entry.events - entry.patches
        for entry in store.stats()
        if wanted.mission in (None, entry.mission) and wanted.annotator in (None, entry.annotator)
    )
    if earlier:
        lost.append(f"{count(earlier, 'earlier label')} left out: files hold those in force")
    return records, lost
