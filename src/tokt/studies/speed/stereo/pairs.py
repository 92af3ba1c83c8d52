"""Stereo pairs in memory: what the stereo cases are measured on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import FrameError
from tokt.features.frames.mission import LEFT, RIGHT, Mission
from tokt.inference.frame import Frame


@dataclass(frozen=True)
class Pair:
    """Two decoded frames of one moment.

    Parameters
    ----------
    number : int
    left, right : array of uint8, shape (height, width) or (height, width, 3)
    """

    number: int
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]

    @cached_property
    def frame(self) -> Frame:
        """The pair as a source delivers it."""
        return Frame(self.number, float(self.number), self.left, self.right)

    @property
    def sizes(self) -> set[tuple[int, int]]:
        """Width and height of both; one element where they are alike."""
        return {(image.shape[1], image.shape[0]) for image in (self.left, self.right)}


def pair_numbers(mission: Mission) -> list[int]:
    """Frames that both cameras have, in order."""
    return sorted(set(mission.frames(LEFT)) & set(mission.frames(RIGHT)))


def read_pairs(mission: Mission, numbers: Iterable[int]) -> Iterator[Pair]:
    """Decode pairs, leaving out those of which an image cannot be read."""
    for number in numbers:
        try:
            yield Pair(number, mission.read(number, LEFT), mission.read(number, RIGHT))
        except FrameError:
            continue
