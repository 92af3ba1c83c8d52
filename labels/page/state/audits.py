"""The workspace's label audits, as far as they speak of one mission and grid."""

import threading
from pathlib import Path
from typing import NamedTuple

from tokt.labels.formats.audit_csv import Audit, AuditedPatch, audit_files, read_audit
from tokt.labels.store.store import LabelStore

from .board import Board


class Doubt(NamedTuple):
    """A doubted label of the mission that is shown."""

    cell: int
    patch: AuditedPatch


class Audits:
    """Reads audit files when they are asked for, each state of a file once. For any thread.

    Parameters
    ----------
    store : LabelStore
        Its folder is the workspace.
    board : Board
        Says the mission, its frames and the grid.
    """

    def __init__(self, store: LabelStore, board: Board) -> None:
        self._workspace = store.path.parent
        self._board = board
        self._lock = threading.Lock()
        self._read: dict[Path, tuple[tuple[int, int], Audit]] = {}

    def names(self) -> list[str]:
        """Names of all audits in the workspace."""
        return [path.stem for path in audit_files(self._workspace)]

    def audit(self, name: str) -> Audit:
        """The audit of that name.

        Raises
        ------
        ToktError
            If its file is damaged or of a newer format.
        KeyError
            If there is none.
        """
        paths = {path.stem: path for path in audit_files(self._workspace)}
        path = paths[name]
        found = path.stat()
        stamp = found.st_mtime_ns, found.st_size
        with self._lock:
            known = self._read.get(path)
            if known is None or known[0] != stamp:
                known = self._read[path] = stamp, read_audit(path)
            return known[1]

    def doubts(self, audit: Audit) -> list[Doubt]:
        """Its patches of this mission and grid, the worst first."""
        board = self._board
        if audit.grid != board.grid:
            return []
        return [
            Doubt(patch.row * board.grid.cols + patch.col, patch)
            for patch in audit.patches
            if patch.mission == board.mission_name
            and board.has(patch.camera, patch.frame)
            and patch.row < board.grid.rows
            and patch.col < board.grid.cols
        ]
