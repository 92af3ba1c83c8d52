"""Sight of a dataset's frames: the limits that they give, and the frames that show too little."""

from collections import defaultdict
from collections.abc import Callable, Sequence

import pandas as pd

from tokt.features.common.arrays import U8
from tokt.features.frames.view_mask import ViewMask
from tokt.inference.sight import SightMeter
from tokt.models.sight import SightLimits, measure_sight

_SIGHT_FRAMES = 60
"""About so many frames of each mission's camera give the numbers of sight: more are near copies."""


def measured_sight(
    frames: pd.DataFrame, read: Callable[[int], U8], mask: Callable[[int], ViewMask | None]
) -> tuple[SightLimits, ...]:
    """Return what frames show at least, from some of each mission's camera.

    `frames` have mission and camera; `read` and `mask` take the index of a row.
    """
    rows = frames.groupby(["mission", "camera"]).groups
    some = [mine[:: max(len(mine) // _SIGHT_FRAMES, 1)].tolist() for mine in rows.values()]
    chosen = [row for mine in some for row in mine]
    return measure_sight(map(read, chosen), map(mask, chosen), frames.mission[chosen])


def unseen_frames(
    limits: Sequence[SightLimits],
    frames: pd.DataFrame,
    read: Callable[[int], U8],
    mask: Callable[[int], ViewMask | None],
) -> dict[str, list[int]]:
    """Return rows of frames of which a run would not say clear, by the code of the reason.

    Each is looked at alone: what a run tells by several frames is not counted. Frames, `read` and
    `mask` are as in `measured_sight`.
    """
    meter, found = SightMeter(limits), defaultdict[str, list[int]](list)
    for row in frames.index:
        if fault := meter.measure(read(row), mask(row)).fault:
            found[fault.reason.value].append(row)
    return dict(sorted(found.items()))
