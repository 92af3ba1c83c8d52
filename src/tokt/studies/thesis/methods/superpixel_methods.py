"""Methods on superpixels, trained for a mission: too slow for all of its frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from tokt.features.common.errors import ToktError
from tokt.studies.baselines.baseline import Baseline
from tokt.studies.baselines.lab_colour import LabColour, labelled_example
from tokt.studies.baselines.slic import SlicTexture
from tokt.studies.thesis.inputs import StudyInputs
from tokt.training.datasets.splits import BLOCK_FRAMES, EMBARGO_FRAMES

SLIC = ("lbp_10_5", "haralick")
EXAMPLES = 12
"""Labelled frames, of either half of the blocks, that the colours are learnt from."""


@dataclass(frozen=True)
class SuperpixelMethods:
    """SLIC with the thesis's textures, and superpixels by their colour.

    Parameters
    ----------
    textures : tuple of SlicTexture
    colours : tuple of LabColour
        One, or two: the first judges even blocks of frames and learnt from odd ones, the second
        the other way round.
    block_frames : int
    texture_words, colour_words : str
        What they learnt from.
    """

    textures: tuple[SlicTexture, ...]
    colours: tuple[LabColour, ...]
    block_frames: int
    texture_words: str
    colour_words: str

    def of(self, number: int) -> list[Baseline]:
        """The methods that may judge a frame of the mission: none learnt from its block."""
        block = number // self.block_frames
        return [*self.textures, self.colours[block % len(self.colours)]]

    def words(self, method: Baseline) -> str:
        """What a method learnt from."""
        return self.texture_words if method in self.textures else self.colour_words


def train_superpixel_methods(inputs: StudyInputs) -> SuperpixelMethods:
    """Train them: SLIC on the thesis's two images, the colours on labels where there are some."""
    ocean, other = inputs.ocean.image, inputs.other.image
    textures = tuple(
        SlicTexture.train(ocean, other, inputs.thesis[name].describe, name) for name in SLIC
    )
    two = inputs.two_images
    block = min(BLOCK_FRAMES, max(2, len(inputs.obstacle_patches) // 10))
    try:
        halves = [_examples(inputs, block, parity) for parity in (1, 0)]
        colours = tuple(
            LabColour.train(
                labelled_example(frame, inputs.truth(number))
                for number, frame in inputs.decoded(half)
            )
            for half in halves
        )
    except ToktError as error:
        why = f"; not from labels: {error}" if inputs.labels else ""
        return SuperpixelMethods(
            textures, (LabColour.train_on_two(ocean, other),), block, two, two + why
        )
    words = (
        f"held out by blocks of {block} frames: learnt from the labels of {len(halves[0])} frames "
        f"of odd blocks to judge even ones, and of {len(halves[1])} of even blocks to judge odd "
        "ones"
    )
    return SuperpixelMethods(textures, colours, block, two, words)


def _examples(inputs: StudyInputs, block: int, parity: int) -> list[int]:
    """Labelled frames of every second block, away from the blocks in between, evenly spread."""
    embargo = EMBARGO_FRAMES * block // BLOCK_FRAMES
    found = [n for n in _inside(inputs, block, embargo) if n // block % 2 == parity]
    seen = [n for n in found if inputs.obstacle_patches[n]]
    clear = [n for n in found if not inputs.obstacle_patches[n]]
    if not seen or not clear:
        raise ToktError("a half of the blocks does not show both obstacles and clear water")
    return sorted(_thinned(seen, EXAMPLES // 2) + _thinned(clear, EXAMPLES // 2))


def _inside(inputs: StudyInputs, block: int, embargo: int) -> Iterator[int]:
    for number in inputs.obstacle_patches:
        if embargo <= number % block < block - embargo and number in inputs.scored:
            yield number


def _thinned(numbers: list[int], count: int) -> list[int]:
    return numbers[:: max(1, -(-len(numbers) // count))]
