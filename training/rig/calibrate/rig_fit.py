"""Fit a rig to matched frames: epipolar geometry, a path, bundle adjustment."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares

from tokt.features.common.arrays import F64, Bools
from tokt.features.common.errors import ToktError

from .adjustment import Adjusted, Path, Problem, adjust
from .matching import FrameMatches, Tracks, build_tracks
from .rig_model import DISTORTION, FOCAL, POSE, PRINCIPAL, Rig

PRIORS: Mapping[str, float] = {
    **dict.fromkeys(DISTORTION, 0.5),
    **dict.fromkeys(PRINCIPAL, 30.0),
    **dict.fromkeys(FOCAL, 200.0),
}
"""Deviation about its start within which a number is believed to lie before any data: a camera
in air has k1 and k2 of about 0; behind a flat port in water a pinhole has 0.40 and 0.24."""
_WRONG_PX = 4.0
"""An observation that is this far off once the rig fits is a wrong match, and dropped."""
_MIN_FRAMES = 3
_MIN_FOLLOWED = 30
_BELIEFS = {
    "rotation_y": 0.02,
    "direction_y": 0.1,
    "direction_z": 0.1,
    "focal_ratio": 0.02,
    "k1": 0.5,
    "k2": 0.5,
}
"""Deviation about its start, in rad or as a ratio, that a number is given before any match."""
_NEAREST_M, _FARTHEST_M = 0.2, 60.0
_MIN_SHARED = 8
_PNP_PX = 4.0


def epipolar_px(rig: Rig, left: F64, right: F64) -> F64:
    """Signed Sampson distance in pixels of each match from the rig's epipolar geometry, (n,)."""
    a, b = (np.hstack([rays, np.ones((len(rays), 1))]) for rays in rig.rays(left, right))
    t = rig.translation_m()
    t = t / np.linalg.norm(t)
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    E = cross @ rig.rotation()
    forth, back = a @ E.T, b @ E
    length = np.sqrt(np.square(forth[:, :2]).sum(axis=1) + np.square(back[:, :2]).sum(axis=1))
    # On the scale of rows: a match that is off by 1 px in one picture counts 1 px.
    error = np.sum(b * forth, axis=1) / np.maximum(length, 1e-12) * np.sqrt(2)
    return np.asarray(error * rig.values["focal"])


def fit_epipolar(rig: Rig, tracks: Tracks, names: Sequence[str]) -> Rig:
    """Fit the named numbers to the matches of single frames, robustly.

    Weak beliefs keep what epipolar geometry says little of, above all the yaw, from running away.
    """
    start = rig.vector(names)
    weights = np.array([1 / _BELIEFS.get(name, np.inf) for name in names])

    def residuals(vector: F64) -> F64:
        moved = rig.moved(names, vector)
        return np.append(epipolar_px(moved, tracks.left, tracks.right), weights * (vector - start))

    vector = start
    for width_px in (30.0, 3.0, 1.0):
        vector = least_squares(
            residuals, vector, loss="soft_l1", f_scale=width_px, x_scale="jac", diff_step=1e-6
        ).x
    return rig.moved(names, vector)


def triangulate(rig: Rig, tracks: Tracks) -> F64:
    """Points (n, 3) of each observation in the left camera's axes, in metres.

    The middle of the shortest line between both rays; where the rays part, the point is put far
    away in front rather than behind the camera.
    """
    left, right = rig.rays(tracks.left, tracks.right)
    a = np.hstack([left, np.ones((len(left), 1))])
    b = np.hstack([right, np.ones((len(right), 1))]) @ rig.rotation()
    from_right = -rig.rotation().T @ rig.translation_m()
    aa, ab, bb = (a * a).sum(1), (a * b).sum(1), (b * b).sum(1)
    ac, bc = a @ from_right, b @ from_right
    # s a = c + u b in the least squares sense, by the inverse of s: no sign change at infinity.
    part, reach = aa * bb - ab * ab, bb * ac - ab * bc
    nearness = part / np.where(np.abs(reach) > 1e-12, reach, 1e-12)
    nearness = np.clip(nearness, 1 / _FARTHEST_M, 1 / _NEAREST_M)
    return np.asarray(a / nearness[:, None])


def first_path(rig: Rig, tracks: Tracks) -> tuple[Path, Bools]:
    """Place frame after frame by the points it shares with those already placed.

    The flags, (n_frames,), tell the frames that share enough points with the rest.
    """
    n_frames = len(tracks.frames)
    rays = rig.rays(tracks.left, tracks.right)[0]
    near = triangulate(rig, tracks)
    shared = tracks.lengths()[tracks.point] > 1
    anchor = int(np.bincount(tracks.frame[shared], minlength=n_frames).argmax())
    rotations, shifts = np.zeros((n_frames, 3)), np.zeros((n_frames, 3))
    world = np.full((tracks.n_points, 3), np.nan)
    placed = np.zeros(n_frames, bool)
    order = [anchor, *range(anchor + 1, n_frames), *range(anchor - 1, -1, -1)]
    for one in order:
        here = np.flatnonzero(tracks.frame == one)
        point = tracks.point[here]
        known = np.isfinite(world[point, 0])
        if one != anchor:
            pose = _pose(world[point[known]], rays[here[known]], rig.values["focal"])
            if pose is None:
                continue
            rotations[one], shifts[one] = pose
        placed[one] = True
        R = cv2.Rodrigues(rotations[one])[0]
        new = here[~known]
        world[tracks.point[new]] = (near[new] - shifts[one]) @ R
    return Path(rotations, shifts, world, anchor), placed


def _pose(points_m: F64, rays: F64, focal_px: float) -> tuple[F64, F64] | None:
    """Rotation vector and shift of a camera that sees world points along rays; None if unclear."""
    if len(points_m) < _MIN_SHARED:
        return None
    how: Any = {"iterationsCount": 300, "reprojectionError": _PNP_PX / focal_px}
    try:
        good, turn, shift, inliers = cv2.solvePnPRansac(points_m, rays, np.eye(3), None, **how)
        if not good or inliers is None or len(inliers) < _MIN_SHARED:
            return None
        some = inliers.ravel()
        turn, shift = cv2.solvePnPRefineLM(points_m[some], rays[some], np.eye(3), None, turn, shift)
    except cv2.error:  # points that hold no pose
        return None
    return np.asarray(turn, np.float64).ravel(), np.asarray(shift, np.float64).ravel()


@dataclass(frozen=True)
class RigFit:
    """A fitted rig and what it was fitted to."""

    rig: Rig
    names: tuple[str, ...]
    tracks: Tracks  # the observations that were kept
    path: Path
    residual_px: F64  # (n,): for each of them the length of its four residuals
    dropped: int  # observations thrown out as wrong

    def problem(self, names: Sequence[str], priors: Mapping[str, float] | None = None) -> Problem:
        """The same adjustment, started where this one ended, with these numbers free."""
        return Problem(self.rig, self.tracks, self.path.anchor, names, priors or {})


def fit_rig(matches: Sequence[FrameMatches], start: Rig, free: Sequence[str] = ()) -> RigFit:
    """Fit R, the direction of T, the focal ratio and the numbers in `free`.

    Raises ToktError if too few points can be followed from frame to frame.
    """
    tracks = build_tracks(matches)
    names = (*POSE, *free)
    lens = [name for name in free if name in DISTORTION]
    # Rows say little of the yaw, and mislead where the lens model is poor; the plain rig's misses a
    # large one. Both are tried, and the points followed over frames decide.
    rough = [
        fit_path(tracks, fit_epipolar(start, tracks, [*pose, *lens]), names)
        for pose in (POSE, [name for name in POSE if name != "rotation_y"])
    ]
    found = [one for one in rough if not isinstance(one, str)]
    if not found:
        raise ToktError(str(rough[0]))
    tracks, first = min(found, key=lambda one: one[1].cost / len(one[0].point))
    observed = len(tracks.point)
    tracks, path = _only(tracks, first.path, ~(first.residual_px > _WRONG_PX))
    last = adjust(Problem(first.rig, tracks, path.anchor, names, PRIORS), path)
    return RigFit(
        last.rig, names, tracks, last.path, last.residual_px, observed - len(tracks.point)
    )


def fit_path(tracks: Tracks, rig: Rig, names: Sequence[str]) -> tuple[Tracks, Adjusted] | str:
    """Fit the path, and the named numbers, wrong matches and all; or why it cannot be, in words."""
    path, placed = first_path(rig, tracks)
    tracks, path = _placed(tracks, path, placed)
    followed = int((tracks.lengths() > 1).sum())
    if len(tracks.frames) < _MIN_FRAMES or followed < _MIN_FOLLOWED:
        return (
            f"only {followed} points can be followed over {len(tracks.frames)} frames: too few to "
            "tell a path; take more frames, nearer to something solid"
        )
    return tracks, adjust(Problem(rig, tracks, path.anchor, names, PRIORS), path)


def _placed(tracks: Tracks, path: Path, placed: Bools) -> tuple[Tracks, Path]:
    """Only the frames that have a pose, and the points seen in them."""
    tracks, path = _only(tracks, path, placed[tracks.frame])
    new = np.cumsum(placed) - 1
    frames = [frame for frame, good in zip(tracks.frames, placed, strict=True) if good]
    poses = path.rotation_vectors[placed], path.shifts_m[placed]
    moved = Path(*poses, path.points_m, int(new[path.anchor]))
    return replace(tracks, frames=frames, frame=new[tracks.frame]), moved


def _only(tracks: Tracks, path: Path, keep: Bools) -> tuple[Tracks, Path]:
    points = np.unique(tracks.point[keep])
    return tracks.only(keep), replace(path, points_m=path.points_m[points])
