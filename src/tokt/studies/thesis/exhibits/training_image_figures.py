"""Figures 3.11 and 3.12: LBP histograms of training images, and which of them separates best.

The thesis chose its training images by looking at LBP histograms. Here the looking is a distance;
what it promises is held against what it should lead to, a model that finds the labelled patches.

A uniform pattern of P points on a circle is one run of k brighter points::

    k = 0 or P          k about P/2          k about P/4 or 3P/4
     . . .               . o o                . . o
    .     .             .     o              .     o
     . . .               . . o                . . .
    flat: a spot        edge: half of        corner: a quarter of the
    or an even area     the circle           circle, or all but a quarter

The bin after the P + 1 uniform ones counts all patterns of several runs. Noise makes these.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from typing import Any

import cv2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy.spatial.distance import cdist
from scipy.stats import spearmanr
from skimage import data

from tokt.features.common.arrays import F64, U8
from tokt.studies.baselines.thesis_models import TITLES, thesis_classifier
from tokt.studies.baselines.thesis_texture import GRID, resized_gray
from tokt.studies.speed.models import FEATURE_SETS
from tokt.studies.thesis.patch_scores import pooled_score
from tokt.training.fitting.train import rendered_other_image
from tokt.training.rig.calibrate.frame_selection import evenly_spaced

from .exhibit import NOT_KNOWN, Claim, Exhibit, Plot, StudyContext, Table
from .frame_drawing import SHOWN, new_figure, png_of, show_frame

LBP_KEYS = ("lbp_10_5", "lbp_24_8")
EXTRACTORS = {one.name: one.extractor for one in FEATURE_SETS}
"""The thesis's features by tokt's kernels: the same integers, and the same figures to 12 digits,
in a tenth of the time."""

_TOLERANCE = Fraction(1, 12)
"""Of the circle. Two points of 24, as in scikit-image's example of edge, flat and corner bins."""


class BinKind(StrEnum):
    """The kind of place that gives a pattern."""

    FLAT = "flat"
    EDGE = "edge"
    CORNER = "corner"
    BETWEEN = "between"
    NOT_UNIFORM = "not uniform"


_PLACES = {BinKind.FLAT: Fraction(0), BinKind.EDGE: Fraction(1, 2), BinKind.CORNER: Fraction(1, 4)}
"""By kind, the share of the circle that is brighter, or darker."""


def bin_kinds(points: int) -> tuple[BinKind, ...]:
    """What each bin of a uniform LBP histogram stands for, of `points` + 2 bins.

    Examples
    --------
    >>> [str(kind) for kind in bin_kinds(8)][:5]
    ['flat', 'between', 'corner', 'between', 'edge']
    """
    kinds = []
    for run in range(points + 1):
        share = Fraction(min(run, points - run), points)
        near = (kind for kind, place in _PLACES.items() if abs(share - place) <= _TOLERANCE)
        kinds.append(next(near, BinKind.BETWEEN))
    return (*kinds, BinKind.NOT_UNIFORM)


def described(picture: U8) -> dict[str, F64]:
    """The thesis's features of each patch of a picture, by extractor."""
    return {key: texture.describe(picture, GRID) for key, texture in EXTRACTORS.items()}


def hellinger(first: F64, second: F64) -> F64:
    """Hellinger distances (n, m) between histograms, (n, bins) and (m, bins), whose rows sum to 1.

    0 between equal ones and 1 between those with no bin in common:
    ``sqrt(1 - sum(sqrt(p q)))``.
    """
    return np.asarray(cdist(np.sqrt(first), np.sqrt(second)) / np.sqrt(2.0), np.float64)


def chi_square(first: F64, second: F64) -> float:
    """Symmetric chi-square distance of two histograms, 0 to 1: ``sum((p-q)^2 / (p+q)) / 2``."""
    pair = first.astype(np.float32), second.astype(np.float32)
    return float(cv2.compareHist(*pair, cv2.HISTCMP_CHISQR_ALT)) / 4.0


def confused(first: F64, second: F64) -> float:
    """Share of the patches of two images that are nearer to the other image's mean histogram.

    0 where the two separate cleanly; about 0.5 where their patches look alike. A tie is
    confused.
    """
    means = np.stack([first.mean(axis=0), second.mean(axis=0)])
    to_first, to_second = hellinger(first, means), hellinger(second, means)
    wrong = (to_first[:, 0] >= to_first[:, 1]).sum() + (to_second[:, 1] >= to_second[:, 0]).sum()
    return float(wrong / (len(first) + len(second)))


KIND_COLORS = {
    BinKind.FLAT: "#4da3ff",
    BinKind.EDGE: "#ff7043",
    BinKind.CORNER: "#8e5bd0",
    BinKind.BETWEEN: "#c4c8cc",
    BinKind.NOT_UNIFORM: "#6b7075",
}
TO_OCEAN, TO_STRUCTURE = "to ocean", "to structure"
CONFUSED, F1 = "patches confused", "F1"
"""Columns of the table, after an extractor's key."""
CONTROL, STRUCTURE = "ocean frame", "structure frame"
_KEY = LBP_KEYS[0]
_CRITERIA = {
    TO_OCEAN: "Hellinger distance from ocean's histogram",
    CONFUSED: "share of patches confused with ocean's",
    TO_STRUCTURE: "Hellinger distance from the structure's histogram",
}
"""What an image could be chosen by; only the first and second need no look at the structure."""
_SCORED_FRAMES = 24
_PHOTOS = ("brick", "gravel", "grass", "coffee")

Tested = Mapping[int, dict[str, F64]]
"""By labelled frame that models are scored on: its features by extractor."""


@dataclass(frozen=True)
class Image:
    """An image, with the features of its patches by extractor.

    A bright one can be seen without raising its contrast.
    """

    name: str
    words: str
    picture: U8
    rows: dict[str, F64]
    bright: bool = False


def training_images(context: StudyContext) -> Exhibit:
    """Histograms of the images the thesis's models could learn from (figures 3.11, 3.12)."""
    ocean = _image("ocean", context.ocean.words, context.ocean.image)
    images = {image.name: image for image in _candidates(context)}
    structure = _structure_of(context, images[STRUCTURE])
    tested = _tested(context)
    rows = [_row(context, ocean, image, structure, tested) for image in images.values()]
    table = pd.DataFrame(rows).sort_values(f"{_KEY} {TO_OCEAN}", ascending=False, ignore_index=True)
    n_tested, rank = len(tested), _rank(table)
    numbers = _numbers(table, rank, n_tested, ocean.rows[_KEY], structure.rows[_KEY])
    shown = [ocean, structure, *(images[name] for name in table["image"])]
    plots = [
        Plot(
            "histograms",
            "Mean LBP histogram of the patches of each image, on one scale; a bar that is cut off "
            f"has its value beside it. First ocean and {structure.words}, then what could be "
            f"learnt from, the image farthest from ocean first. {SHOWN}",
            png_of(_histograms(shown)),
        )
    ]
    if rank:
        plots.append(_promise_plot(table, n_tested))
    caption = (
        "Distance of each image's mean histogram from ocean's and from the structure's (0 equal, 1 "
        "disjoint), and the share of patches confused with ocean's. F1 by patch is of a model that "
        f"learnt from ocean and this image, pooled over {n_tested} labelled frames (empty without "
        "labels). No frame is both learnt from and scored."
    )
    return Exhibit(
        (
            "Bins are coloured by the share of the circle that is brighter than its centre. None "
            "or all of it is flat, half an edge, a quarter or three quarters a corner, each "
            "within a twelfth. Patterns of several runs, which noise makes, are the last bin.",
            f"Distances are Hellinger's; the structure is {structure.words}. A patch is confused "
            "when it is nearer to the other image's mean histogram than to its own image's. "
            f"Ocean is {ocean.words}.",
        ),
        _claims(numbers, rank),
        (Table("candidates", caption, table, "Images to learn from"),),
        tuple(plots),
        numbers,
    )


def _rank(table: pd.DataFrame) -> dict[str, float]:
    """Spearman's rank correlation of F1 with each criterion, for LBP (10, 5).

    Empty without labels, and where all F1 are the same: there is nothing to rank.
    """
    f1 = table[f"{_KEY} {F1}"]
    if f1.isna().any() or f1.nunique() < 2:
        return {}
    return {
        name: float(spearmanr(table[f"{_KEY} {name}"], f1).statistic)
        for name in _CRITERIA
        if table[f"{_KEY} {name}"].nunique() > 1
    }


def _claims(numbers: dict[str, Any], rank: dict[str, float]) -> tuple[Claim, ...]:
    found = f"{numbers['farthest_image']}, {numbers['farthest_hellinger']:.2f} from ocean's"
    if "control_hellinger" in numbers:
        found += f"; another ocean frame {numbers['control_hellinger']:.2f}"
    first = Claim(
        "the image whose LBP (10, 5) histogram is farthest from ocean's",
        NOT_KNOWN,
        found,
        "The thesis's other images are not at hand.",
    )
    if not rank:
        return (first,)
    ranks = ", ".join(f"{name} {value:+.2f}" for name, value in rank.items())
    second = Claim(
        "the farther its histogram is from ocean's, the better an image is to learn from",
        NOT_KNOWN,
        f"best F1 {numbers['best_f1']:.2f} with {numbers['best_f1_image']}; the farthest, "
        f"{numbers['farthest_image']}, gives {numbers['farthest_f1']:.2f}; rank correlation "
        f"with F1: {ranks}",
        "What choosing by histograms presumes, no printed figure; judged on "
        f"{numbers['scored_frames']} labelled frames that no model here learnt from.",
    )
    return first, second


def _numbers(
    table: pd.DataFrame, rank: dict[str, float], n_tested: int, ocean: F64, structure: F64
) -> dict[str, Any]:
    farthest = table.iloc[0]
    numbers: dict[str, Any] = {
        "farthest_image": str(farthest["image"]),
        "farthest_hellinger": float(farthest[f"{_KEY} {TO_OCEAN}"]),
        "ocean_to_structure_hellinger": _means_apart(ocean, structure),
        "ocean_not_uniform_share": float(ocean.mean(axis=0)[-1]),
        "structure_not_uniform_share": float(structure.mean(axis=0)[-1]),
        "scored_frames": n_tested,
    }
    for row in table[table["image"] == CONTROL].to_dict("records"):
        numbers["control_hellinger"] = float(row[f"{_KEY} {TO_OCEAN}"])
        numbers["control_patches_confused"] = float(row[f"{_KEY} {CONFUSED}"])
    if rank:
        best = table.loc[table[f"{_KEY} {F1}"].idxmax()]
        numbers["best_f1_image"] = str(best["image"])
        numbers["best_f1"] = float(best[f"{_KEY} {F1}"])
        numbers["farthest_f1"] = float(farthest[f"{_KEY} {F1}"])
        for name, value in rank.items():
            numbers[f"rank_correlation_f1_{name.replace(' ', '_')}"] = value
    return numbers


def _image(name: str, words: str, picture: Any, bright: bool = False) -> Image:
    pixels = np.ascontiguousarray(picture, np.uint8)
    return Image(name, words, pixels, described(pixels), bright)


def _candidates(context: StudyContext) -> list[Image]:
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
    number, control = context.structure_frame, _control(context)
    found.append(_image(STRUCTURE, f"frame {number}, whole", context.left(number)))
    if control is not None:
        words = f"frame {control}: ocean too, so it should not separate"
        found.append(_image(CONTROL, words, context.left(control)))
    return found


def _control(context: StudyContext) -> int | None:
    """Another frame of open ocean, by the labels."""
    other = [number for number in context.ocean_frames if number != context.ocean.frame]
    return other[len(other) // 2] if other else None


def _structure_of(context: StudyContext, frame: Image) -> Image:
    """The structure's own patches of the frame that shows it; without labels all of them."""
    there = context.truth(context.structure_frame) == 1
    words = f"all patches of frame {context.structure_frame}, which has no labels"
    if there.any():
        words = f"the {there.sum()} obstacle patches of frame {context.structure_frame}"
    rows = {key: one[there] if there.any() else one for key, one in frame.rows.items()}
    return Image("structure", words, frame.picture, rows)


def _tested(context: StudyContext) -> Tested:
    """Labelled frames spread over the mission; none that a candidate is made of."""
    left_out = {context.structure_frame, _control(context)}
    labelled = [number for number in context.truths if number not in left_out]
    chosen = evenly_spaced(labelled, _SCORED_FRAMES)
    return {number: described(frame) for number, frame in context.decoded(chosen)}


def _row(
    context: StudyContext, ocean: Image, image: Image, structure: Image, tested: Tested
) -> dict[str, Any]:
    """Distances of an image, and F1 over the tested frames of a model of it and ocean."""
    row: dict[str, Any] = {"image": image.name, "what": image.words}
    for key in LBP_KEYS:
        mine, water = image.rows[key], ocean.rows[key]
        row[f"{key} {TO_OCEAN}"] = _means_apart(mine, water)
        row[f"{key} chi-square {TO_OCEAN}"] = chi_square(mine.mean(axis=0), water.mean(axis=0))
        row[f"{key} {TO_STRUCTURE}"] = _means_apart(mine, structure.rows[key])
        row[f"{key} {CONFUSED}"] = confused(mine, water)
    for key in EXTRACTORS:
        row[f"{key} {F1}"] = None
        if tested:
            parts = ocean.rows[key], image.rows[key]
            targets = np.repeat([0, 1], [len(one) for one in parts])
            classifier = thesis_classifier(np.vstack(parts), targets)
            said = {number: classifier.predict(rows[key]) == 1 for number, rows in tested.items()}
            row[f"{key} {F1}"] = pooled_score(said, context.truths).f1
    return row


def _means_apart(first: F64, second: F64) -> float:
    """Hellinger distance between the mean histograms of two sets of patches."""
    return float(hellinger(first.mean(axis=0)[None], second.mean(axis=0)[None])[0, 0])


def _histograms(shown: Sequence[Image]) -> Figure:
    """A row an image: the picture, and its mean histogram with the kinds of bins in colour."""
    figure, axes = new_figure(
        10.5, 1.5 * len(shown) + 0.6, len(shown), 3, width_ratios=(1.1, 1.6, 2.6), squeeze=False
    )
    for line, image in zip(axes, shown, strict=True):
        if image.bright:
            line[0].imshow(resized_gray(image.picture), cmap="gray", vmin=0, vmax=255)
            line[0].set(xticks=[], yticks=[])
        else:
            show_frame(line[0], image.picture)
        line[0].set_ylabel(image.name, fontsize=9)
    for column, key in enumerate(LBP_KEYS, 1):
        means = [image.rows[key].mean(axis=0) for image in shown]
        top = 1.15 * max(float(mean[:-1].max()) for mean in means)
        for line, mean in zip(axes, means, strict=True):
            draw_histogram(line[column], mean, top)
        axes[0, column].set_title(TITLES[key], fontsize=9)
        axes[-1, column].set_xlabel("points brighter than the centre; last: several runs",
                                    fontsize=8)  # fmt: skip
    kind_legend(figure)
    return figure


def draw_histogram(axes: Any, histogram: F64, top: float) -> None:
    """An LBP histogram with the kinds of its bins in colour, cut off at `top`."""
    last = len(histogram) - 1
    axes.bar(range(last + 1), histogram, color=[KIND_COLORS[k] for k in bin_kinds(last - 1)])
    if histogram[last] > top:
        value = axes.text(last - 0.7, 0.94 * top, f"{histogram[last]:.2f}", ha="right", va="top")
        value.set(fontsize=8, bbox={"facecolor": "white", "pad": 1, "edgecolor": "none"})
    axes.set(ylim=(0, top), xlim=(-0.7, last + 0.7))
    axes.tick_params(labelsize=7)


def kind_legend(figure: Figure) -> None:
    """What the colours of the bins are, under a figure."""
    handles = [Patch(color=color, label=str(kind)) for kind, color in KIND_COLORS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=8, frameon=False)


def _promise_plot(table: pd.DataFrame, n_tested: int) -> Plot:
    """What a model trained on an image finds, against what the image could be chosen by."""
    figure, panels = new_figure(10.5, 3.7, 1, 3, sharey=True)
    f1 = table[f"{_KEY} {F1}"]
    for axes, (name, words) in zip(panels, _CRITERIA.items(), strict=True):
        value = table[f"{_KEY} {name}"]
        axes.plot(value, f1, "o", color="#3b75af")
        above = np.argsort(np.argsort(value)) % 2
        for label, x, y, up in zip(table["image"], value, f1, above, strict=True):
            axes.annotate(
                label, (x, y), (0, 7 if up else -13), textcoords="offset points", fontsize=8,
                ha="center",
            )  # fmt: skip
        room = 0.22 * float(np.ptp(value)) or 0.05
        axes.set(xlim=(value.min() - room, value.max() + room), ylim=(-0.1, 1.0))
        axes.set_xlabel(words, fontsize=8)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel(f"F1 by patch, {n_tested} labelled frames", fontsize=8)
    caption = (
        "Is the image that is farthest from ocean the best to learn from? F1 by patch of a model "
        "on LBP (10, 5) that learnt from ocean and each image, against what the image could be "
        f"chosen by. Scored on {n_tested} labelled frames that no model here learnt from."
    )
    return Plot("chosen-by", caption, png_of(figure))
