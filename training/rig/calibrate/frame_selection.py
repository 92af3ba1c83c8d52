"""Selection of the frames that have anything to match: most of a dive is open water."""

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import cv2
import numpy as np

from tokt.features.common.errors import FrameError, ToktError
from tokt.features.frames.mission import LEFT, RIGHT, Mission, frame_size

from .matching import FrameMatches, gray_frame, match_frame

T = TypeVar("T")
Progress = Callable[[Iterable[int], int, str], Iterable[int]]

_WIDTH, _HIGHEST = 340, 10_000
_LOCAL_PX = 6.0
_CONTRAST_LEVELS = 2.0
MIN_SHARE = 0.004
"""A frame is worth matching when this share of it, at `_WIDTH`, has a local contrast of more than
so many grey levels. On open water of the 2016 mission the share is 0; its tower has 0.007 from
frame 150, where matching begins to find points, to 0.5 at its nearest."""
MAX_FRAMES = 100


def stereo_frames(mission: Mission, wanted: Sequence[int] | None = None) -> list[int]:
    """Frames that both cameras have, or the wanted ones of these; ToktError if there is none."""
    both = sorted(set(mission.frames(LEFT)) & set(mission.frames(RIGHT)), key=mission.place)
    if not both:
        raise ToktError(
            f"mission {mission.path} has no pairs: a left and a right picture in Left/ and Right/ "
            "are one where their names are the same"
        )
    if wanted is None:
        return both
    chosen = [number for number in both if number in set(wanted)]
    if not chosen:
        raise ToktError(f"none of these frames is in both cameras of mission {mission.path}")
    return chosen


def match_mission(
    mission: Mission,
    frames: Sequence[int] | None,
    progress: Progress,
    most: int = MAX_FRAMES,
    spread: bool = False,
) -> list[FrameMatches]:
    """Match the frames that have something to match, or those of `frames` both cameras have.

    At most `most` are matched, the stretch of the dive with the most texture: or, if `spread`,
    evenly over the whole dive. Raises ToktError if there is no frame in which matches are found.
    """
    present = stereo_frames(mission, frames)
    shares = {frame: texture(mission, frame) for frame in progress(present, len(present), "survey")}
    worth = [frame for frame, share in shares.items() if share >= MIN_SHARE]
    if len(worth) > most:
        worth = evenly_spaced(worth, most) if spread else _densest(worth, shares, most)
    size = frame_size(mission)
    found = [match_frame(mission, frame, size) for frame in progress(worth, len(worth), "match")]
    matched = [one for one in found if one is not None]
    if not matched:
        raise ToktError(
            f"mission {mission.path}: no frame has enough points that both cameras see; frames of "
            "something solid, near and well lit, are needed"
        )
    return matched


def texture(mission: Mission, frame: int) -> float:
    """Share of the left picture that has local contrast; 0 for one that cannot be read."""
    try:
        image = gray_frame(mission, frame, LEFT)
    except FrameError:
        return 0.0
    size = (_WIDTH, min(max(1, round(image.shape[0] * _WIDTH / image.shape[1])), _HIGHEST))
    view = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    detail = view - cv2.GaussianBlur(view, (0, 0), _LOCAL_PX)
    contrast = cv2.GaussianBlur(detail * detail, (0, 0), _LOCAL_PX)
    return float((contrast > _CONTRAST_LEVELS**2).mean())


def evenly_spaced(items: Sequence[T], count: int) -> list[T]:
    """At most `count` of some items, evenly spaced from the first to the last, in their order."""
    places = np.linspace(0, len(items) - 1, min(count, len(items))).round().astype(int)
    return [items[place] for place in places]


def _densest(worth: list[int], shares: dict[int, float], most: int) -> list[int]:
    """The `most` frames in a row with the most texture: tracks need neighbours."""
    sums = np.convolve([shares[frame] for frame in worth], np.ones(most), "valid")
    first = int(sums.argmax())
    return worth[first : first + most]
