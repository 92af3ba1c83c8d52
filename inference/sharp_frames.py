"""Sight of a camera that a model did not learn, from frames that a person knows to be sharp.

A picture alone does not say whether its camera gives no more detail or its port is fogged. Whoever
has looked at some frames can tell, and no labels are needed for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import tee

import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.features.frames.camera_frame import MOSAIC_FORMATS
from tokt.features.frames.mission import Mission
from tokt.features.frames.view_mask import CameraMasks, ViewMask
from tokt.inference.reason import Reason
from tokt.inference.replay.logged_run import is_recording
from tokt.inference.sight import SightMeter
from tokt.inference.sources.files import read_picture
from tokt.models.sight import SightLimits, measure_sight

MAX_FRAMES = 20
"""Frames that are measured of each camera, evenly spread. Those of 4K took 12 s on two cores, and a
run that is started again has to warn as soon as it can."""
_OF_VIDEO = 200
"""First frames of a video that they are taken from: 3,000 of 1280x720 took 8 s to read."""


def measure_sharp_frames(
    mission: Mission,
    masks: CameraMasks | None = None,
    pixel_format: str | None = None,
    *,
    accept_blind: bool = False,
) -> tuple[SightLimits, ...]:
    """Measure what sharp frames of a camera show at least.

    Parameters
    ----------
    mission : Mission
        A folder of frames or a video.
    masks : CameraMasks, optional
        What is no view in them, where the mission has no mask of its own.
    pixel_format : str, optional
        How gray images hold a camera's raw pixels, as for `MissionSource`.
    accept_blind : bool, optional
        Whether frames are taken that show no finer detail than blurred ones.

    Raises
    ------
    ToktError
        If no frame can be read, or they are blind and that is not accepted.
    """
    masks = mission.masks or masks or CameraMasks()
    pictures, copies = tee(_some_pictures(mission, masks, pixel_format))
    limits = measure_sight((picture for picture, _ in pictures), (mask for _, mask in copies))
    if not limits:
        raise ToktError(f"{mission.name}: no frame can be read that is large enough for patches")
    blind = [one for one in limits if one.blind]
    if blind and not accept_blind:
        size = f"{blind[0].width}x{blind[0].height}"
        raise ToktError(
            f"{mission.name}: its {size} frames show no finer detail than blurred ones, as in "
            "compressed video. Name sharper frames of this camera, or use --accept-blind"
        )
    return limits


def are_mostly_hidden(limits: Sequence[SightLimits], mission: Mission) -> bool:
    """Tell whether most frames of a mission show less than limits that a model learnt allow."""
    meter = SightMeter(limits)
    pictures = _some_pictures(mission, mission.masks)
    faults = [meter.measure(picture, mask).fault for picture, mask in pictures]
    hidden = [bool(fault) and fault.reason not in _UNLIT for fault in faults]
    return sum(hidden) > len(hidden) / 2


_UNLIT = Reason.DARK, Reason.SATURATED


def _some_pictures(
    mission: Mission, masks: CameraMasks, pixel_format: str | None = None
) -> Iterator[tuple[U8, ViewMask | None]]:
    """Read pictures of each camera, covered where they have a mask, one at a time."""
    raw = pixel_format in MOSAIC_FORMATS and not is_recording(mission.path)
    for camera in mission.cameras:
        mask, numbers = masks.of(camera), mission.frames(camera)
        if mission.path.is_file():
            numbers = numbers[:_OF_VIDEO]
        some = np.linspace(0, len(numbers) - 1, min(len(numbers), MAX_FRAMES)).round()
        for number in (numbers[int(at)] for at in some):
            picture, _ = read_picture(mission, number, camera)
            if picture is not None and picture.ndim == 2 and raw:
                picture, _ = read_picture(mission, number, camera, pixel_format)
            if picture is not None:
                yield picture if mask is None else mask.cover(picture), mask
