"""The cameras that a self-calibration starts from, before it looks at a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import Mission
from tokt.inference.stereo.calibration import StereoCalibration

from .frame_selection import frame_size
from .rig_model import DISTORTION, FOCAL, PRINCIPAL, Rig

BASELINE_MM = 305.5
"""Distance between the mission cameras (thesis, table 3.4: the length of T)."""
FOCAL_PX, FOCAL_WIDTH = 2222.7, 1360
"""Focal length in water of the mission cameras (thesis, table 3.3), at their frame width."""
_FREE_NAMES = {"k1": ("k1",), "k2": ("k2",), "focal": FOCAL, "principal": PRINCIPAL}


@dataclass(frozen=True)
class StartingRig:
    """The cameras that a calibration starts from.

    Attributes
    ----------
    rig : Rig
    words : str
        Where it comes from.
    free : tuple of str
        What is estimated besides R, the direction of T and the focal ratio.
    calibration : StereoCalibration or None
        The whole of it, where a usable one was given: what `before` is measured with.
    """

    rig: Rig
    words: str
    free: tuple[str, ...]
    calibration: StereoCalibration | None = None


def parse_free(text: str) -> tuple[str, ...]:
    """Read ``k1,k2,focal,principal``, or ``none``.

    Raises
    ------
    ToktError
        If a name is none of these.
    """
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

    Raises
    ------
    ToktError
        If it is of frames of another size, or its lenses need more than five numbers.
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
    centred = [_centred(k, size) for k in K]
    lenses = [d[:2] for d in D]
    rig = Rig.from_cameras((centred[0], centred[1]), (lenses[0], lenses[1]), baseline_mm, size)
    return StartingRig(
        rig, "f, k1 and k2 as given; principal point at the centre, square pixels", freed
    )


def _centred(K: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.float64]:
    plain = K.copy()
    plain[1, 1], plain[0, 1] = K[0, 0], 0.0
    plain[0, 2], plain[1, 2] = (size[0] - 1) / 2, (size[1] - 1) / 2
    return plain
