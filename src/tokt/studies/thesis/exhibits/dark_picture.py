"""The badly lit picture that is judged, and what is in it: given, or rendered."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...features.errors import ToktError
from ...features.image_file import read_image
from ...inference.calibration import StereoCalibration
from ..bench.thesis_way import GRID
from .dark_frame import RENDERED_WIDTHS, DarkScene
from .material import Material
from .patch_scores import PatchTruth, truth_by_labels, truth_by_mask


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


def given_picture(material: Material) -> DarkPicture | None:
    """The image of ``--dark`` and the mask of ``--dark-mask``; None where no image was given.

    An image that is a frame of the mission has a right picture, and labels that stand in for a
    mask.

    Raises
    ------
    ToktError
        If a file cannot be read, or the mask is of another size than the image.
    """
    file = material.request.dark
    if file is None:
        return None
    left, number = read_image(file), material.frame_with(file)
    right = None if number is None else material.right(number)
    words = f"The image {file.name}" + (
        "" if number is None else f", which is the mission's frame {number}"
    )
    mask, truth, truth_words = _truth(material, left, number)
    paired = right is not None
    return DarkPicture(
        left,
        right,
        mask,
        truth,
        material.calibration if paired else None,
        words,
        truth_words,
        material.calibration_words if paired else "",
        number=number,
    )


def _truth(
    material: Material, left: NDArray[np.uint8], number: int | None
) -> tuple[NDArray[np.uint8] | None, PatchTruth | None, str]:
    """A mask to show, the truth by patch, and whose it is."""
    file = material.request.dark_mask
    if file is not None:
        mask = read_image(file)
        if mask.ndim == 3:
            mask = np.asarray(cv2.cvtColor(mask, cv2.COLOR_BGR2GRAY), np.uint8)
        if mask.shape != left.shape[:2]:
            sizes = ["x".join(map(str, one.shape[1::-1])) for one in (mask, left)]
            image = material.request.dark
            raise ToktError(f"the mask {file} is {sizes[0]}, its image {image} is {sizes[1]}")
        return mask, truth_by_mask(mask, GRID), f"the mask {file.name}"
    truth = None if number is None else truth_by_labels(material.truth(number))
    if truth is None:
        return None, None, "not marked by anybody (give --dark-mask)"
    mask = GRID.paint(truth.obstacle, *GRID.resized(*left.shape[:2]))
    return mask, truth, "the frame's labels"


def dark_scene(material: Material) -> DarkScene:
    """What is rendered: as wide as the mission's frames, within what can be."""
    width = material.left(material.structure).shape[1]
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
