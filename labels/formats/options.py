"""Options and results that the readers and writers of all formats share."""

from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from tokt.features.common.errors import ToktError, printable
from tokt.features.common.names import same_text
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.features.frames.mission import LEFT
from tokt.labels.record import SETTLED, LabelRecord
from tokt.labels.taxonomy import Taxonomy

from .images import MissionImages

_SHOWN, _MOST_FIELDS = 5, 40  # entries and fields of a file that a remark shows
_LONGEST = 300  # characters of each

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

    def __post_init__(self) -> None:
        named = {same_text(theirs): same_text(ours) for theirs, ours in self.classes.items()}
        object.__setattr__(self, "classes", named)


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


class Remarks(Counter[tuple[str, str]]):
    """Remarks on a file: the counts of all that is not taken over as it stands there.

    It counts how many of something, and what about them: ``("box", "left out: without area")``.
    An entry that cannot be read is left out alone, and shown with its place; or, where they are
    `strict`, it refuses the file.
    """

    def __init__(self, *, strict: bool = False) -> None:
        super().__init__()
        self.strict = strict
        self._entries = 0
        self._odd: list[str] = []
        self._unread: dict[str, None] = {}

    @contextmanager
    def entry(self, where: str) -> Iterator[None]:
        """Count one entry of the file, and leave it out where a ToktError is raised in it."""
        self._entries += 1
        try:
            yield
        except ToktError as error:
            self.leave_out(where, error)

    @contextmanager
    def group(self, where: str) -> Iterator[None]:
        """Leave out what holds entries, as one of them, where a ToktError is raised in it."""
        try:
            yield
        except ToktError as error:
            self._entries += 1
            self.leave_out(where, error)

    def leave_out(self, where: str, error: ToktError) -> None:
        """Leave out an entry, which `error` says is wrong."""
        if self.strict:
            raise ToktError(f"{where}: {error}")
        self._odd.append(f"{where}: {error}")

    def pass_over(self, fields: Iterable[Any], known: Container[str]) -> None:
        """Keep the names of an entry's fields that are not among the known ones."""
        self._unread.update((str(name), None) for name in fields if name not in known)

    def refuse_mostly_odd(self) -> None:
        """Raise ToktError where more than half of the entries were left out as odd."""
        odd = len(self._odd)
        if 2 * odd > self._entries:
            more = f" (and {odd - 1} more of {self._entries} entries)" if odd > 1 else ""
            raise ToktError(f"{self._odd[0]}{more}")

    def lines(self) -> list[str]:
        """One line a remark."""
        found = [f"{count(n, noun)} {what[:_LONGEST]}" for (noun, what), n in self.items() if n]
        if self._odd:
            entries = "1 entry" if len(self._odd) == 1 else f"{len(self._odd)} entries"
            found.append(f"{entries} left out: {_some(self._odd, '; ')}")
        if self._unread:
            fields = _some(list(self._unread), ", ", most=_MOST_FIELDS)
            found.append(f"fields that tokt does not read: {fields}")
        return found


def _some(texts: list[str], between: str, most: int = _SHOWN) -> str:
    """The first texts out of a file, shortened, and how many more there are."""
    shown = between.join(printable(text[:_LONGEST]) for text in texts[:most])
    more = len(texts) - most
    return f"{shown}{between}and {more} more" if more > 0 else shown


def count(n: int, noun: str) -> str:
    """``1 patch``, ``2 patches``."""
    if n == 1:
        return f"1 {noun}"
    return f"{n} {noun}es" if noun.endswith(("ch", "x", "s")) else f"{n} {noun}s"
