"""Actions of the labelling page: written with their events, undone, redone and found again."""

import json
import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any, NamedTuple

from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.labels.record import HUMAN, SETTLED, LabelRecord, check_name

from .schema import AT, COLUMNS, LAST_EVENT, VALUES

UNDO, REDO = "undo", "redo"
CONFIRM = "confirm"
"""Kind of an action that is written also where its label holds already: somebody looked."""

_NOW = 2**63 - 1  # no event has this number

_SAID = f"""SELECT label, model_version, blind FROM events WHERE {AT} AND annotator = :annotator
    AND source = 'human' AND id < :before ORDER BY id DESC LIMIT 1"""
_SETTLED = f"""SELECT CASE source WHEN 'settled' THEN label END,
    CASE source WHEN 'settled' THEN model_version END, FALSE FROM events WHERE {AT}
    AND source <> 'model' AND id < :before ORDER BY id DESC LIMIT 1"""

_ADD_EVENT = f"INSERT INTO events ({COLUMNS}, action) VALUES ({VALUES}, :action)"
_EVENTS = "SELECT id, camera, frame, row, col, label FROM events WHERE action = ? ORDER BY id"

_ADD_ACTION = """INSERT INTO actions (id, key, annotator, mission, grid, kind, time, source, blind,
    reverses, first, below, undo_top, redo_top, result)
    VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"""
_NODE = """SELECT actions.id, actions.source, actions.blind, actions.below, actions.first,
    first.key, first.kind FROM actions JOIN actions AS first ON first.id = actions.first
    WHERE actions.id = ?"""
_HEAD = """SELECT camera, frame, (SELECT COUNT(*) FROM events WHERE action = :id),
    (SELECT COUNT(*) FROM (SELECT DISTINCT camera, frame FROM events WHERE action = :id))
    FROM events WHERE action = :id ORDER BY id LIMIT 1"""
_TOPS = """SELECT undo_top, redo_top FROM actions WHERE annotator = ? AND mission = ? AND grid = ?
    ORDER BY id DESC LIMIT 1"""
_ANSWER = "SELECT id, annotator, mission, grid, kind, result FROM actions WHERE key = ?"


@dataclass(frozen=True)
class Change:
    """One patch's part in an action."""

    camera: str
    frame: int
    row: int
    col: int
    label: str | None  # what shall hold; None takes the label (or the settlement) back
    base: str | None  # what the page believed to hold: this annotator's label, or the settlement
    model_version: str | None = None  # a person confirmed the suggestion of this model


@dataclass(frozen=True)
class Action:
    """Changes that somebody made in one go; they are written, and undone, together.

    Raises ToktError if a value cannot be what it should be, or a patch is given twice.
    """

    key: str  # chosen by whoever sends it, unique; an action that is sent twice counts once
    annotator: str
    mission: str
    grid: Grid
    kind: str  # what was done (``"paint"``, ``"accept"``, ...), to name it when it is undone
    time: str  # when, as `record.utc_text` writes it
    changes: tuple[Change, ...]  # at most one a patch
    source: str = HUMAN  # or `SETTLED` where the annotator settles what others disagree on
    blind: bool = False  # whether the annotator saw nobody else's labels

    def __post_init__(self) -> None:
        for name in ("key", "kind", "annotator", "mission"):
            check_name(name, getattr(self, name))
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
                *(self.mission, change.camera, change.frame, self.grid, change.row, change.col),
                *(change.label, self.annotator, self.time, self.source, change.model_version),
                self.blind,
            )
            for change in self.changes
        ]


@dataclass(frozen=True)
class Conflict:
    """A change that was not made, because something else was said meanwhile."""

    camera: str
    frame: int
    row: int
    col: int
    theirs: str | None  # what holds
    yours: str | None  # what the change would have made of it


@dataclass(frozen=True)
class ActionResult:
    """What became of an action, an undo or a redo."""

    key: str  # as it was sent
    action: int  # its number in the store
    event: int  # highest event number of the store when it was done
    changed: int  # patches changed
    conflicts: tuple[Conflict, ...]  # changes that were not made
    repeated: bool  # the key was known: nothing was written, and this is the first time's answer
    frames: tuple[tuple[str, int], ...]  # that it speaks of: camera and number
    kind: str  # what was done; for an undo or a redo, the kind of the action undone or redone


@dataclass(frozen=True)
class ActionHead:
    """The action that an undo or a redo would act on."""

    key: str  # key and kind are of the action itself, also after it was undone and redone
    kind: str
    camera: str
    frame: int  # the first one it changed
    changed: int  # patches it changed when it was last done or undone
    frames: int  # in how many frames


class UndoHistory(NamedTuple):
    """Whose actions, in which mission and grid, are undone in turn."""

    annotator: str
    mission: str
    grid: Grid


class _Node(NamedTuple):
    """An action on one of the stacks, and the action that was done first (undone, redone since)."""

    id: int
    source: str
    blind: bool
    below: int | None
    first: int
    key: str
    kind: str


class _Tops(NamedTuple):
    undo: int | None
    redo: int | None


_Step = tuple[LabelRecord, str | None]
"""One change on its way in: what shall hold, and what should hold before."""


class ActionLog:
    """Reads and writes a store's actions; who calls `apply` or `reverse` holds a transaction."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def apply(self, action: Action) -> ActionResult:
        """Write an action, as `LabelStore.apply` says."""
        history = UndoHistory(action.annotator, action.mission, action.grid)
        known = self._answer(action.key, history, action.kind)
        if known is not None:
            return _applied(action.key, *known, repeated=True)
        number = self._next()
        bases = (change.base for change in action.changes)
        steps = zip(action.records(), bases, strict=True)
        result = self._write(number, steps, action.kind)
        tops = self._tops(history)
        below = None
        if result["changed"]:
            below, tops = tops.undo, _Tops(number, None)
        said = (action.kind, action.time, action.source, action.blind)
        self._add(number, action.key, history, *said, below=below, tops=tops, result=result)
        return _applied(action.key, number, result, repeated=False)

    def reverse(
        self, history: UndoHistory, way: str, key: str, time: str, target: str | None
    ) -> ActionResult | None:
        """Undo or redo (`way`) the top of a history, as `LabelStore.undo` says."""
        for what, value in ("key", key), ("annotator", history[0]), ("mission", history[1]):
            check_name(what, value)
        known = self._answer(key, history, way)
        if known is not None:
            return _applied(key, *known, repeated=True) if known[1] else None
        number = self._next()
        tops = self._tops(history)
        node = self._node(tops.undo if way == UNDO else tops.redo)
        if node is None:
            # Written all the same: the same key must not undo something done later.
            self._add(number, key, history, way, time, below=None, tops=tops, result={})
            return None
        if target not in (None, node.key):
            raise ToktError(f"something else was done since: {way} would act on {node.kind!r}")
        result = self._write(number, self._inverse(node, history, time), node.kind)
        below, tops = _moved(way, number, node, tops, bool(result["changed"]))
        said = (way, time, node.source, bool(node.blind), node)
        self._add(number, key, history, *said, below=below, tops=tops, result=result)
        return _applied(key, number, result, repeated=False)

    def heads(self, history: UndoHistory) -> tuple[ActionHead | None, ActionHead | None]:
        """What an undo and what a redo would act on."""
        tops = self._tops(history)
        return self._head(tops.undo), self._head(tops.redo)

    def _answer(
        self, key: str, history: UndoHistory, kind: str
    ) -> tuple[int, dict[str, Any]] | None:
        """Number and result of the action that has this key; of an idle undo it is empty."""
        row = self._row(_ANSWER, (key,))
        if row is None:
            return None
        number, *described, result = row
        if described != [*_texts(history), kind]:
            raise ToktError(f"key {key!r} is taken by another action")
        return number, json.loads(result)

    def _next(self) -> int:
        return int(self._row("SELECT COALESCE(MAX(id), 0) + 1 FROM actions")[0])

    def _row(self, sql: str, values: Sequence[Any] | dict[str, Any] = ()) -> Any:
        return self._connection.execute(sql, values).fetchone()

    def _add(
        self,
        number: int,
        key: str,
        history: UndoHistory,
        kind: str,
        time: str,
        source: str = HUMAN,
        blind: bool = False,
        reverses: _Node | None = None,
        *,
        below: int | None,
        tops: _Tops,
        result: dict[str, Any],
    ) -> None:
        row = (number, key, *_texts(history), kind, time, source, blind)
        links = (reverses.id, reverses.first) if reverses else (None, number)
        self._connection.execute(_ADD_ACTION, (*row, *links, below, *tops, json.dumps(result)))

    def _write(self, action: int, steps: Iterable[_Step], kind: str) -> dict[str, Any]:
        changed = 0
        conflicts: list[Conflict] = []
        frames: dict[tuple[str, int], None] = {}
        for record, expected in steps:
            frames[record.camera, record.frame] = None
            row = {**vars(record), "grid": str(record.grid), "action": action}
            holds, *_ = self._in_force(row, _NOW)
            if holds == record.label and kind != CONFIRM:
                continue
            if holds not in (expected, record.label):
                place = record.camera, record.frame, record.row, record.col
                conflicts.append(Conflict(*place, theirs=holds, yours=record.label))
                continue
            self._connection.execute(_ADD_EVENT, row)
            changed += 1
        return {
            "event": self._row(LAST_EVENT)[0],
            "changed": changed,
            "conflicts": [astuple(conflict) for conflict in conflicts],
            "frames": list(frames),
            "kind": kind,
        }

    def _in_force(self, row: dict[str, Any], before: int) -> tuple[str | None, str | None, bool]:
        """What held just before event number `before`: label, model version, whether blind."""
        sql = _SETTLED if row["source"] == SETTLED else _SAID
        return self._row(sql, {**row, "before": before}) or (None, None, False)

    def _inverse(self, node: _Node, history: UndoHistory, time: str) -> list[_Step]:
        """Back to what held before each event of an action, where its label still holds."""
        steps = []
        events = self._connection.execute(_EVENTS, (node.id,)).fetchall()
        for event, camera, frame, row, col, label in events:
            place = (history.mission, camera, frame, history.grid, row, col)
            said = LabelRecord(*place, label, history.annotator, time, node.source)
            held, version, blind = self._in_force({**vars(said), "grid": str(said.grid)}, event)
            before = replace(said, label=held, model_version=version, blind=blind)
            steps.append((before, label))
        return steps

    def _tops(self, history: UndoHistory) -> _Tops:
        return _Tops(*(self._row(_TOPS, _texts(history)) or (None, None)))

    def _node(self, number: int | None) -> _Node | None:
        row = self._row(_NODE, (number,))
        return _Node(*row) if row else None

    def _head(self, number: int | None) -> ActionHead | None:
        node = self._node(number)
        return node and ActionHead(node.key, node.kind, *self._row(_HEAD, {"id": node.id}))


def _texts(history: UndoHistory) -> list[str]:
    return [history.annotator, history.mission, str(history.grid)]


def _moved(
    way: str, number: int, node: _Node, tops: _Tops, changed: bool
) -> tuple[int | None, _Tops]:
    """What lies below a new undo or redo on its stack, and the tops after it.

    One that changed nothing, because all had changed meanwhile, is on no stack: there is nothing
    to take back about it.
    """
    if way == UNDO:
        top, below = (number, tops.redo) if changed else (tops.redo, None)
        return below, _Tops(node.below, top)
    top, below = (number, tops.undo) if changed else (tops.undo, None)
    return below, _Tops(top, node.below)


def _applied(key: str, number: int, result: dict[str, Any], *, repeated: bool) -> ActionResult:
    conflicts = tuple(Conflict(*values) for values in result["conflicts"])
    frames = tuple((camera, frame) for camera, frame in result["frames"])
    said = {**result, "conflicts": conflicts, "frames": frames}
    return ActionResult(key=key, action=number, repeated=repeated, **said)
