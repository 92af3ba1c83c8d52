"""One annotator's labels of a whole mission as arrays, with the counts that follow from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.int16]


@dataclass(frozen=True)
class Said:
    """What was said of `n` patches, in order.

    Attributes
    ----------
    flat : int64 array, shape (n,)
        Patches as ``frame * n_cells + cell``.
    codes, notes : int16 array, shape (n,)
        Codes of the labels, and of what is to be known beside them; 0 is none.
    blind : bool array, shape (n,)
        Whether it was said without seeing what others said.
    """

    flat: NDArray[np.int64]
    codes: Codes
    notes: Codes
    blind: NDArray[np.bool_]

    def of(self, chosen: slice | NDArray[np.int64]) -> Said:
        """Some of it."""
        return Said(self.flat[chosen], self.codes[chosen], self.notes[chosen], self.blind[chosen])


class Layer:
    """What one annotator says of every patch, or what is settled of it.

    All arrays begin as untouched zeros, so that a large grid costs memory only where it is used.

    Parameters
    ----------
    n_frames, n_cells : int
        Frames of all cameras together, and patches of a frame.

    Attributes
    ----------
    labels : int16 array, shape (n_frames, n_cells)
        Code of the label of each patch; 0 is none.
    filled : int64 array, shape (n_frames,)
        Number of labelled patches of each frame.
    counts : int64 array
        Patches by label code; as long as the highest code met needs.
    event : int
        The last event that changed something.
    """

    def __init__(self, n_frames: int, n_cells: int) -> None:
        self.labels: Codes = np.zeros((n_frames, n_cells), np.int16)
        self.filled = np.zeros(n_frames, np.int64)
        self.counts = np.zeros(1, np.int64)
        self.event = 0
        self._notes: Codes | None = None
        self._blind: NDArray[np.bool_] | None = None

    def put(self, said: Said) -> None:
        """Set patches, in order: the last one holds where a patch is named twice."""
        touched = np.unique(said.flat // self.labels.shape[1])
        before = self._counts(touched)
        self.labels.reshape(-1)[said.flat] = said.codes
        if said.notes.any() and self._notes is None:
            self._notes = np.zeros_like(self.labels)
        if self._notes is not None:
            self._notes.reshape(-1)[said.flat] = said.notes
        if said.blind.any() and self._blind is None:
            self._blind = np.zeros(self.labels.shape, bool)
        if self._blind is not None:
            self._blind.reshape(-1)[said.flat] = said.blind
        self._count(before, -1)
        self._count(self._counts(touched), 1)
        self.filled[touched] = np.count_nonzero(self.labels[touched], axis=1)

    def clear(self, flat: NDArray[np.int64]) -> None:
        """Take back the labels of patches."""
        self.labels.reshape(-1)[flat] = 0

    def note(self, frame: int, cell: int) -> int:
        """Note of one patch."""
        return 0 if self._notes is None else int(self._notes[frame, cell])

    def notes(self, frame: int) -> dict[int, int]:
        """Notes of a frame by cell, where there is one."""
        if self._notes is None:
            return {}
        cells = np.flatnonzero(self._notes[frame])
        return {int(cell): int(self._notes[frame, cell]) for cell in cells}

    def count(self, code: int) -> int:
        """Number of patches with that label."""
        return int(self.counts[code]) if code < len(self.counts) else 0

    def blind_count(self) -> int:
        """Number of labelled patches that were labelled blind."""
        return 0 if self._blind is None else int(np.count_nonzero(self._blind & (self.labels > 0)))

    def _counts(self, frames: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.bincount(self.labels[frames].reshape(-1))

    def _count(self, counts: NDArray[np.int64], sign: int) -> None:
        if len(counts) > len(self.counts):
            self.counts = np.pad(self.counts, (0, len(counts) - len(self.counts)))
        self.counts[: len(counts)] += sign * counts
