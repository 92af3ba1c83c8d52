"""Calibrate a stereo rig from a mission's own frames."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from tokt import __version__
from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import Mission, format_frames, frame_size
from tokt.inference.stereo.calibration import StereoCalibration

from .frame_selection import Progress, match_mission
from .matching import FrameMatches
from .parameter_uncertainty import ParameterUncertainty, parameter_uncertainty
from .rig_fit import RigFit, fit_rig
from .rig_model import DISTORTION, FOCAL, PRINCIPAL, Rig
from .vertical_error import VerticalError, raw_error, vertical_error

PARTS = ("alternate", "even", "odd", "all")
BASELINE_MM = 305.5
"""Distance between the mission cameras (thesis, table 3.4: the length of T)."""
FOCAL_PX, FOCAL_WIDTH = 2222.7, 1360
"""Focal length in water of the mission cameras (thesis, table 3.3), at their frame width."""
_FREE_NAMES = {"k1": ("k1",), "k2": ("k2",), "focal": FOCAL, "principal": PRINCIPAL}


@dataclass(frozen=True)
class StartingRig:
    """The cameras that a calibration starts from."""

    rig: Rig
    words: str  # where it comes from
    free: tuple[str, ...]  # what is estimated besides R, the direction of T and the focal ratio
    calibration: StereoCalibration | None = None  # a usable one: what `before` is measured with


def parse_free(text: str) -> tuple[str, ...]:
    """Read ``k1,k2,focal,principal``, or ``none``; ToktError if a name is none of these."""
    if text.strip() == "none":
        return ()
    names: list[str] = []
    for word in text.split(","):
        if word.strip() not in _FREE_NAMES:
            known = ", ".join(_FREE_NAMES)
            raise ToktError(f"{word.strip()!r} cannot be freed (choose from {known}, or none)")
        names += _FREE_NAMES[word.strip()]
    return tuple(dict.fromkeys(names))


def plain_start(
    mission: Mission, baseline_mm: float, focal_px: float | None, free: tuple[str, ...] | None
) -> StartingRig:
    """Two equal cameras of a known focal length; the lens distortion is estimated."""
    size = frame_size(mission)
    focal = focal_px or FOCAL_PX * size[0] / FOCAL_WIDTH
    words = f"f = {focal:.1f} px{'' if focal_px else ' (the mission cameras of 2016)'}"
    rig = Rig.plain(focal, baseline_mm, size)
    freed = DISTORTION if free is None else free
    return StartingRig(rig, f"{words}, principal point at the centre", freed)


def start_from(
    given: StereoCalibration,
    usable: bool,
    mission: Mission,
    baseline_mm: float,
    free: tuple[str, ...] | None,
) -> StartingRig:
    """Cameras as a calibration file has them; only how they stand is estimated, by default.

    Of a calibration that cannot be used as it is, as that printed in the thesis, only f, k1 and
    k2 are taken.

    Raises ToktError if it is of frames of another size, or its lenses need more than five numbers.
    """
    size = frame_size(mission)
    if given.frame_size != size:
        raise ToktError(
            f"the calibration to start from is of {given.frame_size[0]}x{given.frame_size[1]} "
            f"frames, the mission's are {size[0]}x{size[1]}"
        )
    freed = () if free is None else free
    K, D = (given.K1, given.K2), (given.D1, given.D2)
    if usable:
        if any(d[5:].any() for d in D):
            raise ToktError(
                "a start with more than k1 k2 p1 p2 k3 of distortion cannot be adjusted"
            )
        rig = Rig.from_cameras(K, D, baseline_mm, size)
        return StartingRig(rig, "cameras as given, their standing to each other anew", freed, given)
    x, y = ((length - 1) / 2 for length in size)
    left, right = (np.array([[k[0, 0], 0, x], [0, k[0, 0], y], [0, 0, 1]]) for k in K)
    rig = Rig.from_cameras((left, right), (D[0][:2], D[1][:2]), baseline_mm, size)
    return StartingRig(
        rig, "f, k1 and k2 as given; principal point at the centre, square pixels", freed
    )


@dataclass(frozen=True)
class SelfCalibration:
    """A calibration from a mission's frames, and how far it can be trusted."""

    mission: str
    start: StartingRig
    part: str
    fit: RigFit  # what `calibration` is from
    fit_part: RigFit  # the rig that `after` is of
    fit_frames: list[int]
    test_frames: list[int]
    held_out: bool  # whether the test frames had no part in the rig that `after` is of
    matches: list[FrameMatches]
    before: VerticalError  # on `test_frames`, without it
    after: VerticalError  # on `test_frames`, with the rig fitted to `fit_frames` alone
    own: VerticalError  # of `calibration` on all matched frames
    uncertainty: ParameterUncertainty
    seconds: float

    @property
    def calibration(self) -> StereoCalibration:
        """The cameras, as the rest of the program uses them."""
        return self.fit.rig.calibration()

    @property
    def test_matches(self) -> list[FrameMatches]:
        """The matches that `before` and `after` are of."""
        tested = set(self.test_frames)
        return [one for one in self.matches if one.frame in tested]

    def split_words(self) -> str:
        """How fit and test were kept apart, for people."""
        if not self.held_out:
            return "NOT held out: measured on the frames it was fitted to"
        words = (
            f"fitted to {len(self.fit_frames)} frames ({_frame_words(self.fit_frames)}), tested "
            f"on {len(self.test_frames)} others ({_frame_words(self.test_frames)})"
        )
        if self.part == PARTS[0]:
            return f"{words}; the calibration itself is then fitted to all of them"
        return f"{words}; the calibration is that of the fitted frames"

    def notes(self) -> dict[str, str]:
        """How it was made, for the calibration's file."""
        return {
            "made_by": f"tokt {__version__} calibrate, from the frames of mission {self.mission}",
            "start": self.start.words,
            "split": self.split_words(),
            "vertical_error": (
                f"median {self.after.median_px:.2f} px, p90 {self.after.p90_px:.2f} px, "
                f"{'held out' if self.held_out else 'NOT held out'}"
            ),
            "baseline": f"{self.fit.rig.baseline_mm:g} mm as given: pictures have no scale",
        }

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {
            "mission": self.mission,
            "start": self.start.words,
            "baseline_mm": self.fit.rig.baseline_mm,
            "fit": self.part,
            "fit_frames": format_frames(self.fit_frames),
            "test_frames": format_frames(self.test_frames),
            "held_out": self.held_out,
            "calibration_from": format_frames(self.fit.tracks.frames),
            "points": self.fit.tracks.n_points,
            "followed_points": int((self.fit.tracks.lengths() > 1).sum()),
            "observations": len(self.fit.tracks.point),
            "dropped_observations": self.fit.dropped,
            "vertical_error": {
                "before": self.before.figures(),
                "after": self.after.figures(),
                "before_by_region": self.before.by_region(),
                "after_by_region": self.after.by_region(),
                "calibration_on_all_frames": self.own.figures(),
                "unit": "px of the full frame",
            },
            **asdict(self.uncertainty),
            "seconds": round(self.seconds, 1),
        }


def self_calibrate(
    mission: Mission,
    start: StartingRig,
    progress: Progress,
    frames: Sequence[int] | None = None,
    part: str = PARTS[0],
) -> SelfCalibration:
    """Fit a rig to a mission's frames, and test it on frames it was not fitted to.

    Used are `frames`, by default those with something to match. With `part` ``"even"`` or ``"odd"``
    it is fitted to the frames of these numbers, and tested on the others; with ``"alternate"`` to
    every second matched frame, and then to all; with ``"all"`` to all, not tested.

    Raises ToktError if there is too little to match, or nothing is left to fit to or to test on.
    """
    began = time.perf_counter()
    with ThreadpoolController().limit(limits=1, user_api="blas"):  # threads gain nothing here
        matches = match_mission(mission, frames, progress)
        chosen, tested = _split(matches, part)
        fit_part = fit_rig(chosen, start.rig, start.free)
        fit = fit_rig(matches, start.rig, start.free) if part == PARTS[0] else fit_part
        if start.calibration is None:
            before = raw_error(tested, start.rig.size)
        else:
            before = vertical_error(start.calibration, tested)
        return SelfCalibration(
            mission.name,
            start,
            part,
            fit,
            fit_part,
            [one.frame for one in chosen],
            [one.frame for one in tested],
            part != "all",
            matches,
            before,
            vertical_error(fit_part.rig.calibration(), tested),
            vertical_error(fit.rig.calibration(), matches),
            parameter_uncertainty(fit, tested),
            time.perf_counter() - began,
        )


def _split(matches: list[FrameMatches], part: str) -> tuple[list[FrameMatches], list[FrameMatches]]:
    if part == "all":
        return matches, matches
    if part == PARTS[0]:
        halves = matches[::2], matches[1::2]
    else:
        wanted = 0 if part == "even" else 1
        halves = (
            [one for one in matches if one.frame % 2 == wanted],
            [one for one in matches if one.frame % 2 != wanted],
        )
    for half, use in zip(halves, ("fit to", "test on"), strict=True):
        if not half:
            raise ToktError(
                f"no frame is left to {use} (matched: "
                f"{format_frames(one.frame for one in matches)}); choose --fit all or more frames"
            )
    return halves


def _frame_words(frames: list[int]) -> str:
    """As `format_frames`, shorter for every second frame of a stretch."""
    steps = {later - earlier for earlier, later in pairwise(frames)}
    if len(frames) > 3 and steps == {2}:
        return f"{frames[0]} to {frames[-1]}, every second"
    return format_frames(frames)
