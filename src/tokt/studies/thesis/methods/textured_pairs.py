"""Which pairs of a mission show something: most of a dive is open water."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..stereo.survey import texture
from .material import Material

SURVEYED = 80
"""Pairs looked at, spread over the mission."""
LEAST_SHARE = 0.004
"""Part of the left picture with local contrast from which it shows something. Source:
`tokt.training.stereo.survey`, whose share it is."""


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


def survey(material: Material, count: int = SURVEYED) -> Survey:
    """Look at `count` pairs, spread over the mission."""
    seen = spread(material.pairs, count)
    shares = {number: texture(material.mission, number) for number in seen}
    return Survey(
        [number for number in seen if shares[number] >= LEAST_SHARE],
        [number for number in seen if shares[number] == 0],
    )


def spread(numbers: Sequence[int], count: int) -> list[int]:
    """At most `count` of some numbers, evenly spaced, in their order."""
    places = np.linspace(0, len(numbers) - 1, min(count, len(numbers))).round().astype(int)
    return [numbers[place] for place in places]
