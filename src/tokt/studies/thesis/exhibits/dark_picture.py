"""The badly lit picture that is judged, and what is in it: given, or rendered."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.features.frames.image_file import read_image
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.context import StudyContext
from tokt.studies.thesis.methods.dark_rendering import RENDERED_WIDTHS, DarkScene
from tokt.studies.thesis.methods.patch_scores import PatchTruth, truth_by_labels, truth_by_mask


@dataclass(frozen=True)
class DarkPicture:
    """A picture, and what is in it.

    Parameters
    ----------
    left : array of uint8, shape (height, width) or (height, width, 3)
    right : array of uint8 or None
        What the right camera saw at that moment, where that is known.
    mask : array of uint8, shape (height, width), or None
        White where the obstacle is, as it is shown.
    truth : PatchTruth or None
        By patch; None where nobody marked the picture.
    calibration : StereoCalibration or None
    words, truth_words, calibration_words : str
        What the picture is, whose the truth is, and where the calibration is from.
    rendered : bool
    number : int or None
        The mission's frame it is, where it is one.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8] | None
    mask: NDArray[np.uint8] | None
    truth: PatchTruth | None
    calibration: StereoCalibration | None
    words: str
    truth_words: str
    calibration_words: str
    rendered: bool = False
    number: int | None = None


def given_picture(context: StudyContext) -> DarkPicture | None:
    """The image of ``--dark`` and the mask of ``--dark-mask``; None where no image was given.

    An image that is a frame of the mission has a right picture, and labels that stand in for a
    mask.

    Raises
    ------
    ToktError
        If a file cannot be read, or the mask is of another size than the image.
    """
    file = context.request.dark
    if file is None:
        return None
    left, number = read_image(file), context.frame_with(file)
    right = None if number is None else context.right(number)
    words = f"The image {file.name}" + (
        "" if number is None else f", which is the mission's frame {number}"
    )
    mask, truth, truth_words = _truth(context, left, number)
    paired = right is not None
    return DarkPicture(
        left,
        right,
        mask,
        truth,
        context.calibration if paired else None,
        words,
        truth_words,
        context.calibration_words if paired else "",
        number=number,
    )


def _truth(
    context: StudyContext, left: NDArray[np.uint8], number: int | None
) -> tuple[NDArray[np.uint8] | None, PatchTruth | None, str]:
    """A mask to show, the truth by patch, and whose it is."""
    file = context.request.dark_mask
    if file is not None:
        mask = read_image(file)
        if mask.ndim == 3:
            mask = np.asarray(cv2.cvtColor(mask, cv2.COLOR_BGR2GRAY), np.uint8)
        if mask.shape != left.shape[:2]:
            sizes = ["x".join(map(str, one.shape[1::-1])) for one in (mask, left)]
            image = context.request.dark
            raise ToktError(f"the mask {file} is {sizes[0]}, its image {image} is {sizes[1]}")
        return mask, truth_by_mask(mask, GRID), f"the mask {file.name}"
    truth = None if number is None else truth_by_labels(context.truth(number))
    if truth is None:
        return None, None, "not marked by anybody (give --dark-mask)"
    mask = GRID.paint(truth.obstacle, *GRID.resized(*left.shape[:2]))
    return mask, truth, "the frame's labels"


def dark_scene(context: StudyContext) -> DarkScene:
    """The scene to render, as wide as the mission's frames if that can be rendered."""
    width = context.left(context.structure_frame).shape[1]
    return DarkScene(int(np.clip(width, *RENDERED_WIDTHS)))


def rendered_picture(scene: DarkScene, light: float) -> DarkPicture:
    """The scene by a lamp of `light`, as a share of a rendered mission's."""
    pair = scene.at(light)
    words = (
        f"A rendered picture of the tower at {pair.nearest_m:.1f} m by a lamp of {light:g} of a "
        "mission's light, as no image was given (--dark)"
    )
    return DarkPicture(
        pair.left,
        pair.right,
        pair.mask,
        truth_by_mask(pair.mask, GRID),
        pair.calibration,
        words,
        "the exact rendered mask",
        "the rendered rig's exact calibration",
        rendered=True,
    )
