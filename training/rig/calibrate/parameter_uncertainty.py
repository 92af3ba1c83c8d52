"""Uncertainty of a rig's parameters: which of them the frames determine."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tokt.features.common.arrays import F64

from .adjustment import Path, adjust, rig_covariance
from .matching import FrameMatches
from .rig_fit import PRIORS, RigFit
from .rig_model import DISTORTION, FOCAL, POSE, PRINCIPAL
from .vertical_error import vertical_error

FIXED, WEAK, NOT_FIXED = "fixed by the data", "weakly fixed by the data", "not fixed by the data"
_ALL = (*POSE, *DISTORTION, *FOCAL, *PRINCIPAL)
_TOLERANCE = {
    **dict.fromkeys(POSE[:3], 5e-4),
    "direction_y": 0.005,
    "direction_z": 0.01,
    "focal_ratio": 1e-3,
    "k1": 0.05,
    "k2": 0.5,
    **dict.fromkeys(PRINCIPAL, 5.0),
}
"""The deviation that moves a point by about a pixel, or a depth by about one percent."""
_FOCAL_TOLERANCE = 0.01
_WEAK = 4.0
_MANY_SIGMAS = 3.0
_FOCAL_STEPS = (0.95, 1.05)


@dataclass(frozen=True)
class Parameter:
    """One number of the rig."""

    name: str
    value: float
    unit: str
    sigma: float | None  # standard deviation; None for a number that was not estimated
    sigma_all_free: float | None  # the same if every number of the camera model were unknown
    # What it becomes then. Far from `value`, by that deviation, it says that the camera model errs
    # by more than the matches do.
    value_all_free: float | None
    verdict: str  # of an estimated number: given those that are held; of a held one: if it were not
    held: bool  # not estimated but taken as given

    def words(self) -> str:
        """The verdict, and what it rests on."""
        if self.held:
            return f"held; {self.verdict}"
        moves = (
            self.value_all_free is not None
            and self.sigma_all_free is not None
            and (abs(self.value_all_free - self.value) > _MANY_SIGMAS * self.sigma_all_free)
        )
        return f"{self.verdict}{', as long as those held are right' if moves else ''}"


@dataclass(frozen=True)
class FocalStep:
    """Errors and depths at another focal length, everything else fitted anew."""

    focal_px: float
    vertical_median_px: float
    residual_median_px: float
    depth_scale: float


@dataclass(frozen=True)
class ParameterUncertainty:
    """Uncertainty of all parameters, and the directions that the frames leave loose."""

    parameters: list[Parameter]
    # The ``changes`` of each can happen together while the pictures stay nearly the same.
    loose: list[dict[str, dict[str, float]]]
    focal: list[FocalStep]


def parameter_uncertainty(fit: RigFit, test: Sequence[FrameMatches]) -> ParameterUncertainty:
    """Standard deviations, loose directions, and the profile of the focal length."""
    estimated = _deviations(fit.names, rig_covariance(fit.problem(fit.names, PRIORS), fit.path))
    wide = rig_covariance(fit.problem(_ALL), fit.path)
    all_free = _deviations(_ALL, wide)
    elsewhere = adjust(fit.problem(_ALL, PRIORS), fit.path).rig
    parameters = []
    for name in _ALL:
        sigma, value, there = estimated.get(name), fit.rig.values[name], elsewhere.values[name]
        doubt = max(all_free[name], abs(there - value)) if sigma is None else sigma
        ratio, held = doubt / _tolerance(fit, name), sigma is None
        verdict = FIXED if ratio <= 1 else WEAK if ratio <= _WEAK else NOT_FIXED
        parameters.append(
            Parameter(name, value, _unit(name), sigma, all_free[name], there, verdict, held)
        )
    parameters.append(
        Parameter("baseline", fit.rig.baseline_mm, "mm", None, None, None, NOT_FIXED, True)
    )
    depth = _median_depth(fit.path)
    focal = [_focal_step(fit, factor, depth, test) for factor in (1.0, *_FOCAL_STEPS)]
    return ParameterUncertainty(parameters, _loose(fit, wide), focal)


def _deviations(names: Sequence[str], covariance: F64) -> dict[str, float]:
    return dict(zip(names, map(float, np.sqrt(np.diag(covariance))), strict=True))


def _unit(name: str) -> str:
    if name in POSE[:3]:
        return "rad"
    return "px" if name in (*FOCAL, *PRINCIPAL) else ""


def _tolerance(fit: RigFit, name: str) -> float:
    if name in FOCAL:
        return _FOCAL_TOLERANCE * fit.rig.values["focal"]
    scale = fit.rig.size[0] / 1360 if name in PRINCIPAL else 1.0
    return _TOLERANCE[name] * scale


def _loose(fit: RigFit, wide: F64) -> list[dict[str, dict[str, float]]]:
    """Eigenvectors of the covariance, in units of the tolerances, that are longer than these."""
    unit = np.array([_tolerance(fit, name) for name in _ALL])
    values, vectors = np.linalg.eigh(wide / np.outer(unit, unit))
    found = []
    for value, vector in sorted(zip(values, vectors.T, strict=True), key=lambda pair: -pair[0]):
        if value <= 1:
            break
        moves = np.sqrt(value) * vector
        main = np.abs(moves) >= 0.3 * np.abs(moves).max()
        changes = {_ALL[i]: float(moves[i] * unit[i]) for i in np.flatnonzero(main)}
        found.append({"changes": changes})
    return found


def _focal_step(
    fit: RigFit, factor: float, depth: float, test: Sequence[FrameMatches]
) -> FocalStep:
    rig, path, residual = fit.rig, fit.path, fit.residual_px
    if factor != 1.0:
        rig = rig.moved(FOCAL, rig.vector(FOCAL) * factor)
        path = replace(path, shifts_m=path.shifts_m * factor, points_m=path.points_m * factor)
        names = tuple(name for name in fit.names if name not in FOCAL)
        problem = replace(fit, rig=rig, path=path).problem(names, PRIORS)
        adjusted = adjust(problem, path)
        rig, path, residual = adjusted.rig, adjusted.path, adjusted.residual_px
    return FocalStep(
        rig.values["focal"],
        vertical_error(rig.calibration(), test).median_px,
        float(np.median(residual)),
        _median_depth(path) / depth,
    )


def _median_depth(path: Path) -> float:
    return float(np.median(path.points_m[:, 2]))
