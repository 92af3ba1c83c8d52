"""All labels of one mission in memory, kept up to date from the label store."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from itertools import islice, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...features.grid import Grid
from ...features.mission import Mission
from ..record import SETTLED
from ..store import EventRow, LabelStore
from ..taxonomy import UNSURE, Taxonomy
from .changed import Changed, FrameName
from .layer import Codes, Layer, Said

_AT_ONCE = 50_000  # events; what is held as Python objects at one time
_UNSEEN, _SEEN, _PART, _DONE, _DISAGREEMENT = b"uspdx"
_NOBODY_SURE = np.int16(np.iinfo(np.int16).max)


class _Words(dict[str | None, int]):
    """Words and their codes; a new word gets the next code."""

    def __init__(self, words: Iterable[str | None]) -> None:
        super().__init__()
        self.words: list[str | None] = []
        for word in words:
            self[word]

    def __missing__(self, word: str | None) -> int:
        self.words.append(word)
        self[word] = len(self.words) - 1
        return self[word]

    def codes(self, words: Iterable[str | None], n: int) -> Codes:
        return np.fromiter((self[word] for word in words), np.int16, n)


class Difference(NamedTuple):
    """A patch that two annotators labelled differently; `sure` where neither is unsure."""

    camera: str
    frame: int
    cell: int
    a: str
    b: str
    sure: bool
    settled: str | None
    settled_by: str | None


class Board:
    """Who says what of every patch, as fast as a page must know it.

    Everything here follows from the store's events; `refresh` reads the new ones. Frames that
    the mission does not have are left out. Threads may share a board.

    Parameters
    ----------
    mission : Mission
        Its name and its frames say which events are read.
    grid : Grid
        Labels of other grids are left out.
    taxonomy : Taxonomy
        Its classes come first among `names`.
    store : LabelStore
    """

    def __init__(self, mission: Mission, grid: Grid, taxonomy: Taxonomy, store: LabelStore) -> None:
        self.mission_name = mission.name
        self.grid = grid
        self.frames = {camera: mission.frames(camera) for camera in mission.cameras}
        self.event = 0
        self._store = store
        self._lock = threading.RLock()
        every = [(camera, frame) for camera, frames in self.frames.items() for frame in frames]
        self._every: list[FrameName] = every
        self._position = {name: n for n, name in enumerate(every)}
        self._labels = _Words((None, *taxonomy.names, UNSURE))
        self._unsure = self._labels[UNSURE]
        self._usual = frozenset(self._labels)
        self._notes = _Words((None,))
        self._said: dict[str, Layer] = {}
        self._settled = Layer(len(every), grid.n_patches)
        self._seen: dict[str, NDArray[np.bool_]] = {}
        self._disagree = np.zeros(len(every), bool)

    def refresh(self) -> Changed:
        """Read what the store has new.

        Raises
        ------
        ToktError
            If the store cannot be read.
        """
        with self._lock:
            # Read first: events of other missions up to there need not be looked at again.
            last = self._store.last_event()
            changed = Changed(self.event, since=self.event)
            rows = self._store.rows_after(self.event, self.mission_name, self.grid)
            while chunk := list(islice(rows, _AT_ONCE)):
                self._take([row for row in chunk if (row[1], row[2]) in self._position], changed)
                self.event = chunk[-1][0]
            self.event = max(self.event, last)
            return replace(changed, event=self.event)

    def changed_since(self, event: int) -> Changed:
        """What was said after `event` up to now."""
        rows = self._store.rows_after(event, self.mission_name, self.grid)
        changed = Changed(max(event, self.event), since=event)
        for number, camera, frame, _row, _col, _label, who, source, *_ in rows:
            if (camera, frame) in self._position:
                changed.add(who, source, [(camera, frame)])
            changed = replace(changed, event=max(changed.event, number))
        return changed

    def has(self, camera: str, frame: int) -> bool:
        """Whether the mission has this frame."""
        return (camera, frame) in self._position

    @property
    def names(self) -> list[str]:
        """Labels in order: the taxonomy's classes, ``unsure``, then others found in the store."""
        with self._lock:
            return [name for name in self._labels.words if name is not None]

    @property
    def annotators(self) -> list[str]:
        """Everybody who labelled something of this mission in this grid, by name."""
        with self._lock:
            return sorted(self._said)

    def labels(self, who: str, camera: str, frame: int) -> list[str | None]:
        """One annotator's labels of a frame, one a cell."""
        with self._lock:
            return self._words(self._said.get(who), self._position[camera, frame])

    def others(self, who: str, camera: str, frame: int) -> dict[str, list[str | None]]:
        """Labels of a frame by everybody else who labelled something in it."""
        position = self._position[camera, frame]
        with self._lock:
            return {
                name: self._words(layer, position)
                for name, layer in sorted(self._said.items())
                if name != who and layer.filled[position]
            }

    def settled(self, camera: str, frame: int) -> list[str | None]:
        """What is settled of a frame, one a cell."""
        with self._lock:
            return self._words(self._settled, self._position[camera, frame])

    def versions(self, who: str, camera: str, frame: int) -> dict[int, str]:
        """Model versions whose suggestions this annotator confirmed, by cell."""
        with self._lock:
            layer = self._said.get(who)
            codes = layer.notes(self._position[camera, frame]) if layer else {}
            return {cell: str(self._notes.words[code]) for cell, code in codes.items()}

    def counts(self, who: str) -> dict[str, int]:
        """One annotator's patches by label: classes, ``unsure``, and what else this person used."""
        with self._lock:
            layer = self._said.get(who)
            counts = {
                name: layer.count(code) if layer else 0
                for name, code in self._labels.items()
                if name is not None
            }
        return {name: n for name, n in counts.items() if n or name in self._usual}

    def blind_count(self, who: str) -> int:
        """Number of this annotator's labels that were given blind."""
        with self._lock:
            return self._said[who].blind_count() if who in self._said else 0

    def states(self, who: str, blind: bool) -> dict[str, str]:
        """State of every frame by camera, one letter a frame in the order of `frames`.

        ``u`` unseen, ``s`` seen, ``p`` part, ``d`` done, and unless `blind` ``x``: two annotators
        are sure of different classes somewhere in it and nobody settled it.
        """
        with self._lock:
            letters = self._letters(who, blind, np.arange(len(self._every)))
        text, start, states = letters.tobytes().decode("ascii"), 0, {}
        for camera, frames in self.frames.items():
            states[camera] = text[start : start + len(frames)]
            start += len(frames)
        return states

    def states_of(
        self, who: str, blind: bool, frames: Iterable[FrameName]
    ) -> dict[str, dict[str, str]]:
        """States of some frames by camera and frame number."""
        found = sorted(name for name in frames if name in self._position)
        with self._lock:
            positions = np.array([self._position[name] for name in found], np.int64)
            letters = self._letters(who, blind, positions).tobytes().decode("ascii")
        states: dict[str, dict[str, str]] = {}
        for (camera, frame), letter in zip(found, letters, strict=True):
            states.setdefault(camera, {})[str(frame)] = letter
        return states

    def cells_of_class(self, who: str, label: str) -> list[tuple[str, int, int]]:
        """One annotator's patches of one label: (camera, frame, cell), in order."""
        with self._lock:
            layer = self._said.get(who)
            if layer is None or label not in self._labels:
                return []
            positions, cells = np.nonzero(layer.labels == self._labels[label])
        return [
            (*self._every[position], cell)
            for position, cell in zip(positions.tolist(), cells.tolist(), strict=True)
        ]

    def last_event(self, who: str) -> int:
        """The last event by which this annotator labelled something."""
        with self._lock:
            return self._said[who].event if who in self._said else 0

    def labelled_frames(self, who: str) -> list[FrameName]:
        """Frames in which this annotator labelled something, in order."""
        with self._lock:
            layer = self._said.get(who)
            return [self._every[n] for n in np.flatnonzero(layer.filled)] if layer else []

    def frames_with(self, who: str, label: str) -> list[FrameName]:
        """Frames in which this annotator gave at least one patch that label, in order."""
        with self._lock:
            layer = self._said.get(who)
            if layer is None or label not in self._labels:
                return []
            some = (layer.labels == self._labels[label]).any(axis=1)
            return [self._every[n] for n in np.flatnonzero(some)]

    def pairs(self, a: str, b: str) -> Counter[tuple[str, str]]:
        """How often `a` and `b` gave a patch each pair of labels, over what both labelled."""
        with self._lock:
            if a not in self._said or b not in self._said:
                return Counter()
            of_a, of_b = self._said[a].labels, self._said[b].labels
            both = (of_a > 0) & (of_b > 0)
            n_words = len(self._labels.words)
            found, counts = np.unique(
                of_a[both].astype(np.int64) * n_words + of_b[both], return_counts=True
            )
            words = [str(word) for word in self._labels.words]
        return Counter(
            {
                (words[pair // n_words], words[pair % n_words]): count
                for pair, count in zip(found.tolist(), counts.tolist(), strict=True)
            }
        )

    def differences(self, a: str, b: str) -> list[Difference]:
        """Patches that `a` and `b` labelled differently, settled or not, in order."""
        with self._lock:
            if a not in self._said or b not in self._said:
                return []
            of_a, of_b = self._said[a].labels, self._said[b].labels
            positions, cells = np.nonzero((of_a > 0) & (of_b > 0) & (of_a != of_b))
            return [
                self._difference(position, cell, of_a, of_b)
                for position, cell in zip(positions.tolist(), cells.tolist(), strict=True)
            ]

    def _difference(self, position: int, cell: int, of_a: Codes, of_b: Codes) -> Difference:
        words, settled = self._labels.words, self._settled.labels[position, cell]
        code_a, code_b = of_a[position, cell], of_b[position, cell]
        by = self._notes.words[self._settled.note(position, cell)] if settled else None
        return Difference(
            *self._every[position],
            cell,
            str(words[code_a]),
            str(words[code_b]),
            self._unsure not in (code_a, code_b),
            words[settled],
            by,
        )

    def is_seen(self, who: str, camera: str, frame: int) -> bool:
        """Whether `who` opened a frame."""
        with self._lock:
            return bool(self._seen_by(who)[self._position[camera, frame]])

    def mark_seen(self, who: str, camera: str, frame: int) -> None:
        """Note that `who` opened a frame, which the store holds already."""
        with self._lock:
            self._seen_by(who)[self._position[camera, frame]] = True

    def reload_seen(self, who: str) -> None:
        """Read again which frames `who` opened; another process may have added some."""
        with self._lock:
            self._seen.pop(who, None)
            self._seen_by(who)

    def _seen_by(self, who: str) -> NDArray[np.bool_]:
        if who not in self._seen:
            seen = np.zeros(len(self._every), bool)
            names = self._store.seen(self.mission_name, who)
            seen[[self._position[name] for name in names if name in self._position]] = True
            self._seen[who] = seen
        return self._seen[who]

    def _words(self, layer: Layer | None, position: int) -> list[str | None]:
        if layer is None:
            return [None] * self.grid.n_patches
        words = self._labels.words
        return [words[code] for code in layer.labels[position].tolist()]

    def _letters(self, who: str, blind: bool, positions: NDArray[np.int64]) -> NDArray[np.uint8]:
        letters = np.where(self._seen_by(who)[positions], _SEEN, _UNSEEN).astype(np.uint8)
        layer = self._said.get(who)
        if layer is not None:
            filled = layer.filled[positions]
            letters[filled > 0] = _PART
            letters[filled == self.grid.n_patches] = _DONE
        if not blind:
            letters[self._disagree[positions]] = _DISAGREEMENT
        return letters

    def _take(self, rows: list[EventRow], changed: Changed) -> None:
        if not rows:
            return
        events, cameras, frames, row, col, labels, who, sources, versions, blind = zip(
            *rows, strict=True
        )
        n = len(rows)
        position = np.fromiter(
            (self._position[name] for name in zip(cameras, frames, strict=True)), np.int64, n
        )
        cell = np.array(row, np.int64) * self.grid.cols + np.array(col, np.int64)
        notes = [
            name if source == SETTLED else version
            for source, name, version in zip(sources, who, versions, strict=True)
        ]
        # Beside a settlement who made it; beside a label which model's suggestion it confirmed.
        said = Said(
            position * self.grid.n_patches + cell,
            self._labels.codes(labels, n),
            self._notes.codes(notes, n),
            np.array(blind, bool),
        )
        names = np.array(who, object)
        settles = np.fromiter((source == SETTLED for source in sources), bool, n)
        # A settlement holds until somebody labels the patch anew: the order of the two counts.
        borders = [0, *(np.flatnonzero(np.diff(settles)) + 1).tolist(), n]
        for start, stop in pairwise(borders):
            part = slice(start, stop)
            if settles[start]:
                self._settled.put(said.of(part))
            else:
                self._settled.clear(said.flat[part])
            for name in set(who[part]):
                mine = np.flatnonzero(names[part] == name) + start
                if not settles[start]:
                    self._layer(name).put(said.of(mine))
                    self._layer(name).event = events[mine[-1]]
                touched = np.unique(position[mine]).tolist()
                changed.add(name, sources[start], [self._every[place] for place in touched])
        self._find_disagreements(np.unique(position))

    def _layer(self, who: str) -> Layer:
        if who not in self._said:
            self._said[who] = Layer(len(self._every), self.grid.n_patches)
        return self._said[who]

    def _find_disagreements(self, positions: NDArray[np.int64]) -> None:
        shape = (len(positions), self.grid.n_patches)
        least, most = np.full(shape, _NOBODY_SURE), np.zeros(shape, np.int16)
        for layer in self._said.values():
            codes = layer.labels[positions]
            sure = (codes > 0) & (codes != self._unsure)
            np.minimum(least, codes, out=least, where=sure)
            np.maximum(most, codes, out=most, where=sure)
        differ = (least < most) & (self._settled.labels[positions] == 0)
        self._disagree[positions] = differ.any(axis=1)
