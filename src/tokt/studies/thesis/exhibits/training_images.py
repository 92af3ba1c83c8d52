"""Candidates for the image of "anything else": their distance from ocean, and their models.

The thesis chose its training images by looking at LBP histograms. Here the looking is a distance;
what it promises is held against what it should lead to, a model that finds the labelled patches.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from skimage import data

from tokt.features.extractors.extractor import NAMED, Haralick
from tokt.studies.baselines.thesis_models import thesis_classifier
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.context import StudyContext
from tokt.studies.thesis.methods.patch_scores import (
    PatchScore,
    PatchTruth,
    score_patches,
    truth_by_labels,
)
from tokt.studies.thesis.methods.texture_histograms import Rows, chi_square, confused, hellinger
from tokt.training.fitting.train import rendered_other_image
from tokt.training.rig.calibrate.frame_selection import evenly_spaced

LBP_KEYS = ("lbp_10_5", "lbp_24_8")
EXTRACTORS = {
    "lbp_10_5": NAMED["lbp_10_5"],
    "lbp_24_8": NAMED["lbp_24_8"],
    "haralick": Haralick(ignore_zeros=True),
}
"""The thesis's features by tokt's kernels: the same integers, and the same figures to 12 digits,
in a tenth of the time."""

TO_OCEAN, TO_STRUCTURE = "to ocean", "to structure"
CONFUSED, F1 = "patches confused", "F1"
"""Columns of the table, after an extractor's key."""
CONTROL, STRUCTURE = "ocean frame", "structure frame"

_SCORED_FRAMES = 24
_PHOTOS = ("brick", "gravel", "grass", "coffee")


@dataclass(frozen=True)
class Image:
    """An image, with the features of its patches.

    Parameters
    ----------
    name, words : str
    picture : array of uint8, shape (height, width) or (height, width, 3)
    rows : dict
        By extractor, float64, (n_patches, dim).
    bright : bool
        Whether it can be seen without raising its contrast.
    """

    name: str
    words: str
    picture: NDArray[np.uint8]
    rows: dict[str, Rows]
    bright: bool


@dataclass(frozen=True)
class Tested:
    """Labelled frames that models are scored on: truth, and features by extractor."""

    truths: list[PatchTruth]
    rows: dict[str, list[Rows]]


def described(picture: NDArray[np.uint8]) -> dict[str, Rows]:
    """The thesis's features of each patch of a picture, by extractor."""
    return {key: texture.describe(picture, GRID) for key, texture in EXTRACTORS.items()}


def _image(name: str, words: str, picture: Any, bright: bool = False) -> Image:
    pixels = np.ascontiguousarray(picture, np.uint8)
    return Image(name, words, pixels, described(pixels), bright)


def ocean_image(context: StudyContext) -> Image:
    """The image of ocean that the thesis's models learn from."""
    return _image("ocean", context.ocean.words, context.ocean.image)


def candidates(context: StudyContext) -> list[Image]:
    """What could stand for "anything else", and as a control an ocean frame that should not.

    The image asked for or the rendered texture; photos that come with scikit-image, rough, bright
    and in focus as a film still is; and the mission's own frame of the structure.
    """
    found = [_image("other", context.other.words, context.other.image, True)]
    if context.request.other is not None:
        found.append(_image("rendered", "a rendered texture", rendered_other_image(), True))
    for name in _PHOTOS:
        picture = np.asarray(getattr(data, name)())
        if picture.ndim == 3:
            picture = picture[..., ::-1]  # RGB; frames are BGR
        found.append(_image(name, f"photo of {name}, from scikit-image", picture, True))
    number = context.structure_frame
    found.append(_image(STRUCTURE, f"frame {number}, whole", context.left(number)))
    control = _control(context)
    if control is not None:
        words = f"frame {control}: ocean too, so it should not separate"
        found.append(_image(CONTROL, words, context.left(control)))
    return found


def _control(context: StudyContext) -> int | None:
    """Another frame of open ocean, by the labels."""
    known = [number for number in context.ocean_frames if number != context.ocean.frame]
    return known[len(known) // 2] if known else None


def structure_rows(context: StudyContext, frame: Image) -> tuple[dict[str, Rows], str]:
    """Features of the structure's own patches, and which these are.

    Parameters
    ----------
    frame : Image
        Of the frame `StudyContext.structure_frame`.
    """
    there = context.truth(context.structure_frame) == 1
    if there.any():
        words = f"the {there.sum()} obstacle patches of frame {context.structure_frame}"
        return {key: rows[there] for key, rows in frame.rows.items()}, words
    return frame.rows, f"all patches of frame {context.structure_frame}, which has no labels"


def tested_frames(context: StudyContext) -> Tested:
    """Labelled frames spread over the mission; none that a candidate is made of."""
    left_out = {context.structure_frame, _control(context)}
    labelled = [
        (number, truth)
        for number in context.scored
        if number not in left_out and (truth := truth_by_labels(context.truth(number)))
    ]
    chosen = dict(evenly_spaced(labelled, _SCORED_FRAMES))
    tested = Tested([], {key: [] for key in EXTRACTORS})
    for number, frame in context.decoded(list(chosen)):
        tested.truths.append(chosen[number])
        for key, rows in described(frame).items():
            tested.rows[key].append(rows)
    return tested


def candidate_table(
    ocean: Image, images: list[Image], structure: dict[str, Rows], tested: Tested
) -> pd.DataFrame:
    """One row a candidate, the one whose LBP (10, 5) histogram is farthest from ocean's first.

    Parameters
    ----------
    ocean : Image
    images : list of Image
    structure : dict
        Features of the structure's own patches, by extractor.
    tested : Tested
    """
    rows = [_row(ocean, image, structure, tested) for image in images]
    return pd.DataFrame(rows).sort_values(
        f"{LBP_KEYS[0]} {TO_OCEAN}", ascending=False, ignore_index=True
    )


def _row(ocean: Image, image: Image, structure: dict[str, Rows], tested: Tested) -> dict[str, Any]:
    row: dict[str, Any] = {"image": image.name, "what": image.words}
    for key in LBP_KEYS:
        mine, water = image.rows[key], ocean.rows[key]
        row[f"{key} {TO_OCEAN}"] = means_apart(mine, water)
        row[f"{key} chi-square {TO_OCEAN}"] = chi_square(mine.mean(axis=0), water.mean(axis=0))
        row[f"{key} {TO_STRUCTURE}"] = means_apart(mine, structure[key])
        row[f"{key} {CONFUSED}"] = confused(mine, water)
    for key in EXTRACTORS:
        row[f"{key} {F1}"] = _f1(key, ocean, image, tested)
    return row


def means_apart(first: Rows, second: Rows) -> float:
    """Hellinger distance between the mean histograms of two sets of patches."""
    return float(hellinger(first.mean(axis=0)[None], second.mean(axis=0)[None])[0, 0])


def _f1(key: str, ocean: Image, other: Image, tested: Tested) -> float | None:
    """F1 over the tested frames of a model that learnt from two images."""
    if not tested.truths:
        return None
    targets = np.repeat([0, 1], [len(ocean.rows[key]), len(other.rows[key])])
    classifier = thesis_classifier(np.vstack([ocean.rows[key], other.rows[key]]), targets)
    total = PatchScore(0, 0, 0, 0)
    for rows, truth in zip(tested.rows[key], tested.truths, strict=True):
        total += score_patches(classifier.predict(rows) == 1, truth)
    return total.f1
