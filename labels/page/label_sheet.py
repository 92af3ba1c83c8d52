"""The sheet of a person's labels: ranked from the board, looked at when first asked for."""

from __future__ import annotations

import threading

from ...features.mission import Mission
from .board import Board
from .sheet import Ranked, Sheet

_Cells = dict[str, list[tuple[str, int, int]]]


class LabelSheet:
    """`Sheet` over a board. For any number of threads.

    Parameters
    ----------
    mission : Mission
    board : Board
    """

    def __init__(self, mission: Mission, board: Board) -> None:
        self._board = board
        self._sheet = Sheet(mission, board.grid)
        self._lock = threading.Lock()
        self._started = False
        self._version: tuple[str, int] | None = None
        self._cells: _Cells = {}

    def ranked(self, who: str, label: str) -> Ranked:
        """A person's patches of one label, odd ones first."""
        with self._lock:
            if not self._started:
                # Not before: it keeps a processor busy for as long as there are labelled frames.
                self._sheet.start()
                self._started = True
            version = who, self._board.last_event(who)
            if version != self._version:
                # A million patches take a while to list; pages ask for them bit by bit.
                names = self._board.names
                self._cells = {name: self._board.cells_of_class(who, name) for name in names}
                self._version = version
            return self._sheet.patches(self._cells, label, version)

    def give_way(self) -> None:
        """Say that a request is being served."""
        self._sheet.give_way()

    def close(self) -> None:
        """Stop."""
        self._sheet.close()
