"""Points that both cameras see, found without knowing the cameras, and followed over frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tokt.features.common.arrays import F32, F64, I64, U8, Bools
from tokt.features.common.errors import FrameError
from tokt.features.frames.mission import LEFT, RIGHT, Mission

_HALVED_FROM = 1000
"""Frames this wide are matched at half resolution: SIFT doubles the picture by itself, and the
noise of neighbouring pixels, which a nearly black frame is full of, averages out."""
_LOCAL_PX = 12.0  # spread of the window of the local contrast, in pixels of a view 680 wide
_NOISE_LEVELS = 2.0  # local contrast in grey levels that is taken for noise rather than enlarged
_GAIN, _MIDDLE = 50.0, 128.0
_MAX_FEATURES = 3000
_RATIO = 0.8
LINK_RATIO = 0.85
"""Lowe's ratio between cameras, and between frames, where only matched features compete."""
_EPIPOLAR_PX = 3.0
"""Full-resolution distance to the epipolar line of the frame's own fundamental matrix."""
_WINDOW_PX = 11
_STEPS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.005)
_RETURN_PX, _MOVE_PX = 0.5, 4.0
"""Window in pixels of the view in which a match is made exact; how far from its start, in px of the
full frame, it may come back from the other view, and move from where SIFT had it."""
_MIN_MATCHES = 16
"""A fundamental matrix has 7 degrees of freedom: from fewer matches it would fit anything."""
_REACH = 3  # a frame is linked to this many frames before it: a point may be missed in between


@dataclass(frozen=True)
class FramePoints:
    """Points of one frame that both cameras see, in the same order."""

    frame: int
    left: F64  # (n, 2): pixels of the full frame; the centre of the first pixel is (0, 0)
    right: F64  # (n, 2)

    def __len__(self) -> int:
        return len(self.left)


@dataclass(frozen=True)
class FrameMatches(FramePoints):
    """Points found by their looks."""

    left_look: F32  # (n, 128): SIFT descriptors
    right_look: F32  # (n, 128)


def view_scale(width: int) -> float:
    """Pixels of the view that is matched for one pixel of a frame of this width."""
    return 0.5 if width >= _HALVED_FROM else 1.0


def gray_frame(mission: Mission, frame: int, camera: str) -> U8:
    """One frame in grey levels. Raises FrameError if it cannot be read."""
    image = mission.read(frame, camera)
    if image.ndim == 3:
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    return image


def gray_view(mission: Mission, frame: int, camera: str) -> tuple[F32, tuple[int, int]]:
    """One frame in grey levels, not rounded, at `view_scale`; and the frame's width and height.

    Raises FrameError if it cannot be read.
    """
    image = gray_frame(mission, frame, camera)
    height, width = image.shape
    scale = view_scale(width)
    size = (round(width * scale), max(1, round(height * scale)))
    view = cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return np.asarray(view, np.float32), (width, height)


def even_contrast_gaussian(view: F32) -> U8:
    """A view with its background removed and its local contrast made even."""
    spread = _LOCAL_PX * view.shape[1] / 680
    detail = view - cv2.GaussianBlur(view, (0, 0), spread)
    contrast = cv2.sqrt(cv2.GaussianBlur(detail * detail, (0, 0), spread))
    even = detail / (contrast + _NOISE_LEVELS)
    return np.asarray(np.clip(even * _GAIN + _MIDDLE, 0, 255), np.uint8)


def match_frame(mission: Mission, frame: int, frame_size: tuple[int, int]) -> FrameMatches | None:
    """Match the two pictures of one frame: ratio, mutual choice, exact place, one geometry.

    SIFT's places are off by half a pixel and more; Lucas and Kanade's method moves the right one to
    where the left one's surroundings are, and must lead back from there. The geometry is a
    fundamental matrix of this frame's own matches (USAC MAGSAC++), so that no calibration decides
    which matches another one is judged on.

    None where the frame cannot be read, is of another size than `frame_size` (width, height), or
    has too few matches for a geometry.
    """
    try:
        (left_view, size), (right_view, right_size) = (
            gray_view(mission, frame, camera) for camera in (LEFT, RIGHT)
        )
    except FrameError:
        return None
    if size != frame_size or right_size != frame_size:
        return None
    scale = view_scale(frame_size[0])
    views = even_contrast_gaussian(left_view), even_contrast_gaussian(right_view)
    (left, left_look), (right, right_look) = (_features(view) for view in views)
    a, b = mutual_matches(left_look, right_look, _RATIO).T
    if len(a) < _MIN_MATCHES:
        return None
    exact, good = _exact(views, left[a], right[b], scale)
    a, b = a[good], b[good]
    places = (left[a] + 0.5) / scale - 0.5, (exact[good] + 0.5) / scale - 0.5
    if len(a) < _MIN_MATCHES:
        return None
    fit = _one_geometry(*places)
    if fit.sum() < _MIN_MATCHES:
        return None
    return FrameMatches(
        frame, places[0][fit], places[1][fit], left_look[a[fit]], right_look[b[fit]]
    )


def _features(view: U8) -> tuple[F64, F32]:
    """SIFT features of a view: its pixels (n, 2) and descriptors (n, 128)."""
    sift = cv2.SIFT.create(_MAX_FEATURES, enable_precise_upscale=True)
    found: tuple[Any, Any] = sift.detectAndCompute(view, None)
    keypoints, looks = found
    if looks is None:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    return np.array([keypoint.pt for keypoint in keypoints], np.float64), looks


def _exact(views: tuple[U8, U8], at: F64, near: F64, scale: float) -> tuple[F64, Bools]:
    """Where in the right view, starting from `near`, the surroundings of `at` in the left are."""
    start, guess = at.astype(np.float32)[:, None], near.astype(np.float32)[:, None]
    found, there, _ = _follow(*views, start, guess)
    back, again, _ = _follow(*views[::-1], found, start)
    returned = np.linalg.norm((back - start)[:, 0], axis=1) / scale <= _RETURN_PX
    moved = np.linalg.norm((found - guess)[:, 0], axis=1) / scale <= _MOVE_PX
    good = (there.ravel() > 0) & (again.ravel() > 0) & returned & moved
    return found[:, 0].astype(np.float64), good


def _follow(
    a: U8, b: U8, start: F32, guess: F32
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    return cv2.calcOpticalFlowPyrLK(
        a, b, start, guess.copy(),
        winSize=(_WINDOW_PX, _WINDOW_PX), maxLevel=0, criteria=_STEPS,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip


def mutual_matches(a: F32, b: F32, ratio: float) -> I64:
    """Pairs (n, 2) of rows of `a` and `b` that choose each other, clearly before the next best."""
    if len(a) < 2 or len(b) < 2:
        return np.zeros((0, 2), np.int64)
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    back = {match.queryIdx: match.trainIdx for match in matcher.match(b, a)}
    pairs = [
        (best.queryIdx, best.trainIdx)
        for best, second in matcher.knnMatch(a, b, k=2)
        if best.distance < ratio * second.distance and back[best.trainIdx] == best.queryIdx
    ]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _one_geometry(left: F64, right: F64) -> Bools:
    """Which matches fit one epipolar geometry; none where there is none to be found."""
    try:
        mask = cv2.findFundamentalMat(left, right, cv2.USAC_MAGSAC, _EPIPOLAR_PX, 0.999, 5000)[1]
    except cv2.error:  # matches that hold no model: a plane, many of one point
        mask = None
    if mask is None:
        return np.zeros(len(left), bool)
    return np.asarray(mask.ravel() > 0)


@dataclass(frozen=True)
class Tracks:
    """Observations, each of one point in both pictures of one frame."""

    frames: list[int]  # frame numbers; `frame` counts through them
    frame: I64  # (n,): which frame an observation is of
    point: I64  # (n,): and which point
    left: F64  # (n, 2): pixels of the full frames
    right: F64  # (n, 2)

    @property
    def n_points(self) -> int:
        """Number of points."""
        return int(self.point.max()) + 1 if len(self.point) else 0

    def lengths(self) -> I64:
        """In how many frames each point is seen, (n_points,)."""
        return np.bincount(self.point, minlength=self.n_points)

    def only(self, keep: Bools) -> Tracks:
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


def _linked(earlier: FrameMatches, later: FrameMatches) -> I64:
    """Pairs (n, 2) of matches that are one point, by the left and by the right picture."""
    left = mutual_matches(earlier.left_look, later.left_look, LINK_RATIO)
    right = mutual_matches(earlier.right_look, later.right_look, LINK_RATIO)
    both = {(int(a), int(b)) for a, b in right}
    pairs = [(int(a), int(b)) for a, b in left if (int(a), int(b)) in both]
    return np.array(pairs, np.int64).reshape(-1, 2)


def _without_loops(component: I64, frame: I64) -> I64:
    """Number the points; observations of a component seen twice in a frame get one each."""
    visits = np.unique(np.stack([component, frame], axis=1), axis=0, return_counts=True)
    double = np.unique(visits[0][visits[1] > 1, 0])
    alone = np.isin(component, double)
    point = np.where(alone, component.max(initial=0) + 1 + np.arange(len(frame)), component)
    return np.unique(point, return_inverse=True)[1]
