"""Points followed over frames: left, right, and on to the next frame's left and right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .matching import LINK_RATIO, FrameMatches, mutual_matches

Float = NDArray[np.float64]
Int = NDArray[np.int64]

_REACH = 3
"""A frame is linked to this many frames before it: a point may be missed in between."""


@dataclass(frozen=True)
class Tracks:
    """Observations, each of one point in both pictures of one frame.

    Attributes
    ----------
    frames : list of int
        Frame numbers; `frame` counts through them.
    frame, point : (n,) arrays
        Which frame and which point an observation is of.
    left, right : (n, 2) arrays
        Pixels of the full frames.
    """

    frames: list[int]
    frame: Int
    point: Int
    left: Float
    right: Float

    @property
    def n_points(self) -> int:
        """Number of points."""
        return int(self.point.max()) + 1 if len(self.point) else 0

    def lengths(self) -> Int:
        """In how many frames each point is seen, (n_points,)."""
        return np.bincount(self.point, minlength=self.n_points)

    def only(self, keep: NDArray[np.bool_]) -> Tracks:
        """The observations chosen by `keep`, their points numbered anew; all frames stay."""
        point = np.unique(self.point[keep], return_inverse=True)[1]
        return Tracks(self.frames, self.frame[keep], point, self.left[keep], self.right[keep])


def build_tracks(matches: Sequence[FrameMatches]) -> Tracks:
    """Link the matches of neighbouring frames into tracks.

    Two matches are linked where their left descriptors choose each other and their right ones do
    as well. A track that comes by one frame twice is wrong somewhere and falls apart into single
    observations.
    """
    starts = np.cumsum([0, *(len(one) for one in matches)])
    links = [np.zeros((0, 2), np.int64)]
    for later in range(len(matches)):
        for earlier in range(max(0, later - _REACH), later):
            pairs = _linked(matches[earlier], matches[later])
            links.append(pairs + np.array([starts[earlier], starts[later]]))
    a, b = np.concatenate(links).T
    total = int(starts[-1])
    graph = coo_array((np.ones(len(a), bool), (a, b)), shape=(total, total))
    component = connected_components(graph, directed=False)[1].astype(np.int64)
    frame = np.repeat(np.arange(len(matches)), np.diff(starts))
    point = _without_loops(component, frame)
    return Tracks(
        [one.frame for one in matches],
        frame,
        point,
        np.concatenate([np.zeros((0, 2)), *(one.left for one in matches)]),
        np.concatenate([np.zeros((0, 2)), *(one.right for one in matches)]),
    )


def _linked(earlier: FrameMatches, later: FrameMatches) -> Int:
    """Pairs (n, 2) of matches that are one point, by the left and by the right picture."""
    left = mutual_matches(earlier.left_look, later.left_look, LINK_RATIO)
    right = mutual_matches(earlier.right_look, later.right_look, LINK_RATIO)
    both = {(int(a), int(b)) for a, b in right}
    pairs = [(int(a), int(b)) for a, b in left if (int(a), int(b)) in both]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _without_loops(component: Int, frame: Int) -> Int:
    """Number the points; observations of a component seen twice in a frame get one each."""
    visits = np.unique(np.stack([component, frame], axis=1), axis=0, return_counts=True)
    double = np.unique(visits[0][visits[1] > 1, 0])
    alone = np.isin(component, double)
    point = np.where(alone, component.max(initial=0) + 1 + np.arange(len(frame)), component)
    return np.unique(point, return_inverse=True)[1]
