"""Put a policy together from what there is: a model, a calibration, or both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..features.errors import ToktError
from ..features.grid import DEFAULT_GRID, Grid
from .anchor import Anchor
from .detector import PUSHBROOM, Detector, GridDetector, PatchScorer
from .followed import FollowedPolicy
from .policy import POLICIES, EitherPolicy, FallbackPolicy, Policy, SinglePolicy
from .stereo_ways import BM, HALF, MATCHERS
from .stopwatch import SYSTEM_STOPWATCH, Stopwatch
from .texture_slot import TextureSlot

if TYPE_CHECKING:
    from .calibration import StereoCalibration
    from .odometry import Odometry

LoadModel = Callable[[], PatchScorer]

STEREO = (*MATCHERS, PUSHBROOM)
"""Ways to look at a stereo pair."""


@dataclass(frozen=True)
class Stereo:
    """How pairs are looked at.

    Parameters
    ----------
    calibration : StereoCalibration
    way : {"bm", "sgbm", "pushbroom"}
        Matching at all distances, or looking at a few of them only, for speed.
    scale : float
        Of the views that are matched over the frames' size; pushbroom has its own.
    odometry : Odometry, optional
        Where the vehicle was at each frame: pushbroom carries what it saw along with it.

    Raises
    ------
    ToktError
        If the way is not known, or has no use for odometry or a scale.
    """

    calibration: StereoCalibration
    way: str = BM
    scale: float = HALF
    odometry: Odometry | None = None

    def __post_init__(self) -> None:
        if self.way not in STEREO:
            raise ToktError(f"unknown stereo {self.way!r} (choose from {', '.join(STEREO)})")
        if self.way == PUSHBROOM and self.scale != HALF:
            raise ToktError("pushbroom has a scale of its own: leave out --stereo-scale")
        if self.way != PUSHBROOM and self.odometry is not None:
            raise ToktError("odometry is for pushbroom only (--stereo pushbroom)")

    @property
    def blind_m(self) -> float:
        """The part of the left picture's width that the right camera does not see, at its left
        edge, times the distance in metres.
        """
        calibration = self.calibration
        baseline_m = float(np.linalg.norm(calibration.T_mm)) / 1000
        return float(calibration.K1[0, 0]) * baseline_m / calibration.frame_size[0]

    def detector(self, grid: Grid) -> Detector:
        """The detector, its mask as wide as the grid wants it."""
        # Imported where there are pairs: a runtime without is started sooner.
        if self.way == PUSHBROOM:
            from .pushbroom import PushbroomDetector

            return PushbroomDetector(self.calibration, grid, odometry=self.odometry)
        from .disparity import DisparityDetector

        return DisparityDetector(self.calibration, grid, self.way, self.scale)


@dataclass(frozen=True)
class Assembly:
    """A policy, and the place in it where a model can be exchanged.

    Parameters
    ----------
    policy : Policy
    texture : TextureSlot or None
        None where the policy has no model.
    stereo : Stereo or None
    grid : Grid
        Which disparity's mask is as wide as.
    """

    policy: Policy
    texture: TextureSlot | None
    stereo: Stereo | None
    grid: Grid

    def misfit(self, model: PatchScorer) -> str:
        """Why a model cannot take the place of the one there is, or an empty string."""
        if self.texture is None:
            return "the policy uses no model"
        if self.stereo is None:
            return ""
        width, height = self.stereo.calibration.frame_size
        if model.grid.resized(height, width) != self.grid.resized(height, width):
            return f"its frames are {model.grid.width} px wide, the running ones {self.grid.width}"
        return ""


def build_policy(
    name: str,
    load_model: LoadModel | None,
    stereo: Stereo | None,
    threads: int = 1,
) -> Policy:
    """`assemble`, for those who exchange no model."""
    return assemble(name, load_model, stereo, threads).policy


def assemble(
    name: str,
    load_model: LoadModel | None,
    stereo: Stereo | None,
    threads: int = 1,
    stopwatch: Stopwatch = SYSTEM_STOPWATCH,
    anchor: Anchor | None = None,
) -> Assembly:
    """Put the policy of that name together.

    Parameters
    ----------
    name : {"texture", "disparity", "either", "fallback"}
    load_model : callable, optional
        Loads the model, or raises ToktError. Only policy ``fallback`` goes on when it does, and
        only with a calibration: every verdict's health then says why there is no model.
    stereo : Stereo, optional
        What disparity needs.
    threads : int
        How many threads share one frame's rows of patches; verdicts do not depend on it.
    stopwatch : Stopwatch
        What a policy measures lateness with.
    anchor : Anchor, optional
        What is to be held in the picture.

    Raises
    ------
    ToktError
        If the policy is not known, lacks its model or its calibration, or has no use for one, or
        there is not at least one thread.
    """
    _check(name, load_model is not None, stereo is not None, threads)
    model, fault = _load(load_model, may_fail=name == "fallback" and stereo is not None)
    grid = DEFAULT_GRID if model is None else model.grid
    disparity = None if stereo is None else stereo.detector(grid)
    blind_m = 0.0 if stereo is None else stereo.blind_m
    if name == "disparity" and disparity is not None:
        policy: Policy = FollowedPolicy(SinglePolicy(disparity), None, anchor, blind_m)
        return Assembly(policy, None, stereo, grid)
    texture = TextureSlot(None if model is None else GridDetector(model, threads), fault)
    if name == "texture":
        policy = SinglePolicy(texture)
    elif disparity is None:
        policy = SinglePolicy(texture, note="no fallback: there is no stereo calibration")
    elif name == "either":
        policy = EitherPolicy(texture, disparity)
    else:
        policy = FallbackPolicy(texture, disparity, stopwatch)
    return Assembly(FollowedPolicy(policy, texture, anchor, blind_m), texture, stereo, grid)


def _check(name: str, has_model: bool, has_calibration: bool, threads: int) -> None:
    """Refuse what a user cannot have meant."""
    if name not in POLICIES:
        raise ToktError(f"unknown policy {name!r} (choose from {', '.join(POLICIES)})")
    if threads < 1:
        raise ToktError(f"at least one thread is needed, not {threads} (--threads N)")
    if has_model and name == "disparity":
        raise ToktError("policy disparity uses no model: leave out --store/--bundle")
    if not has_calibration and name in ("disparity", "either"):
        raise ToktError(f"policy {name} needs a stereo calibration (--calibration FILE.yml)")
    if has_calibration and name == "texture":
        raise ToktError("policy texture uses no calibration: leave out --calibration")
    if not has_model and name != "disparity":
        raise ToktError(f"policy {name} needs a model (--store STORE or --bundle FILE)")


def _load(load_model: LoadModel | None, may_fail: bool) -> tuple[PatchScorer | None, str]:
    if load_model is None:
        return None, ""
    try:
        return load_model(), ""
    except ToktError as error:
        if not may_fail:
            raise
        return None, str(error)
