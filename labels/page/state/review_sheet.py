"""The review sheet: all patches that were given a label, those that look least like it first."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tokt.features.common.arrays import F32, F64, I64
from tokt.features.common.extras import needed_by
from tokt.features.frames.mission import Mission
from tokt.labels.taxonomy import UNSURE

from .board import Board
from .frame_features import WHAT, CellName, FeatureSnapshot, FrameFeatures, PatchLocations

BLOCK = 20
"""Frames that are kept together, of both cameras: neighbours are near copies of each other."""

MAX_TRAINED = 20_000
"""Patches a classifier learns from at most, half of each side."""

_FOLDS = 5
_SEED = 42


class Patch(NamedTuple):
    """A labelled patch; `value` is lower the less it looks like its label."""

    camera: str
    frame: int
    cell: int
    value: float


@dataclass(frozen=True)
class Ranked:
    """A class's patches, in the order of the frames."""

    cells: Sequence[CellName]
    values: F64
    """Lower the less it looks like its label; NaN where its frame has not been looked at yet or
    cannot be read."""
    by: str
    """What the order goes by and how that was computed, in words."""
    done: int
    of: int
    """Labelled frames that have been looked at, and all of them."""

    @cached_property
    def _order(self) -> I64:
        return np.argsort(self.values, kind="stable")  # what is not a number comes last

    def patches(self, start: int, stop: int) -> list[Patch]:
        """A part of the patches, odd ones first; made when it is asked for: of a million."""
        places: list[int] = self._order[start:stop].tolist()
        return [Patch(*self.cells[place], float(self.values[place])) for place in places]

    @property
    def ready(self) -> bool:
        """Whether all frames have been looked at."""
        return self.done == self.of


def rank(
    features: FrameFeatures, cells_by_class: Mapping[str, Sequence[CellName]], label: str
) -> Ranked:
    """Rank a label's patches by how they look among all; ToktError without scikit-learn."""
    located = {name: features.locate(cells) for name, cells in cells_by_class.items()}
    known = features.snapshot()
    own = located.get(label, features.locate([]))
    # What nobody was sure of is no example of anything.
    names = [name for name in located if name not in (label, UNSURE)]
    others = [located[name] for name in names] if label != UNSURE else []
    values, by = _values(known, own, others)
    return Ranked(cells_by_class.get(label, ()), values, by, known.done, len(known.positions))


class ReviewSheet:
    """A person's labels, ranked from the board when first asked for. For any number of threads."""

    def __init__(self, mission: Mission, board: Board) -> None:
        self._board = board
        self._features = FrameFeatures(mission, board.grid, board.masks)
        self.background = self._features.background
        self._lock = threading.Lock()
        self._started = False
        self._version: tuple[str, int] | None = None
        self._cells: dict[str, list[CellName]] = {}
        self._last: tuple[str, Ranked] | None = None

    def ranked(self, who: str, label: str) -> Ranked:
        """A person's patches of one label, odd ones first; ToktError as in `rank`."""
        # One at a time: the next one mostly asks for the following page of the same ranking.
        with self._lock:
            if not self._started:
                # Not before: it keeps a processor busy for as long as there are labelled frames.
                self.background.start()
                self._started = True
            version = who, self._board.last_event(who)
            if version != self._version:
                # A million patches take a while to list; pages ask for them bit by bit.
                names = self._board.names
                self._cells = {name: self._board.cells_of_class(who, name) for name in names}
                self._version, self._last = version, None
            if self._last is None or self._last[0] != label or not self._last[1].ready:
                self._last = label, rank(self._features, self._cells, label)
            return self._last[1]


@dataclass(frozen=True)
class _Samples:
    """How patches look: their features, and the block of frames each is from."""

    features: F32
    blocks: I64

    @classmethod
    def of(cls, known: FeatureSnapshot, located: PatchLocations, chosen: I64) -> _Samples:
        rows = located.rows[chosen]
        return cls(known.features[rows, located.cells[chosen]], known.positions[rows] // BLOCK)


def _values(
    known: FeatureSnapshot, own: PatchLocations, others: list[PatchLocations]
) -> tuple[F64, str]:
    """A value a patch, the odder the lower, and what it is."""
    values = np.full(len(own.rows), np.nan)
    places = np.flatnonzero(known.good[own.rows])
    if not len(places):
        unread = bool(len(own.rows)) and known.done == len(known.positions)
        return values, "in the order of the frames" + (": none can be read" if unread else "")
    looks = _Samples.of(known, own, places)
    rest = [_sample(known, other, MAX_TRAINED // len(others)) for other in others]
    rest = [part for part in rest if len(part.blocks)]
    found = _cross_validated(looks, rest) if rest else None
    if found is None:
        why = f"patches in two blocks of {BLOCK} frames" if rest else "a second class"
        values[places] = -_distances(looks.features)
        by = f"distance from the class's median in {WHAT}; for cross-validation it needs {why}"
        return values, by
    values[places], folds = found
    return values, (
        f"decision value against the other classes, cross-validated: {folds} folds of whole"
        f" blocks of {BLOCK} frames, linear SVM on {WHAT}"
    )


def _sample(known: FeatureSnapshot, located: PatchLocations, most: int) -> _Samples:
    """Some of the patches, drawn at random, the same ones each time."""
    places = np.flatnonzero(known.good[located.rows])
    return _Samples.of(known, located, _some(np.random.default_rng(_SEED), places, most))


def _cross_validated(own: _Samples, others: list[_Samples]) -> tuple[F64, int] | None:
    """Decision values of one class's patches by classifiers that did not see their blocks.

    None where a classifier would see one class only. Also returns the number of folds.
    """
    with needed_by("the review sheet", "label"):
        from sklearn.model_selection import StratifiedGroupKFold
        from sklearn.pipeline import make_pipeline
        from sklearn.preprocessing import StandardScaler
        from sklearn.svm import LinearSVC
    n = len(own.blocks)
    rest = np.concatenate([other.features for other in others])
    blocks = np.concatenate([own.blocks, *(other.blocks for other in others)])
    is_own = np.arange(len(blocks)) < n
    folds = min(_FOLDS, len(np.unique(blocks)), n, len(rest))
    if folds < 2:
        return None
    random, most = np.random.default_rng(_SEED), MAX_TRAINED // 2
    values = np.full(n, np.nan)
    for train, test in StratifiedGroupKFold(folds).split(blocks, is_own, blocks):
        test, trained = test[test < n], _some(random, train[train < n], most)
        against = _some(random, train[train >= n], most) - n
        if not len(test):
            continue
        if not len(trained) or not len(against):
            return None
        classifier = make_pipeline(
            StandardScaler(), LinearSVC(dual=False, class_weight="balanced", random_state=_SEED)
        )
        features = np.concatenate([own.features[trained], rest[against]])
        classifier.fit(features.astype(np.float64), np.repeat([1, 0], [len(trained), len(against)]))
        values[test] = classifier.decision_function(own.features[test])
    return values, folds


def _some(random: np.random.Generator, places: I64, most: int) -> I64:
    return random.choice(places, most, replace=False) if len(places) > most else places


def _distances(features: F32) -> F64:
    """How far each row is from the median of all, in mean absolute deviations a feature."""
    from_median = np.abs(features - np.median(features, axis=0))
    spread = from_median.mean(axis=0, dtype=np.float64)
    varied = spread > 0
    return np.asarray(np.linalg.norm(from_median[:, varied] / spread[varied], axis=1), np.float64)
