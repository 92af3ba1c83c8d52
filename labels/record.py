"""The label record: one thing said about one patch."""

from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import lru_cache
from typing import NamedTuple

from tokt.features.common.errors import ToktError
from tokt.features.common.names import is_utf8, same_text
from tokt.features.frames.grid import Grid
from tokt.features.frames.numbering import LAST_FRAME

HUMAN, MODEL, SETTLED = "human", "model", "settled"
SOURCES = (HUMAN, MODEL, SETTLED)
_CAMERAS = ("left", "right")
_LONGEST_NAME = 255  # characters: no file's or folder's name is longer


class NoLabelsError(ToktError):
    """What was asked for has no labels."""


class Cell(NamedTuple):
    """One patch of one frame, in one grid."""

    mission: str
    camera: str
    frame: int
    grid: Grid
    row: int
    col: int

    def __str__(self) -> str:
        return (
            f"{self.mission} {self.camera} frame {self.frame} row {self.row} col {self.col}"
            f" ({self.grid})"
        )


@dataclass(frozen=True)
class LabelRecord:
    """What somebody said about a patch (the label record of the design).

    Raises ToktError if the patch is outside the grid or a value cannot be what it should be.
    """

    mission: str  # its name
    camera: str  # ``"left"`` or ``"right"``
    frame: int  # its number
    grid: Grid  # that `row` and `col` count in, both from 0
    row: int
    col: int
    # A class, ``"unsure"``, or ``None``: the annotator takes the label, or the settlement, back.
    label: str | None
    # Who said it; for a suggestion, any name for the model; for a settlement, who settled.
    annotator: str
    time: str  # when it was said: UTC, ISO 8601, as `utc_text` writes it
    # ``"human"``; ``"model"`` for a suggestion; or ``"settled"`` for what somebody decided where
    # annotators disagree, whose opinions stay.
    source: str = HUMAN
    # The model version that suggested it. A human record may carry one: a person confirmed that
    # model's suggestion.
    model_version: str | None = None
    blind: bool = False  # whether the annotator saw nobody else's labels, and no suggestion
    # The whole name of the frame's file, by which it is known; empty where that is not known, or
    # the frame has none of its own.
    file: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        for name in ("mission", "annotator", "label"):
            if not (text := getattr(self, name) or "").isascii():
                object.__setattr__(self, name, same_text(text))
        check_name("mission", self.mission)
        check_name("annotator", self.annotator)
        if self.model_version is not None:
            check_name("model_version", self.model_version)
        if self.camera not in _CAMERAS:
            raise ToktError(f"camera {self.camera!r} is not one of {', '.join(_CAMERAS)}")
        if not 0 <= self.frame <= LAST_FRAME:
            raise ToktError(f"frame {self.frame} is not a frame number")
        if not self.grid.contains(self.row, self.col):
            raise ToktError(f"row {self.row} col {self.col} is outside the grid {self.grid}")
        if self.source not in SOURCES:
            raise ToktError(f"source {self.source!r} is not one of {', '.join(SOURCES)}")
        if self.source == MODEL and (self.model_version is None or self.label is None):
            raise ToktError("a suggestion needs a label and the model version that made it")
        _check_file(self.file)
        if utc_text(self.time) != self.time:
            raise ToktError(f"time {self.time!r} is not of the form {utc_text(self.time)}")

    @property
    def cell(self) -> Cell:
        """The patch it speaks of."""
        return Cell(self.mission, self.camera, self.frame, self.grid, self.row, self.col)


def check_name(what: str, value: str) -> None:
    """Refuse a name that no file keeps as it is: empty, long, not trimmed or not printable."""
    if len(value) > _LONGEST_NAME:
        raise ToktError(f"{what} {value[:20]!r}... has {len(value)} characters, of {_LONGEST_NAME}")
    if not value or not value.isprintable() or value != value.strip():
        raise ToktError(f"{what} {value!r} is empty or has blanks around it or unprintable signs")


def _check_file(name: str) -> None:
    if len(name) > _LONGEST_NAME or not is_utf8(name):
        raise ToktError(f"{name[:20]!r}... is no name of a file")


def utc_now() -> str:
    """The present moment as label records write it, for example ``2016-04-20T10:11:12.345Z``."""
    return _write(datetime.now(UTC))


@lru_cache(maxsize=1024)
def utc_text(text: str) -> str:
    """An ISO 8601 time with a zone as records write it, UTC with ``Z``; ToktError if it is none."""
    try:
        moment = datetime.fromisoformat(text)
        if moment.tzinfo is not None:
            return _write(moment.astimezone(UTC))
    except (ValueError, OverflowError):
        pass
    raise ToktError(f"time {text!r} is not like 2016-04-20T10:11:12Z (date, time, zone)")


def _write(moment: datetime) -> str:
    return moment.isoformat().removesuffix("+00:00") + "Z"
