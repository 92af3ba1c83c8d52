"""One picture by every method that looks at a picture by itself, patch by patch."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...features.errors import ToktError
from ...inference.calibration import StereoCalibration
from ...inference.disparity import DisparityDetector
from ...inference.sources import Frame
from ...inference.verdict import STATUS_WORDS, UNKNOWN, verdict_from_mask
from ...models.bundle import read_bundle
from ..baselines.slic import SlicTexture
from ..bench.thesis_way import GRID
from .curves import COMPARED, OURS, SLIC_TITLES, THESIS
from .held_out_texture import TOKT_TEXTURE
from .material import Material
from .patch_scores import Flags, patches_of_mask
from .run_judging import TOKT_MODEL, TOKT_STEREO
from .training_images import described


@dataclass(frozen=True)
class Said:
    """What one method says of a picture.

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


def learnt_words(said: Iterable[Said]) -> tuple[str, ...]:
    """What the methods learnt from, those that learnt alike in one sentence."""
    titles: dict[str, list[str]] = {}
    for one in said:
        if one.words:
            titles.setdefault(one.words, []).append(one.title)
    return tuple(f"{', '.join(who)}: {words.rstrip('.')}." for words, who in titles.items())


def said_by_patches(
    name: str, title: str, kind: str, words: str, patches: Flags, frame: NDArray[np.uint8]
) -> Said:
    """What a method says that judges patches of the grid."""
    mask = GRID.paint(patches, *GRID.resized(*frame.shape[:2]))
    return Said(name, title, kind, words, patches, mask)


def by_thesis(material: Material, frame: NDArray[np.uint8]) -> list[Said]:
    """The thesis's three texture models on a picture, by tokt's kernels of the same features."""
    rows, words = described(frame), material.two_images
    return [
        said_by_patches(
            name, model.title, THESIS, words, model.classifier.predict(rows[name]) == 1, frame
        )
        for name, model in material.thesis.items()
    ]


def by_held_out(material: Material, number: int, frame: NDArray[np.uint8]) -> list[Said]:
    """Our texture model on a frame of the mission, by a model that did not learn from it."""
    curves = material.curves
    patches = curves.patches.get(TOKT_TEXTURE, {}).get(number)
    if patches is None:
        return []
    method = curves.methods[TOKT_TEXTURE]
    return [said_by_patches(TOKT_TEXTURE, method.title, OURS, method.words, patches, frame)]


def by_bundle(material: Material, frame: NDArray[np.uint8], words: str) -> list[Said]:
    """The bundle of the request on a picture, by its patches; nothing where none was given.

    Raises
    ------
    ToktError
        If it is not a bundle that can be used.
    """
    if material.request.model is None:
        return []
    bundle = read_bundle(str(material.request.model))
    title = f"tokt model {bundle.label}"
    if bundle.grid != GRID:
        fault = f"its patches are {bundle.grid}, these figures are of {GRID}"
        return [Said(TOKT_MODEL, title, OURS, words, None, None, fault)]
    try:
        values = bundle.values_of(bundle.features(frame))
    except ValueError as error:
        return [Said(TOKT_MODEL, title, OURS, words, None, None, str(error))]
    patches = bundle.model.obstacle_patches(values)
    return [said_by_patches(TOKT_MODEL, title, OURS, words, patches, frame)]


def by_stereo(
    calibration: StereoCalibration | None,
    left: NDArray[np.uint8],
    right: NDArray[np.uint8] | None,
    words: str,
) -> Said:
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
        return Said(TOKT_STEREO, title, OURS, words, None, None, "there is no right picture")
    if calibration is None:
        return Said(TOKT_STEREO, title, OURS, words, None, None, words)
    try:
        found = DisparityDetector(calibration, GRID).detect(Frame(1, 0.0, left, right))
    except ToktError as error:
        return Said(TOKT_STEREO, title, OURS, words, None, None, str(error))
    if found.mask is None:
        return Said(TOKT_STEREO, title, OURS, words, None, None, str(found.fault))
    patches = patches_of_mask(found.mask, GRID)
    return Said(TOKT_STEREO, title, OURS, words, patches, found.mask)


def by_superpixels(material: Material, number: int, frame: NDArray[np.uint8]) -> list[Said]:
    """The methods that cut the picture into superpixels, by the patches that they cover.

    Parameters
    ----------
    material : Material
    number : int
        The frame's, where it is one of the mission's: then by a model that did not learn from it.
    frame : array of uint8
    """
    found = []
    for method in material.slow.of(number):
        judged = method.judge(frame, None, 0.0)
        kind = THESIS if isinstance(method, SlicTexture) else COMPARED
        patches = None if judged.mask is None else patches_of_mask(judged.mask, GRID)
        fault = judged.words if judged.mask is None else ""
        words, title = material.slow.words(method), SLIC_TITLES.get(method.name, method.title)
        found.append(Said(method.name, title, kind, words, patches, judged.mask, fault))
    return found
