"""Predictions of single pictures, patch by patch, by every method that needs no other frame."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.inference.frame import Frame
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.verdict import STATUS_WORDS, UNKNOWN, verdict_from_mask
from tokt.models.bundle.bundle import read_bundle
from tokt.studies.baselines.slic import SlicTexture
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.context import StudyContext
from tokt.studies.thesis.methods.curves import COMPARED, OURS, SLIC_TITLES, THESIS
from tokt.studies.thesis.methods.held_out_texture import TOKT_TEXTURE
from tokt.studies.thesis.methods.patch_scores import Flags, patches_of_mask
from tokt.studies.thesis.methods.sequence_methods import TOKT_MODEL, TOKT_STEREO

from .training_images import described


@dataclass(frozen=True)
class MethodPrediction:
    """One method's predictions of a picture.

    Parameters
    ----------
    name, title : str
    kind : str
        `THESIS`, `COMPARED` or `OURS`.
    words : str
        What it learnt from.
    patches : array of bool, shape (n_patches,), or None
        The patches it says are an obstacle; None where it could not judge the picture, which is
        never the same as clear.
    mask : array of uint8, shape (height, width), or None
        0/255, at the grid's width.
    fault : str
        Why it could not judge; empty where it did.
    """

    name: str
    title: str
    kind: str
    words: str
    patches: Flags | None
    mask: NDArray[np.uint8] | None
    fault: str = ""

    @property
    def status(self) -> str:
        """``obstacle``, ``clear`` or ``unknown``, by the mean of the mask alone."""
        known = UNKNOWN if self.mask is None else verdict_from_mask(self.mask, self.name).status
        return STATUS_WORDS[known]


def learnt_words(said: Iterable[MethodPrediction]) -> tuple[str, ...]:
    """What the methods learnt from, those that learnt alike in one sentence."""
    titles: dict[str, list[str]] = {}
    for one in said:
        if one.words:
            titles.setdefault(one.words, []).append(one.title)
    return tuple(f"{', '.join(who)}: {words.rstrip('.')}." for words, who in titles.items())


def said_by_patches(
    name: str, title: str, kind: str, words: str, patches: Flags, frame: NDArray[np.uint8]
) -> MethodPrediction:
    """Predictions of a method that judges patches of the grid."""
    mask = GRID.paint(patches, *GRID.resized(*frame.shape[:2]))
    return MethodPrediction(name, title, kind, words, patches, mask)


def by_thesis(context: StudyContext, frame: NDArray[np.uint8]) -> list[MethodPrediction]:
    """The thesis's three texture models on a picture, by tokt's kernels of the same features."""
    rows, words = described(frame), context.two_images
    return [
        said_by_patches(
            name, model.title, THESIS, words, model.classifier.predict(rows[name]) == 1, frame
        )
        for name, model in context.thesis.items()
    ]


def by_held_out(
    context: StudyContext, number: int, frame: NDArray[np.uint8]
) -> list[MethodPrediction]:
    """Our texture model on a frame of the mission, by a model that did not learn from it."""
    curves = context.curves
    patches = curves.patches.get(TOKT_TEXTURE, {}).get(number)
    if patches is None:
        return []
    method = curves.methods[TOKT_TEXTURE]
    return [said_by_patches(TOKT_TEXTURE, method.title, OURS, method.words, patches, frame)]


def by_bundle(
    context: StudyContext, frame: NDArray[np.uint8], words: str
) -> list[MethodPrediction]:
    """The bundle of the request on a picture, by its patches; nothing where none was given.

    Raises
    ------
    ToktError
        If it is not a bundle that can be used.
    """
    if context.request.model is None:
        return []
    bundle = read_bundle(str(context.request.model))
    title = f"tokt model {bundle.label}"
    if bundle.grid != GRID:
        fault = f"its patches are {bundle.grid}, these figures are of {GRID}"
        return [MethodPrediction(TOKT_MODEL, title, OURS, words, None, None, fault)]
    try:
        values = bundle.values_of(bundle.features(frame))
    except ValueError as error:
        return [MethodPrediction(TOKT_MODEL, title, OURS, words, None, None, str(error))]
    patches = bundle.model.obstacle_patches(values)
    return [said_by_patches(TOKT_MODEL, title, OURS, words, patches, frame)]


def by_stereo(
    calibration: StereoCalibration | None,
    left: NDArray[np.uint8],
    right: NDArray[np.uint8] | None,
    words: str,
) -> MethodPrediction:
    """Our stereo on a pair; it learns nothing.

    Parameters
    ----------
    calibration : StereoCalibration or None
    left, right : array of uint8
        As decoded.
    words : str
        Where the calibration is from, or why there is none.
    """
    title = "tokt stereo"
    if right is None:
        return MethodPrediction(
            TOKT_STEREO, title, OURS, words, None, None, "there is no right picture"
        )
    if calibration is None:
        return MethodPrediction(TOKT_STEREO, title, OURS, words, None, None, words)
    try:
        found = DisparityDetector(calibration, GRID).detect(Frame(1, 0.0, left, right))
    except ToktError as error:
        return MethodPrediction(TOKT_STEREO, title, OURS, words, None, None, str(error))
    if found.mask is None:
        return MethodPrediction(TOKT_STEREO, title, OURS, words, None, None, str(found.fault))
    patches = patches_of_mask(found.mask, GRID)
    return MethodPrediction(TOKT_STEREO, title, OURS, words, patches, found.mask)


def by_superpixels(
    context: StudyContext, number: int, frame: NDArray[np.uint8]
) -> list[MethodPrediction]:
    """The methods that cut the picture into superpixels, by the patches that they cover.

    Parameters
    ----------
    context : StudyContext
    number : int
        The frame's, where it is one of the mission's: then by a model that did not learn from it.
    frame : array of uint8
    """
    found = []
    for method in context.superpixel_methods.of(number):
        judged = method.judge(frame, None, 0.0)
        kind = THESIS if isinstance(method, SlicTexture) else COMPARED
        patches = None if judged.mask is None else patches_of_mask(judged.mask, GRID)
        fault = judged.words if judged.mask is None else ""
        words, title = (
            context.superpixel_methods.words(method),
            SLIC_TITLES.get(method.name, method.title),
        )
        found.append(MethodPrediction(method.name, title, kind, words, patches, judged.mask, fault))
    return found
