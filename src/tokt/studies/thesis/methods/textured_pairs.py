"""Choice of the pairs of a mission that show something: most of a dive is open water."""

from __future__ import annotations

from dataclasses import dataclass

from tokt.studies.thesis.inputs import StudyInputs
from tokt.training.rig.calibrate.frame_selection import evenly_spaced, texture

SURVEYED = 80
"""Pairs looked at, spread over the mission."""
MIN_SHARE = 0.004
"""Part of the left picture with local contrast from which it shows something. Source:
`tokt.training.rig.calibrate.frame_selection`, whose share it is."""


@dataclass(frozen=True)
class Survey:
    """Pairs spread over a mission, apart by whether their left picture has local contrast.

    Parameters
    ----------
    textured, open_water : list of int
        Frame numbers, in order.
    """

    textured: list[int]
    open_water: list[int]


def survey(inputs: StudyInputs, count: int = SURVEYED) -> Survey:
    """Look at `count` pairs, spread over the mission."""
    seen = evenly_spaced(inputs.pairs, count)
    shares = {number: texture(inputs.mission, number) for number in seen}
    return Survey(
        [number for number in seen if shares[number] >= MIN_SHARE],
        [number for number in seen if shares[number] == 0],
    )
