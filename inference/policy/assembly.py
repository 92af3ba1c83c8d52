"""Assembly of a policy from a model, a stereo calibration, or both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.inference.clock import SYSTEM_STOPWATCH, Stopwatch
from tokt.inference.config import BM, DEFAULT_SCALE, MATCHERS, MOVING, NEAR
from tokt.inference.frame import Frame
from tokt.inference.reason import Reason
from tokt.inference.sight import SightMeter, stereo_meter
from tokt.inference.texture.detector import ReloadableTextureDetector, TextureDetector
from tokt.inference.verdict import DISPARITY, PUSHBROOM, Detector

from .moving import MovingThings
from .policy import POLICIES, EitherPolicy, FallbackPolicy, Policy, SinglePolicy, guarded
from .temporal_cues import Anchor, TemporalCues

if TYPE_CHECKING:
    from tokt.inference.stereo.calibration import StereoCalibration
    from tokt.inference.stereo.odometry import Odometry
    from tokt.models.bundle.bundle import Bundle

LoadModel = Callable[[], "Bundle"]

STEREO_ALGORITHMS = (*MATCHERS, PUSHBROOM)
"""What ``--stereo`` can be."""


@dataclass(frozen=True)
class StereoSetup:
    """A calibration, and how its pairs are matched.

    ToktError if the algorithm is not known, or has no use for odometry or a scale.
    """

    calibration: StereoCalibration
    algorithm: str = BM  # at all distances, or with pushbroom at a few of them only, for speed
    scale: float = DEFAULT_SCALE  # matched size over the frames'; pushbroom has its own
    odometry: Odometry | None = None  # by which pushbroom carries what it saw along

    def __post_init__(self) -> None:
        if self.algorithm not in STEREO_ALGORITHMS:
            known = ", ".join(STEREO_ALGORITHMS)
            raise ToktError(f"unknown stereo {self.algorithm!r} (choose from {known})")
        if self.algorithm == PUSHBROOM and self.scale != DEFAULT_SCALE:
            raise ToktError("pushbroom has a scale of its own: leave out --stereo-scale")
        if self.algorithm != PUSHBROOM and self.odometry is not None:
            raise ToktError("odometry is for pushbroom only (--stereo pushbroom)")

    @property
    def blind_m(self) -> float:
        """The part of the left picture's width that the right camera does not see, at its left
        edge, times the distance in metres.
        """
        calibration = self.calibration
        baseline_m = float(np.linalg.norm(calibration.T_mm)) / 1000
        return float(calibration.K1[0, 0]) * baseline_m / calibration.frame_size[0]

    def detector(self, grid: Grid, sight: SightMeter, threads: int = 1) -> Detector:
        """The detector, its mask as wide as the grid wants it; maps are read from `sight`."""
        # Imported where there are pairs: a runtime without is started sooner.
        if self.algorithm == PUSHBROOM:
            from tokt.inference.stereo.pushbroom import PushbroomDetector

            return PushbroomDetector(self.calibration, grid, self.odometry, sight, threads)
        from tokt.inference.stereo.disparity import DisparityDetector

        ways = self.algorithm, self.scale
        return DisparityDetector(self.calibration, grid, *ways, sight=sight, threads=threads)


class LateStereoDetector(ReloadableTextureDetector):
    """The place of a stereo detector whose calibration is not there yet."""

    method = DISPARITY
    lacks, reason = "no calibration", Reason.DETECTOR_FAILED


@dataclass(eq=False)
class Assembly:
    """A policy, and the texture detector in it whose model can be exchanged."""

    policy: TemporalCues
    texture: ReloadableTextureDetector | None  # None where the policy has no model
    stereo: StereoSetup | None
    grid: Grid  # which disparity's mask is as wide as
    sight: SightMeter  # what all detectors read
    late_stereo: LateStereoDetector | None = None  # in place of a calibration that is not there

    def put_stereo(self, stereo: StereoSetup, threads: int) -> None:
        """Let a calibration that was not there judge from now on.

        Raises ToktError if its frames do not fit the model's.
        """
        if self.late_stereo is None:
            return
        self.late_stereo.put(stereo.detector(self.grid, self.sight, threads))
        self.stereo, self.policy.blind_m = stereo, stereo.blind_m

    def misfit(self, model: Bundle, frame: Frame | None = None) -> str:
        """Why a model cannot take the place of the one there is, or an empty string.

        `frame` is one that it has to judge.
        """
        if self.texture is None:
            return "the policy uses no model"
        if self.late_stereo is not None and self.stereo is None and model.grid != self.grid:
            return "its grid is not that of the model that the run began with"
        if self.stereo is not None:
            width, height = self.stereo.calibration.frame_size
            if model.grid.resized(height, width) != self.grid.resized(height, width):
                wide = f"{model.grid.width} px wide, the running ones {self.grid.width}"
                return f"its frames are {wide}"
        if frame is not None:
            found = guarded(TextureDetector(model), frame)
            if found.features is None:
                return f"it cannot judge the newest frame: {found.fault}"
        return ""


def assemble(
    name: str,
    load_model: LoadModel | None,
    stereo: StereoSetup | None,
    threads: int = 1,
    stopwatch: Stopwatch = SYSTEM_STOPWATCH,
    anchor: Anchor | None = None,
    moving: str | None = NEAR,
    stereo_fault: str = "",
    alone: bool = False,
) -> Assembly:
    """Assemble the policy of that name.

    `load_model` loads the model, or raises ToktError. Policy ``fallback`` goes on when it does,
    with a calibration, and so does ``either`` where one detector `alone` is enough: every verdict's
    health then says why there is no model. `stereo_fault` says why there is no calibration where
    there should be one: these two policies go on without it, until `Assembly.put_stereo` adds it.
    `stereo` is what disparity
    needs, `anchor` what is to be held in the picture, and `stopwatch` what lateness is measured
    with. Verdicts do not depend on `threads`, which share one frame's
    rows of patches, or a pair's two pictures.

    `moving` says which of the things that move by themselves are avoided: ``near``, ``all`` or
    ``none``. With None neither they nor sediment are looked for, as in the logs of an older tokt.

    Raises ToktError if the policy is not known, lacks its model or its calibration, or has no use
    for one, or there is not at least one thread.
    """
    late_stereo = LateStereoDetector(None, stereo_fault) if stereo_fault else None
    check_policy(name, load_model is not None, bool(stereo or late_stereo), threads)
    if late_stereo is not None and name == "disparity":
        raise ToktError(stereo_fault)
    if moving not in (None, *MOVING):
        raise ToktError(f"unknown moving {moving!r} (choose from {', '.join(MOVING)})")
    model, fault = None, ""
    try:
        model = None if load_model is None else load_model()
    except ToktError as error:
        if stereo is None or not (name == "fallback" or alone):
            raise
        fault = str(error)
    grid = DEFAULT_GRID if model is None else model.grid
    sight = stereo_meter() if stereo or late_stereo else SightMeter()
    disparity: Detector | None = late_stereo
    if stereo is not None:
        disparity = stereo.detector(grid, sight, threads)
    blind_m = 0.0 if stereo is None else stereo.blind_m
    texture = ReloadableTextureDetector(
        None if model is None else TextureDetector(model, threads, sight), fault
    )
    policy = _policy(name, texture, disparity, stopwatch)
    if moving is not None:
        policy = MovingThings(policy, moving, threads)
    reloadable = None if name == "disparity" else texture
    cues = TemporalCues(policy, reloadable, anchor, blind_m)
    return Assembly(cues, reloadable, stereo, grid, sight, late_stereo)


def _policy(
    name: str, texture: ReloadableTextureDetector, disparity: Detector | None, stopwatch: Stopwatch
) -> Policy:
    if name == "texture":
        return SinglePolicy(texture)
    if disparity is None:
        return SinglePolicy(texture, note="no fallback: there is no stereo calibration")
    if name == "disparity":
        return SinglePolicy(disparity)
    if name == "either":
        return EitherPolicy(texture, disparity)
    return FallbackPolicy(texture, disparity, stopwatch)


def check_policy(name: str, has_model: bool, has_calibration: bool, threads: int) -> None:
    """Raise ToktError where a policy lacks its model or its calibration, or has no use for one."""
    if name not in POLICIES:
        raise ToktError(f"unknown policy {name!r} (choose from {', '.join(POLICIES)})")
    if threads < 1:
        raise ToktError(f"at least one thread is needed, not {threads} (--threads N)")
    if has_model and name == "disparity":
        raise ToktError("policy disparity uses no model: leave out --store/--bundle/--model")
    if not has_calibration and name in ("disparity", "either"):
        raise ToktError(f"policy {name} needs a stereo calibration (--calibration FILE.yml)")
    if has_calibration and name == "texture":
        raise ToktError("policy texture uses no calibration: leave out --calibration")
    if not has_model and name != "disparity":
        raise ToktError(
            f"policy {name} needs a model (--store STORE, --bundle FILE or --model waters)"
        )
