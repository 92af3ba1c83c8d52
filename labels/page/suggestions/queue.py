"""The queue of frames to label next: the model is unsure of them, and no two are alike.

A frame's score is its uncertainty times how far it is from everything that is labelled or comes
before it in the queue (greedy farthest-point traversal weighted by uncertainty). Neighbour frames
of a dive are near copies: labelling one tells the model almost all about the others.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from tokt.features.common.arrays import F32, F64, I64, Bools
from tokt.features.common.errors import counted

from .suggestion_table import MissionSuggestions

_NEAR_SHARE = 0.25  # a patch is near the threshold below this share of the median distance to it
_HALF_UNSURE = 3.0  # patches on the threshold that make a frame half as unsure as can be
_MIN_UNSURE = 0.02  # so that frames the model is sure of come too, later and far apart
_ALIKE = 0.5  # standard deviations a feature, where two frames count as half the same and more
_AT_ONCE = 5.0  # frames, within which the camera still sees the same
_UNLIKE = 1.0  # standard deviations a feature; two frames of a dive taken at random: 1.4
_MAX_CANDIDATES = 3000  # the most unsure ones; what is compared with each labelled frame
_SPREAD = 2654435761  # an odd number far from simple fractions of 2**32: spreads equal ones out

_Name = tuple[str, int]


@dataclass(frozen=True)
class QueueEntry:
    """A frame to label."""

    camera: str
    frame: int
    score: float  # 0 to 1; never more than that of the entry before
    why: str  # what speaks for it, in one sentence


def next_frames(
    known: MissionSuggestions, labelled: Collection[_Name], n: int, now: _Name | None = None
) -> list[QueueEntry]:
    """The next `n` frames to label, best first; the same input gives the same queue.

    Of the frames `known` those that are `labelled` are left out, and so is `now`, which is shown:
    its near copies come late.
    """
    names = list(zip(known.cameras.tolist(), known.frames.tolist(), strict=True))
    seen = set(labelled)
    shown = {now} - seen if now else set()
    is_seen, is_shown = (
        np.fromiter((name in some for name in names), bool, len(names)) for some in (seen, shown)
    )
    free = ~is_seen & ~is_shown
    if not free.any():
        return []
    queue = _Queue(known, free)
    queue.leave(np.flatnonzero(is_seen), [frame for _, frame in seen], "labelled")
    queue.leave(np.flatnonzero(is_shown), [frame for _, frame in shown], "shown now")
    return [queue.take() for _ in range(min(n, len(queue.candidates)))]


def _unsure(values: F64, near: float) -> F64:
    """How unsure the model is of each frame, 0 to 1; decision values below `near` count."""
    share = 1 - values / max(near, 1e-300)
    sums = np.nansum(share.clip(0, None), axis=1)
    return np.asarray(_MIN_UNSURE + (1 - _MIN_UNSURE) * sums / (sums + _HALF_UNSURE))


def _candidates(unsure: F64, free: Bools) -> I64:
    """Places of the most unsure free frames, in order; of equal ones some from everywhere."""
    places = np.flatnonzero(free)
    if len(places) > _MAX_CANDIDATES:
        spread = places * _SPREAD % 2**32
        places = np.sort(places[np.lexsort((spread, -unsure[places]))][:_MAX_CANDIDATES])
    return places


class _Queue:
    """Candidates, and how alike each is to the frames that are known or taken."""

    def __init__(self, known: MissionSuggestions, free: Bools) -> None:
        # Two digits, as the reason given says them.
        known_values = known.values[~np.isnan(known.values)]
        usual = float(np.median(known_values)) if known_values.size else 0.0
        self._near = float(f"{_NEAR_SHARE * usual:.2g}")
        unsure = _unsure(known.values, self._near)
        self.candidates = candidates = _candidates(unsure, free)
        self._known = known
        self._looks = looks(known.features)
        self._own_looks = self._looks[candidates]
        self._own_places = known.places(known.frames[candidates].tolist())
        self._unsure = unsure[candidates]
        self._distance = np.full(len(candidates), np.inf, np.float32)
        self._nearest = np.full(len(candidates), -1)
        self._gap = np.full(len(candidates), np.inf)
        self._free = np.ones(len(candidates), bool)
        self._compared: dict[str, None] = {}

    def leave(self, places: I64, frames: list[int], what: str) -> None:
        """What looks like these frames (`what` they are), or was seen with them, comes late."""
        if frames:
            others = np.sort(self._known.places(frames))
            self._gap = np.minimum(self._gap, _gaps(self._own_places, others))
        if len(places):
            nearest = _nearest(self._own_looks, self._looks[places])
            self._come_near(places[nearest])
            self._compared[what] = None

    def take(self) -> QueueEntry:
        """The best candidate left."""
        alike = np.exp(-0.5 * (self._distance / _ALIKE) ** 2)
        at_once = np.exp(-((self._gap / _AT_ONCE) ** 2))
        scores = self._unsure * (1 - np.maximum(alike, at_once))
        best = int(np.where(self._free, scores, -1.0).argmax())
        place = int(self.candidates[best])
        entry = QueueEntry(
            str(self._known.cameras[place]),
            int(self._known.frames[place]),
            float(scores[best]),
            self._why(place, best),
        )
        self._free[best] = False
        self._compared["before it here"] = None
        self._come_near(np.full(len(self.candidates), place))
        self._gap = np.minimum(self._gap, np.abs(self._own_places - self._own_places[best]))
        return entry

    def _come_near(self, places: I64) -> None:
        distance = np.linalg.norm(self._own_looks - self._looks[places], axis=1)
        nearer = distance < self._distance
        self._distance[nearer], self._nearest[nearer] = distance[nearer], places[nearer]

    def _why(self, place: int, candidate: int) -> str:
        patches = (self._known.values[place] <= self._near).sum()
        number = counted(patches, "patch") if patches else "no patches"
        of_what = "of a second class" if self._known.several else "of the threshold"
        unsure = f"{number} within {self._near:g} {of_what}"
        nearest = int(self._nearest[candidate])
        if nearest < 0:
            return f"{unsure}; nothing to compare it with is labelled yet"
        if self._distance[candidate] < _UNLIKE:
            return f"{unsure}; looks most like {self._named(nearest)}"
        what = " or ".join(self._compared)
        return f"{unsure}; looks unlike anything {what} (nearest: {self._named(nearest)})"

    def _named(self, place: int) -> str:
        frame = f"frame {self._known.frames[place]}"
        several = len(set(self._known.cameras.tolist())) > 1
        return f"{self._known.cameras[place]} {frame}" if several else frame


def looks(features: F32) -> F32:
    """Frames as points: the distance of two is in standard deviations, a mean over features."""
    spread = features.std(axis=0, dtype=np.float64)
    varied = spread > 1e-9
    points = (features[:, varied] - features[:, varied].mean(axis=0)) / spread[varied]
    return np.asarray(points / np.sqrt(max(1, varied.sum())), np.float32)


def _nearest(points: F32, others: F32) -> I64:
    """For each point the index of the nearest of the others."""
    lengths = 0.5 * (others * others).sum(axis=1)
    rows = max(1, 4_000_000 // len(others))
    parts = [
        (points[start : start + rows] @ others.T - lengths).argmax(axis=1)
        for start in range(0, len(points), rows)
    ]
    return np.concatenate(parts)


def _gaps(places: I64, others: I64) -> F64:
    """For each place in the dive how far the nearest of the others, which are sorted, is."""
    after = np.searchsorted(others, places).clip(0, len(others) - 1)
    before = (after - 1).clip(0, None)
    gaps = np.minimum(np.abs(others[after] - places), np.abs(others[before] - places))
    return np.asarray(gaps, np.float64)
