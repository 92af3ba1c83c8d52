"""All labels of one mission in memory, kept up to date from the label store."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import compress, islice, pairwise
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np

from tokt.features.common.arrays import I16, I64, U8, Bools
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import Mission
from tokt.features.frames.view_mask import CameraMasks
from tokt.labels.page.masks import masked_patches
from tokt.labels.record import SETTLED
from tokt.labels.store.store import EventRow, LabelStore, Note
from tokt.labels.taxonomy import UNSURE, Taxonomy

K = TypeVar("K")
FrameName: TypeAlias = tuple[str, int]
"""Camera and number of a frame."""

_AT_ONCE = 50_000  # events; what is held as Python objects at one time
_UNSEEN, _SEEN, _PART, _DONE, _DISAGREEMENT = b"uspdx"
_NOBODY_SURE = np.int16(np.iinfo(np.int16).max)


class Numbering(dict[K, int]):
    """Words, or anything else, and their numbers from 0; a new one gets the next number."""

    def __init__(self, words: Iterable[K] = ()) -> None:
        super().__init__()
        self.words: list[K] = []
        for word in words:
            self[word]

    def __missing__(self, word: K) -> int:
        self.words.append(word)
        self[word] = len(self.words) - 1
        return self[word]

    def codes(self, words: Iterable[K], n: int) -> I16:
        """The numbers of `n` words."""
        return np.fromiter((self[word] for word in words), np.int16, n)


class LabelDifference(NamedTuple):
    """A patch that two annotators labelled differently; `sure` where neither is unsure."""

    camera: str
    frame: int
    cell: int
    a: str
    b: str
    sure: bool
    settled: str | None
    settled_by: str | None


@dataclass(frozen=True)
class LabelEvents:
    """Label events of patches, in order: codes of their labels and of what is beside these."""

    flat: I64
    """The patches as ``frame * n_cells + cell``."""
    codes: I16
    notes: I16
    blind: Bools
    """Whether it was said without seeing what others said."""

    def of(self, chosen: slice | I64) -> LabelEvents:
        """Some of it."""
        return LabelEvents(
            self.flat[chosen], self.codes[chosen], self.notes[chosen], self.blind[chosen]
        )


class LabelArray:
    """One annotator's label of every patch, or the settlement of every patch.

    All arrays begin as untouched zeros, so that a large grid costs memory only where it is used.
    `labels` and `notes` hold codes by frame (of all cameras together) and cell; 0 is none.
    """

    def __init__(self, n_frames: int, n_cells: int) -> None:
        self.labels: I16 = np.zeros((n_frames, n_cells), np.int16)
        self.notes: I16 = np.zeros((n_frames, n_cells), np.int16)
        self.filled = np.zeros(n_frames, np.int64)  # labelled patches of each frame
        self.counts = np.zeros(1, np.int64)  # by label code, up to the highest code met
        self.event = 0  # the last one that changed something
        self._blind = np.zeros((n_frames, n_cells), bool)
        self._hidden = np.zeros((n_frames, n_cells), bool)

    def hide(self, said: LabelEvents) -> None:
        """Note what was said of masked patches, which counts nowhere."""
        self._hidden.reshape(-1)[said.flat] = said.codes > 0

    def hidden(self, position: int) -> int:
        """Number of labelled patches of a frame that are masked."""
        return int(np.count_nonzero(self._hidden[position]))

    def put(self, said: LabelEvents) -> None:
        """Set patches, in order: the last one holds where a patch is named twice."""
        touched = np.unique(said.flat // self.labels.shape[1])
        before = self._counts(touched)
        self.labels.reshape(-1)[said.flat] = said.codes
        self.notes.reshape(-1)[said.flat] = said.notes
        self._blind.reshape(-1)[said.flat] = said.blind
        self._count(before, -1)
        self._count(self._counts(touched), 1)
        self.filled[touched] = np.count_nonzero(self.labels[touched], axis=1)

    def clear(self, flat: I64) -> None:
        """Take back the labels of patches."""
        self.labels.reshape(-1)[flat] = 0

    def count(self, code: int) -> int:
        """Number of patches with that label."""
        return int(self.counts[code]) if code < len(self.counts) else 0

    def blind_count(self) -> int:
        """Number of labelled patches that were labelled blind."""
        return int(np.count_nonzero(self._blind & (self.labels > 0)))

    def _counts(self, frames: I64) -> I64:
        return np.bincount(self.labels[frames].reshape(-1))

    def _count(self, counts: I64, sign: int) -> None:
        if len(counts) > len(self.counts):
            self.counts = np.pad(self.counts, (0, len(counts) - len(self.counts)))
        self.counts[: len(counts)] += sign * counts


@dataclass(frozen=True)
class LabelChanges:
    """Frames in which something was said, by annotators: events after `since`, up to `event`."""

    event: int
    labelled: dict[str, set[FrameName]] = field(default_factory=dict)
    settled: dict[str, set[FrameName]] = field(default_factory=dict)
    since: int = 0
    noted: dict[str, set[FrameName]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.labelled or self.settled or self.noted)

    @property
    def frames(self) -> set[FrameName]:
        """All of the frames."""
        return set().union(*self.labelled.values(), *self.settled.values())

    @property
    def annotators(self) -> set[str]:
        """Everybody who said something."""
        return {*self.labelled, *self.settled}

    def seen_by(self, who: str, blind: bool) -> LabelChanges:
        """The part that `who` may hear of: when `blind`, only what `who` labelled and noted."""
        if not blind:
            return self
        mine, noted = (
            {who: said[who]} if who in said else {} for said in (self.labelled, self.noted)
        )
        return LabelChanges(self.event, mine, since=self.since, noted=noted)

    def add(self, who: str, source: str, frames: Iterable[FrameName]) -> None:
        """Add frames in which `who` labelled or settled something."""
        said = self.settled if source == SETTLED else self.labelled
        said.setdefault(who, set()).update(frames)

    def merged(self, other: LabelChanges) -> LabelChanges:
        """Both together."""
        return LabelChanges(
            max(self.event, other.event),
            _union(self.labelled, other.labelled),
            _union(self.settled, other.settled),
            min(self.since, other.since),
            _union(self.noted, other.noted),
        )


class Board:
    """The labels of every patch by every annotator, as fast as a page needs them.

    Everything here follows from the store's events of the mission; `refresh` reads the new ones.
    Frames that the mission does not have and labels of other grids are left out, and so is all that
    was said of masked patches. The taxonomy's classes come first among `names`. Threads may share a
    board.
    """

    def __init__(self, mission: Mission, grid: Grid, taxonomy: Taxonomy, store: LabelStore) -> None:
        self.mission_name = mission.name
        self.grid = grid
        self.frames = {camera: mission.frames(camera) for camera in mission.cameras}
        self._mission = mission
        self._store = store
        self._lock = threading.RLock()
        every = [(camera, frame) for camera, frames in self.frames.items() for frame in frames]
        self._every: list[FrameName] = every
        self._position = {name: n for n, name in enumerate(every)}
        self._labels = Numbering[str | None]((None, *taxonomy.names, UNSURE))
        self._unsure = self._labels[UNSURE]
        self._usual: tuple[str, ...] = (*taxonomy.names, UNSURE)
        self._gone: set[str] = set()
        self._notes = Numbering[str | None]((None,))
        self._nothing_said = LabelArray(len(every), grid.n_patches)
        self._seen: dict[str, Bools] = {}
        self._written: dict[FrameName, dict[tuple[int | None, str], Note]] = {}
        self._last_note = 0
        cameras = list(self.frames)
        self._camera = np.array([cameras.index(camera) for camera, _ in every], np.int64)
        self._begin(mission.masks)

    def _begin(self, masks: CameraMasks) -> None:
        """Know these masks, and no label yet."""
        grid = self.grid
        self.masks = masks
        found = [masked_patches(self._mission, masks, grid, camera) for camera in self.frames]
        self._masked = np.stack(found).reshape(len(found), grid.n_patches)  # by camera and cell
        self._said: dict[str, LabelArray] = {}
        self._settled = LabelArray(len(self._every), grid.n_patches)
        self._disagree = np.zeros(len(self._every), bool)
        self.event = 0

    def use_masks(self, masks: CameraMasks) -> None:
        """Leave other patches out. Raises ToktError if the store cannot be read."""
        with self._lock:
            self._begin(masks)
            self.refresh()

    def masked(self, camera: str) -> Bools:
        """The masked patches of a camera's frames, shape (n_patches,)."""
        return np.asarray(self._masked[list(self.frames).index(camera)])

    def refresh(self) -> LabelChanges:
        """Read the new events of the store. Raises ToktError if the store cannot be read."""
        with self._lock:
            # Read first: events of other missions up to there need not be looked at again.
            last = self._store.last_event()
            changed = LabelChanges(self.event, since=self.event)
            rows = self._store.rows_after(self.event, self.mission_name, self.grid)
            while chunk := list(islice(rows, _AT_ONCE)):
                self._take([row for row in chunk if (row[1], row[2]) in self._position], changed)
                self.event = chunk[-1][0]
            self.event = max(self.event, last)
            for number, note in self._store.notes_after(self._last_note, self.mission_name):
                self._last_note = number
                self._take_note(note, changed)
            return replace(changed, event=self.event)

    def changed_since(self, event: int) -> LabelChanges:
        """The changes after `event`, up to now."""
        rows = self._store.rows_after(event, self.mission_name, self.grid)
        changed = LabelChanges(max(event, self.event), since=event)
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
            shown = {*self._usual, *self._gone, None}
            return [*self._usual, *(str(name) for name in self._labels.words if name not in shown)]

    def use_classes(self, names: Iterable[str]) -> None:
        """Let other classes come first among `names`; one that went has no labels."""
        with self._lock:
            before, self._usual = self._usual, (*names, UNSURE)
            self._gone = {*self._gone, *before} - {*self._usual}

    @property
    def annotators(self) -> list[str]:
        """Everybody who labelled something of this mission in this grid, by name."""
        with self._lock:
            return sorted(self._said)

    def labels(self, who: str, camera: str, frame: int) -> list[str | None]:
        """One annotator's labels of a frame, one a cell."""
        with self._lock:
            return self._words(self._by(who), self._position[camera, frame])

    def hidden(self, who: str, camera: str, frame: int) -> int:
        """Number of one annotator's labels of a frame that are on masked patches."""
        with self._lock:
            return self._by(who).hidden(self._position[camera, frame])

    def others(self, who: str, camera: str, frame: int) -> dict[str, list[str | None]]:
        """Labels of a frame by everybody else who labelled something in it."""
        position = self._position[camera, frame]
        with self._lock:
            return {
                name: self._words(array, position)
                for name, array in sorted(self._said.items())
                if name != who and array.filled[position]
            }

    def settled(self, camera: str, frame: int) -> list[str | None]:
        """The settlements of a frame, one a cell."""
        with self._lock:
            return self._words(self._settled, self._position[camera, frame])

    def notes(
        self, who: str, blind: bool, camera: str, frame: int
    ) -> list[tuple[int | None, Note]]:
        """Notes on a frame and its patches, each with its cell; when `blind`, only those of `who`.

        A note on the frame itself has no cell.
        """
        with self._lock:
            written = self._written.get((camera, frame), {})
            return [
                (cell, note)
                for (cell, name), note in written.items()
                if note.text and (name == who or not blind)
            ]

    def versions(self, who: str, camera: str, frame: int) -> dict[int, str]:
        """Model versions whose suggestions this annotator confirmed, by cell."""
        with self._lock:
            codes = self._by(who).notes[self._position[camera, frame]].tolist()
            return {cell: str(self._notes.words[code]) for cell, code in enumerate(codes) if code}

    def counts(self, who: str) -> dict[str, int]:
        """One annotator's patches by label: classes, ``unsure``, and what else this person used."""
        with self._lock:
            count = self._by(who).count
            counts = {name: count(code) for name, code in self._labels.items() if name is not None}
        return {name: n for name, n in counts.items() if n or name in self._usual}

    def blind_count(self, who: str) -> int:
        """Number of this annotator's labels that were given blind."""
        with self._lock:
            return self._by(who).blind_count()

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

    def given(
        self, who: str, frames: Iterable[FrameName] | None = None
    ) -> dict[str, dict[str, list[str]]]:
        """Labels that one annotator gave, by camera and frame number, in the order of `names`.

        Of all frames with a label, or of `frames`, which may have none.
        """
        with self._lock:
            mine, words, every = self._by(who), self._labels.words, self._every
            if frames is None:
                positions = np.flatnonzero(mine.filled)
            else:
                found = sorted(self._position[name] for name in frames if name in self._position)
                positions = np.array(found, np.int64)
            used = np.flatnonzero(mine.counts[1:]) + 1
            labels = mine.labels[positions]
            has = np.zeros((len(positions), len(used)), bool)
            for column, code in enumerate(used):
                has[:, column] = (labels == code).any(axis=1)
        names = [str(words[code]) for code in used]
        given: dict[str, dict[str, list[str]]] = {}
        for position, row in zip(positions.tolist(), has.tolist(), strict=True):
            camera, frame = every[position]
            given.setdefault(camera, {})[str(frame)] = list(compress(names, row))
        return given

    def cells_of_class(self, who: str, label: str) -> list[tuple[str, int, int]]:
        """One annotator's patches of one label: (camera, frame, cell), in order."""
        with self._lock:
            positions, cells = np.nonzero(self._are(who, label))
        return [
            (*self._every[position], cell)
            for position, cell in zip(positions.tolist(), cells.tolist(), strict=True)
        ]

    def last_event(self, who: str) -> int:
        """The last event by which this annotator labelled something."""
        with self._lock:
            return self._by(who).event

    def labelled_frames(self, who: str) -> list[FrameName]:
        """Frames in which this annotator labelled something, in order."""
        with self._lock:
            return [self._every[n] for n in np.flatnonzero(self._by(who).filled)]

    def frames_with(self, who: str, label: str) -> list[FrameName]:
        """Frames in which this annotator gave at least one patch that label, in order."""
        with self._lock:
            return [self._every[n] for n in np.flatnonzero(self._are(who, label).any(axis=1))]

    def pairs(self, a: str, b: str) -> Counter[tuple[str, str]]:
        """How often `a` and `b` gave a patch each pair of labels, over what both labelled."""
        with self._lock:
            of_a, of_b = self._by(a).labels, self._by(b).labels
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

    def differences(self, a: str, b: str) -> list[LabelDifference]:
        """Patches that `a` and `b` labelled differently, settled or not, in order."""
        with self._lock:
            of_a, of_b = self._by(a).labels, self._by(b).labels
            positions, cells = np.nonzero((of_a > 0) & (of_b > 0) & (of_a != of_b))
            return [
                self._difference(position, cell, of_a, of_b)
                for position, cell in zip(positions.tolist(), cells.tolist(), strict=True)
            ]

    def _difference(self, position: int, cell: int, of_a: I16, of_b: I16) -> LabelDifference:
        words, settled = self._labels.words, self._settled.labels[position, cell]
        code_a, code_b = of_a[position, cell], of_b[position, cell]
        by = self._notes.words[self._settled.notes[position, cell]] if settled else None
        return LabelDifference(
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

    def _seen_by(self, who: str) -> Bools:
        if who not in self._seen:
            seen = np.zeros(len(self._every), bool)
            names = self._store.seen(self.mission_name, who)
            seen[[self._position[name] for name in names if name in self._position]] = True
            self._seen[who] = seen
        return self._seen[who]

    def _by(self, who: str) -> LabelArray:
        """What somebody said; of somebody who said nothing, not to be written into."""
        return self._said.get(who, self._nothing_said)

    def _are(self, who: str, label: str) -> Bools:
        """Which patches somebody gave that label, by frame and cell."""
        return np.asarray(self._by(who).labels == self._labels.get(label, -1))

    def _words(self, array: LabelArray, position: int) -> list[str | None]:
        words = self._labels.words
        return [words[code] for code in array.labels[position].tolist()]

    def _letters(self, who: str, blind: bool, positions: I64) -> U8:
        letters = np.where(self._seen_by(who)[positions], _SEEN, _UNSEEN).astype(np.uint8)
        filled = self._by(who).filled[positions]
        letters[filled > 0] = _PART
        in_view = np.count_nonzero(~self._masked, axis=1)
        letters[filled == in_view[self._camera[positions]]] = _DONE
        if not blind:
            letters[self._disagree[positions]] = _DISAGREEMENT
        return letters

    def _take(self, rows: list[EventRow], changed: LabelChanges) -> None:
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
        said = LabelEvents(
            position * self.grid.n_patches + cell,
            self._labels.codes(labels, n),
            self._notes.codes(notes, n),
            np.array(blind, bool),
        )
        names = np.array(who, object)
        settles = np.fromiter((source == SETTLED for source in sources), bool, n)
        masked = self._masked[self._camera[position], cell]
        # A settlement holds until somebody labels the patch anew: the order of the two counts.
        borders = [0, *(np.flatnonzero(np.diff(settles)) + 1).tolist(), n]
        for start, stop in pairwise(borders):
            part = slice(start, stop)
            shown = np.flatnonzero(~masked[part]) + start
            if settles[start]:
                self._settled.put(said.of(shown))
            else:
                self._settled.clear(said.flat[shown])
            for name in set(who[part]):
                mine = np.flatnonzero(names[part] == name) + start
                if not settles[start]:
                    self._array(name).put(said.of(mine[~masked[mine]]))
                    self._array(name).hide(said.of(mine[masked[mine]]))
                    self._array(name).event = events[mine[-1]]
                touched = np.unique(position[mine]).tolist()
                changed.add(name, sources[start], [self._every[place] for place in touched])
        self._find_disagreements(np.unique(position))

    def _take_note(self, note: Note, changed: LabelChanges) -> None:
        place = note.camera, note.frame
        if place not in self._position or note.grid not in (None, self.grid):
            return
        cell = None
        if note.row is not None and note.col is not None:
            cell = note.row * self.grid.cols + note.col
        self._written.setdefault(place, {})[cell, note.annotator] = note
        changed.noted.setdefault(note.annotator, set()).add(place)

    def _array(self, who: str) -> LabelArray:
        if who not in self._said:
            self._said[who] = LabelArray(len(self._every), self.grid.n_patches)
        return self._said[who]

    def _find_disagreements(self, positions: I64) -> None:
        shape = (len(positions), self.grid.n_patches)
        least, most = np.full(shape, _NOBODY_SURE), np.zeros(shape, np.int16)
        for array in self._said.values():
            codes = array.labels[positions]
            sure = (codes > 0) & (codes != self._unsure)
            np.minimum(least, codes, out=least, where=sure)
            np.maximum(most, codes, out=most, where=sure)
        differ = (least < most) & (self._settled.labels[positions] == 0)
        self._disagree[positions] = differ.any(axis=1)


def _union(a: dict[str, set[FrameName]], b: dict[str, set[FrameName]]) -> dict[str, set[FrameName]]:
    return {who: a.get(who, set()) | b.get(who, set()) for who in {*a, *b}}
