"""The sizes of frames that a model judges: those it learnt from, and other shapes within bounds.

Frames are brought to the width of the model's grid, and the grid's patches cover the whole frame
whatever its shape. Measured with whole sites held out (docs/explanation/waters.md): frames of
shapes from 9:16 to 2432x954 (2.55:1) that no training frame had were judged as well as those of
4:3. The training frames' own size turned by 90 degrees is left out: it is that camera, mounted
otherwise.
"""

from collections.abc import Sequence

MIN_ASPECT, MAX_ASPECT = 0.5, 2.7
"""Width over height of a shape that no training frame had: 0.56 and 2.55 were measured."""
MIN_WIDTH = 240
"""Pixels, of a size that no training frame had: 256 was measured, brought to width 360."""

Size = tuple[int, int]
"""Height and width in pixels."""


def size_fault(height: int, width: int, learnt: Sequence[Size]) -> str:
    """Say why frames of a size are not judged by a model of frames of other sizes.

    Returns an empty string where they are.
    """
    if (height, width) in learnt:
        return ""
    if (width, height) in learnt and len({tall > wide for tall, wide in learnt}) == 1:
        return f"frames are {width}x{height}: those that the model learnt from, turned by a quarter"
    aspect = width / height
    if MIN_ASPECT <= aspect <= MAX_ASPECT and width >= MIN_WIDTH:
        return ""
    return (
        f"frames are {width}x{height}, which the model did not learn. It judges others from "
        f"{MIN_WIDTH} pixels of width on, {MIN_ASPECT:g} to {MAX_ASPECT:g} times as wide as high"
    )
