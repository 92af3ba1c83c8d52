"""Pictures of an object in water that is noise: where a test wants it, and of which make."""

import cv2
import numpy as np

HEIGHT, WIDTH = 271, 360
BOX = (150, 90, 60, 84)
SHARES = tuple(px / side for px, side in zip(BOX, (WIDTH, HEIGHT) * 2, strict=True))
MIDDLE = (180, 132)


def thing(detail=1):
    """An object's levels, (84, 60): its make, the same for all, and a fine detail of its own.

    What is between 1 and 2 has its detail of both.
    """
    if 1 < detail < 2:
        return (2 - detail) * thing(1) + (detail - 1) * thing(2)
    make = np.random.default_rng(7).uniform(-1, 1, (7, 5))
    own = np.random.default_rng(detail).uniform(-1, 1, (28, 20))
    coarse, fine = (
        cv2.resize(each, (BOX[2], BOX[3]), interpolation=cv2.INTER_CUBIC) for each in (make, own)
    )
    return 40 + 18 * coarse + 14 * fine


def picture(*things, seed=0):
    """A frame with things in it: each (x, y of its middle, size, detail), nearest last."""
    rng = np.random.default_rng(seed)
    frame = np.full((HEIGHT, WIDTH), 25.0)
    for x, y, size, detail in things:
        wide, high = round(BOX[2] * size), round(BOX[3] * size)
        shown = cv2.resize(thing(detail), (wide, high), interpolation=cv2.INTER_AREA)
        left, top = round(x - wide / 2), round(y - high / 2)
        rows = slice(max(top, 0), max(min(top + high, HEIGHT), 0))
        cols = slice(max(left, 0), max(min(left + wide, WIDTH), 0))
        part = shown[rows.start - top : rows.stop - top, cols.start - left : cols.stop - left]
        frame[rows, cols] = part
    frame = cv2.GaussianBlur(frame, (0, 0), 0.8) + rng.normal(0, 1.0, frame.shape)
    return frame.round().clip(0, 255).astype(np.uint8)


def own(x=MIDDLE[0], y=MIDDLE[1], size=1.0):
    """The object that is named."""
    return x, y, size, 1


def twin(x, y=MIDDLE[1], size=1.0):
    """Another one of its make."""
    return x, y, size, 2


def like(x, y=MIDDLE[1], size=1.0):
    """Another one, whose fine detail matches at 0.9: more than any that was rendered."""
    return x, y, size, 1.58
