"""Fit a rig to matched frames: epipolar geometry, a path, bundle adjustment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError

from .adjustment import Adjusted, Path, Problem, adjust
from .initialization import first_path, fit_epipolar
from .matching import FrameMatches
from .rig_model import DISTORTION, FOCAL, POSE, PRINCIPAL, Rig
from .tracks import Tracks, build_tracks

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


@dataclass(frozen=True)
class RigFit:
    """A fitted rig and what it was fitted to.

    Attributes
    ----------
    tracks : Tracks
        The observations that were kept.
    residual_px : (n,) array
        For each of them the length of its four residuals.
    dropped : int
        Observations thrown out as wrong.
    """

    rig: Rig
    names: tuple[str, ...]
    tracks: Tracks
    path: Path
    residual_px: NDArray[np.float64]
    dropped: int

    def problem(self, names: Sequence[str], priors: Mapping[str, float] | None = None) -> Problem:
        """The same adjustment, started where this one ended, with these numbers free."""
        return Problem(self.rig, self.tracks, self.path.anchor, names, priors or {})


def fit_rig(matches: Sequence[FrameMatches], start: Rig, free: Sequence[str] = ()) -> RigFit:
    """Fit R, the direction of T, the focal ratio and the numbers in `free`.

    Raises
    ------
    ToktError
        If too few points can be followed from frame to frame.
    """
    tracks = build_tracks(matches)
    names = (*POSE, *free)
    lens = [name for name in free if name in DISTORTION]
    # Rows say little of the yaw, and mislead where the lens model is poor; the plain rig's misses a
    # large one. Both are tried, and the points followed over frames decide.
    rough = [
        _roughly(tracks, fit_epipolar(start, tracks, [*pose, *lens]), names)
        for pose in (POSE, [name for name in POSE if name != "rotation_y"])
    ]
    found = [one for one in rough if not isinstance(one, str)]
    if not found:
        raise ToktError(str(rough[0]))
    tracks, first = min(found, key=lambda one: one[1].cost / len(one[0].point))
    observed = len(tracks.point)
    tracks, path = _without(tracks, first.path, first.residual_px > _WRONG_PX)
    last = adjust(Problem(first.rig, tracks, path.anchor, names, PRIORS), path)
    return RigFit(
        last.rig, names, tracks, last.path, last.residual_px, observed - len(tracks.point)
    )


def _roughly(tracks: Tracks, rig: Rig, names: Sequence[str]) -> tuple[Tracks, Adjusted] | str:
    """A first adjustment from a rig, wrong matches and all; or why there is none, in words."""
    path, placed = first_path(rig, tracks)
    tracks, path = _placed(tracks, path, placed)
    followed = int((tracks.lengths() > 1).sum())
    if len(tracks.frames) < _MIN_FRAMES or followed < _MIN_FOLLOWED:
        return (
            f"only {followed} points can be followed over {len(tracks.frames)} frames: too few to "
            "tell how the cameras stand; take more frames, nearer to something solid"
        )
    return tracks, adjust(Problem(rig, tracks, path.anchor, names, PRIORS), path)


def _placed(tracks: Tracks, path: Path, placed: NDArray[np.bool_]) -> tuple[Tracks, Path]:
    """Only the frames that have a pose, and the points seen in them."""
    keep = placed[tracks.frame]
    points = np.unique(tracks.point[keep])
    new = np.cumsum(placed) - 1
    frames = [frame for frame, good in zip(tracks.frames, placed, strict=True) if good]
    moved = Tracks(frames, new[tracks.frame], tracks.point, tracks.left, tracks.right)
    return moved.only(keep), Path(
        path.rotation_vectors[placed],
        path.shifts_m[placed],
        path.points_m[points],
        int(new[path.anchor]),
    )


def _without(tracks: Tracks, path: Path, wrong: NDArray[np.bool_]) -> tuple[Tracks, Path]:
    points = np.unique(tracks.point[~wrong])
    kept = Path(path.rotation_vectors, path.shifts_m, path.points_m[points], path.anchor)
    return tracks.only(~wrong), kept
