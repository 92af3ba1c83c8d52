"""Bundle adjustment of a rig, the vehicle's path and the points it saw."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse import bsr_array, csc_array, csr_array

from tokt.features.common.arrays import F64

from .matching import Tracks
from .rig_model import Rig

LOSS_PX = 1.0
"""An observation that is this far off, in px of the full frame, counts half (Cauchy loss)."""
_MAX_DAMPING = 1e8
_ENOUGH_GAIN = 1e-6
_ROUNDS = 60


@dataclass(frozen=True)
class Path:
    """Poses of the left camera: a world point p is at ``rotation @ p + shift`` for it."""

    rotation_vectors: F64  # (n_frames, 3)
    shifts_m: F64  # (n_frames, 3)
    points_m: F64  # (n_points, 3): in the world, the left camera's own axes in frame `anchor`
    anchor: int


class Problem:
    """The residuals of an adjustment and their sparse Jacobian.

    The vector is: the rig's free numbers by their `names`, six numbers for each frame but the
    anchor (rotation vector, then shift in metres), three for each point. `priors` are standard
    deviations of free numbers about their start values.
    """

    def __init__(
        self,
        rig: Rig,
        tracks: Tracks,
        anchor: int,
        names: Sequence[str],
        priors: Mapping[str, float],
    ) -> None:
        self.rig, self.tracks, self.anchor, self.names = rig, tracks, anchor, list(names)
        self.n_rig, self.n_frames = len(self.names), len(tracks.frames)
        self.n_poses = 6 * (self.n_frames - 1)
        self._seen = np.hstack([tracks.left, tracks.right])
        self._start = rig.vector(self.names)
        self._weights = {self.names.index(n): 1 / s for n, s in priors.items() if n in self.names}
        self._index()

    def _index(self) -> None:
        """Where the Jacobian's numbers stand; the anchor's pose, which is fixed, is cut off."""
        tracks = self.tracks
        slot = tracks.frame - (tracks.frame > self.anchor)
        poses = self.n_rig + 6 * slot[:, None] + np.arange(6)
        self._moves = tracks.frame != self.anchor
        poses[~self._moves] = self.n_rig
        points = self.n_rig + self.n_poses + 3 * tracks.point[:, None] + np.arange(3)
        rig = np.broadcast_to(np.arange(self.n_rig), (len(slot), self.n_rig))
        columns = np.hstack([rig, poses, points])
        self._columns = np.repeat(columns, 4, axis=0).ravel()
        self._width = columns.shape[1]

    @property
    def size(self) -> int:
        """Length of the vector."""
        return self.n_rig + self.n_poses + 3 * self.tracks.n_points

    def pack(self, path: Path) -> F64:
        """The vector of the start rig and a path."""
        poses = np.hstack([path.rotation_vectors, path.shifts_m])
        poses = np.delete(poses, self.anchor, axis=0)
        return np.concatenate([self._start, poses.ravel(), path.points_m.ravel()])

    def unpack(self, vector: F64) -> tuple[Rig, Path]:
        """Rig and path of a vector."""
        rig = self.rig.moved(self.names, vector[: self.n_rig])
        poses = vector[self.n_rig : self.n_rig + self.n_poses].reshape(-1, 6)
        poses = np.insert(poses, self.anchor, 0.0, axis=0)
        points = vector[self.n_rig + self.n_poses :].reshape(-1, 3)
        return rig, Path(poses[:, :3], poses[:, 3:], points, self.anchor)

    def residuals(self, vector: F64) -> F64:
        """Pixels between where points are seen and where they should be, then the priors'."""
        rig, path = self.unpack(vector)
        rotations = _rotations(path.rotation_vectors)[0]
        pixels = rig.project(self._in_camera(path, rotations)) - self._seen
        priors = [w * (vector[i] - self._start[i]) for i, w in self._weights.items()]
        return np.concatenate([pixels.ravel(), priors])

    def lengths(self, residuals: F64) -> F64:
        """For each observation the length of its four residuals, (n,)."""
        seen = residuals[: 4 * len(self.tracks.frame)].reshape(-1, 4)
        return np.asarray(np.linalg.norm(seen, axis=1))

    def cost(self, residuals: F64) -> float:
        """Cauchy loss of the observations, plus the priors' squares."""
        seen = LOSS_PX**2 * np.log1p(np.square(self.lengths(residuals) / LOSS_PX)).sum()
        return float(seen + np.square(residuals[4 * len(self.tracks.frame) :]).sum()) / 2

    def weights(self, residuals: F64, variance: float = 1.0) -> F64:
        """Weight of each residual in the next step (reweighted least squares).

        The priors count as they should beside residuals of this variance (px squared).
        """
        seen = 1 / (1 + np.square(self.lengths(residuals) / LOSS_PX))
        return np.append(np.repeat(seen, 4), np.full(len(self._weights), variance))

    def jacobian(self, vector: F64) -> csr_array:
        """Derivative of `residuals`, sparse."""
        rig, path = self.unpack(vector)
        rotations, turned = _rotations(path.rotation_vectors)
        frame, point = self.tracks.frame, self.tracks.point
        by_rig, by_camera = rig.slopes(self._in_camera(path, rotations), self.names)
        # d(R p) by the rotation vector: R's derivative (3, 3, 3) applied to the point.
        spin = np.einsum("nijk,nj->nik", turned[frame], path.points_m[point])
        by_pose = np.concatenate([by_camera @ spin, by_camera], axis=2)
        by_pose[~self._moves] = 0.0
        by_point = by_camera @ rotations[frame]
        data = np.concatenate([by_rig, by_pose, by_point], axis=2).ravel()
        n_rows = 4 * len(frame)
        indptr = np.arange(n_rows + 1) * self._width
        extra = len(self._weights)
        data = np.append(data, list(self._weights.values()))
        columns = np.append(self._columns, np.array(list(self._weights), self._columns.dtype))
        indptr = np.append(indptr, indptr[-1] + 1 + np.arange(extra))
        shape = (n_rows + extra, self.size)
        matrix = csr_array((data, columns, indptr), shape=shape)
        matrix.sum_duplicates()
        return matrix

    def _in_camera(self, path: Path, rotations: F64) -> F64:
        frame, point = self.tracks.frame, self.tracks.point
        turned = np.einsum("nij,nj->ni", rotations[frame], path.points_m[point])
        return np.asarray(turned + path.shifts_m[frame])


def _rotations(vectors: F64) -> tuple[F64, F64]:
    """Rotation matrices (n, 3, 3), and their derivatives (n, 3, 3, 3): the last axis is by what."""
    pairs = [cv2.Rodrigues(vector) for vector in vectors]
    matrices = np.array([matrix for matrix, _ in pairs])
    slopes = np.array([slope for _, slope in pairs])  # (n, 3, 9): by vector, then R row by row
    return matrices, slopes.reshape(-1, 3, 3, 3).transpose(0, 2, 3, 1)


@dataclass(frozen=True)
class Adjusted:
    """Result of an adjustment."""

    rig: Rig
    path: Path
    residual_px: F64  # (n,): for each observation the length of its four residuals
    cost: float  # what was minimised


def adjust(problem: Problem, path: Path) -> Adjusted:
    """Minimise the residuals under a Cauchy loss, so that wrong matches count little.

    Levenberg and Marquardt's method. Each point touches only its own observations, so the points
    are eliminated first (Schur complement; Triggs et al. 2000, Bundle adjustment, section 6.1) and
    what is solved is dense and small. scipy's least_squares, which solves the whole sparse system
    by LSMR, comes to the same (0.1 % less) in 11 s of processor or more where this takes 2 s (23
    frames of the 2016 mission), and a calibration adjusts some ten times; with its own Cauchy
    loss it had got nowhere after 60 evaluations. A test holds the end against it.
    """
    vector, damping = problem.pack(path), 1e-3
    residuals = problem.residuals(vector)
    cost = problem.cost(residuals)
    for _ in range(_ROUNDS):
        system = _Normal(problem, vector, residuals)
        while damping < _MAX_DAMPING:
            try:
                step = system.solve(damping)
            except LinAlgError:  # too little damping for a system that rounding made indefinite
                damping *= 10
                continue
            tried = problem.residuals(vector + step)
            tried_cost = problem.cost(tried)
            if tried_cost < cost:
                break
            damping *= 4
        else:
            break
        gain = (cost - tried_cost) / cost
        vector, residuals, cost = vector + step, tried, tried_cost
        damping = max(damping / 5, 1e-9)
        if gain < _ENOUGH_GAIN:
            break
    rig, end = problem.unpack(vector)
    return Adjusted(rig, end, problem.lengths(residuals), cost)


def rig_covariance(problem: Problem, path: Path) -> F64:
    """Covariance (n_names, n_names) of the rig's free numbers at the problem's rig and `path`.

    Path and points are free as well. From the Jacobian, for residuals of the size they have: what
    the camera model itself leaves out is not in it.
    """
    vector = problem.pack(path)
    residuals = problem.residuals(vector)
    seen = slice(0, 4 * len(problem.tracks.frame))
    weighted = (problem.weights(residuals) * np.square(residuals))[seen].sum()
    variance = float(weighted / max(1, seen.stop - problem.size))
    return np.asarray(_Normal(problem, vector, residuals, variance).rig_covariance() * variance)


class _Normal:
    """The normal equations at one vector, weighted by the loss."""

    def __init__(
        self, problem: Problem, vector: F64, residuals: F64, variance: float = 1.0
    ) -> None:
        self.n_rig, n = problem.n_rig, problem.n_rig + problem.n_poses
        root = np.sqrt(problem.weights(residuals, variance))
        jacobian = problem.jacobian(vector).multiply(root[:, None]).tocsc()
        weighted = residuals * root
        near, far = jacobian[:, :n], jacobian[:, n:]
        self.A = np.asarray((near.T @ near).toarray())
        self.B = (near.T @ far).tocsr()
        self.C = _point_blocks(far)
        self.a, self.c = near.T @ weighted, far.T @ weighted

    def solve(self, damping: float) -> F64:
        """The step that reduces the cost, for a damping relative to the diagonals."""
        C = self.C + damping * self.C * np.eye(3)
        A = self.A + np.diag(damping * np.diag(self.A) + 1e-12)
        inverse = _inverse(C)
        left = self.B @ inverse
        S = A - (left @ self.B.T).toarray()
        first = cho_solve(cho_factor(S), left @ self.c - self.a)
        return np.concatenate([first, -(inverse @ (self.c + self.B.T @ first))])

    def rig_covariance(self) -> F64:
        """Covariance of the rig's numbers, for residuals of unit deviation."""
        inverse = _inverse(self.C + 1e-9 * np.eye(3))
        S = self.A - (self.B @ inverse @ self.B.T).toarray()
        return np.linalg.pinv(S, hermitian=True)[: self.n_rig, : self.n_rig]


def _point_blocks(far: csc_array) -> F64:
    """The (n_points, 3, 3) diagonal blocks of far' far, which has no others."""
    product = (far.T @ far).tobsr((3, 3))
    blocks = np.zeros((far.shape[1] // 3, 3, 3))
    blocks[product.indices] = product.data
    return blocks


def _inverse(blocks: F64) -> csr_array:
    """The inverse of a block-diagonal matrix, given its (n, 3, 3) blocks."""
    n = len(blocks)
    parts = np.linalg.inv(blocks), np.arange(n), np.arange(n + 1)
    return bsr_array(parts, shape=(3 * n, 3 * n)).tocsr()
