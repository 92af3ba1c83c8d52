"""The workspace's label audits, as far as they speak of one mission and grid.

A doubt is decided when a person confirmed, changed or settled that very patch after the audit was
made, by an action of `KNOWINGLY`, and that still holds. What counts is the settlement, else the
newest label of anybody. Not by labelling the rest of a frame, nor by accepting suggestions or
copies, nor by importing a file: nobody looked at that patch. An undo decides nothing either.
"""

import threading
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from tokt.labels.formats.audit_csv import Audit, AuditedPatch, audit_files, read_audit
from tokt.labels.record import SETTLED, Cell, utc_text
from tokt.labels.store.actions import CONFIRM
from tokt.labels.store.store import LabelStore

from .board import Board

KNOWINGLY = frozenset({"paint", "row", "column", "relabel", "resolve", "settle", CONFIRM})
"""Kinds of actions by which a person says something of the patches that they chose."""


Doubt = tuple[int, AuditedPatch]
"""A doubted label of the mission that is shown: its cell, and what the audit says of it."""


class Audits:
    """Reads audit files of the store's folder when asked for, each state once. For any thread."""

    def __init__(self, store: LabelStore, board: Board) -> None:
        self._workspace = store.path.parent
        self._store = store
        self._board = board
        self._lock = threading.Lock()
        self._read: dict[Path, tuple[tuple[int, int], Audit]] = {}

    def names(self) -> list[str]:
        """Names of all audits in the workspace."""
        return [path.stem for path in audit_files(self._workspace)]

    def audit(self, name: str) -> Audit:
        """The audit of that name, or KeyError; ToktError if its file is damaged or newer."""
        path = {path.stem: path for path in audit_files(self._workspace)}[name]
        found = path.stat()
        stamp = found.st_mtime_ns, found.st_size
        with self._lock:
            known = self._read.get(path)
            if known is None or known[0] != stamp:
                audit = read_audit(path)
                written = datetime.fromtimestamp(found.st_mtime, UTC).isoformat()
                audit = replace(audit, made=audit.made or utc_text(written))
                known = self._read[path] = stamp, audit
            return known[1]

    def doubts(self, audit: Audit) -> list[Doubt]:
        """Its patches of this mission and grid that are in view, the worst first."""
        board = self._board
        if audit.grid != board.grid:
            return []
        doubts = [
            (patch.row * board.grid.cols + patch.col, patch)
            for patch in audit.patches
            if patch.mission == board.mission_name
            and board.has(patch.camera, patch.frame)
            and patch.row < board.grid.rows
            and patch.col < board.grid.cols
        ]
        return [(cell, patch) for cell, patch in doubts if not board.masked(patch.camera)[cell]]

    def decision(self, audit: Audit, patch: AuditedPatch) -> str | None:
        """What people decided that a patch is since the audit; None while it is open."""
        cell = Cell(patch.mission, patch.camera, patch.frame, audit.grid, patch.row, patch.col)
        made = datetime.fromisoformat(audit.made)
        standing: dict[str | None, str | None] = {}  # by annotator, the newest last; None settled
        for label, annotator, source, time, kind in self._store.statements(cell):
            standing.pop(None, None)  # a settlement holds until something newer is said
            who = None if source == SETTLED else annotator
            standing.pop(who, None)
            knew = kind in KNOWINGLY and datetime.fromisoformat(time) > made
            standing[who] = label if knew else None
        return next((label for label in reversed(standing.values()) if label), None)
