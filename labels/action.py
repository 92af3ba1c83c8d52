"""What somebody does on the labelling page in one go, and what became of it."""

from __future__ import annotations

from dataclasses import dataclass

from ..features.errors import ToktError
from ..features.grid import Grid
from .record import HUMAN, SETTLED, LabelRecord, check_name

UNDO, REDO = "undo", "redo"


@dataclass(frozen=True)
class Change:
    """What an action says about one patch.

    Attributes
    ----------
    camera : str
    frame, row, col : int
    label : str or None
        What shall hold; ``None`` takes the label (or the settlement) back.
    base : str or None
        What the page believed to hold: this annotator's label, or the settlement.
    model_version : str or None
        A person confirmed the suggestion of this model.
    """

    camera: str
    frame: int
    row: int
    col: int
    label: str | None
    base: str | None
    model_version: str | None = None


@dataclass(frozen=True)
class Action:
    """Changes that somebody made in one go; they are written, and undone, together.

    Parameters
    ----------
    key : str
        Chosen by whoever sends it, unique; an action that is sent twice counts once.
    annotator, mission : str
    grid : Grid
    kind : str
        What was done (``"paint"``, ``"accept"``, ...), to name it when it is undone.
    time : str
        When, as `record.utc_text` writes it.
    changes : tuple of Change
        At most one a patch.
    source : str
        `HUMAN`, or `SETTLED` where the annotator settles patches that others disagree on.
    blind : bool
        Whether the annotator saw nobody else's labels.

    Raises
    ------
    ToktError
        If a value cannot be what it should be, or a patch is given twice.
    """

    key: str
    annotator: str
    mission: str
    grid: Grid
    kind: str
    time: str
    changes: tuple[Change, ...]
    source: str = HUMAN
    blind: bool = False

    def __post_init__(self) -> None:
        check_name("key", self.key)
        check_name("kind", self.kind)
        check_name("annotator", self.annotator)
        check_name("mission", self.mission)
        if self.kind in (UNDO, REDO):
            raise ToktError(f"kind {self.kind!r} is kept for what it says")
        if self.source not in (HUMAN, SETTLED):
            raise ToktError(f"source {self.source!r} is not one of {HUMAN}, {SETTLED}")
        patches = set()
        for record in self.records():
            if record.cell in patches:
                raise ToktError(f"{record.cell} is changed twice in one action")
            patches.add(record.cell)

    def records(self) -> list[LabelRecord]:
        """Its changes as label records, in their order."""
        return [
            LabelRecord(
                mission=self.mission,
                camera=change.camera,
                frame=change.frame,
                grid=self.grid,
                row=change.row,
                col=change.col,
                label=change.label,
                annotator=self.annotator,
                time=self.time,
                source=self.source,
                model_version=change.model_version,
            )
            for change in self.changes
        ]


@dataclass(frozen=True)
class Conflict:
    """A change that was not made, because something else was said meanwhile.

    Attributes
    ----------
    camera : str
    frame, row, col : int
    theirs : str or None
        What holds.
    yours : str or None
        What the change would have made of it.
    """

    camera: str
    frame: int
    row: int
    col: int
    theirs: str | None
    yours: str | None


@dataclass(frozen=True)
class Applied:
    """What became of an action, an undo or a redo.

    Attributes
    ----------
    key : str
        As it was sent.
    action : int
        Its number in the store.
    event : int
        Highest event number of the store when it was done.
    changed : int
        Patches changed.
    conflicts : tuple of Conflict
        Changes that were not made.
    repeated : bool
        The key was known already: nothing was written, and this is the first time's answer.
    frames : tuple of (str, int)
        Frames it speaks of: camera and number.
    kind : str
        What was done; for an undo or a redo, the kind of the action undone or redone.
    """

    key: str
    action: int
    event: int
    changed: int
    conflicts: tuple[Conflict, ...]
    repeated: bool
    frames: tuple[tuple[str, int], ...]
    kind: str


@dataclass(frozen=True)
class ActionHead:
    """The action that an undo or a redo would act on.

    Attributes
    ----------
    key, kind : str
        Of the action itself, also after it was undone and redone.
    camera : str
    frame : int
        The first frame it changed.
    changed : int
        Patches it changed when it was last done or undone.
    """

    key: str
    kind: str
    camera: str
    frame: int
    changed: int
