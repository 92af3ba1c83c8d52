"""Figures 3.11 to 3.13: LBP histograms of training images, and which of them is best to learn from.

The thesis chose its training images by looking at LBP histograms: by their edge bins, and by how
varied the texture is. That is held against what it should lead to, a model that finds the labelled
patches.

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
from scipy.stats import spearmanr
from skimage import data

from tokt.features.common.arrays import F64, U8
from tokt.features.frames.grid import Grid
from tokt.training.rig.calibrate.frame_selection import evenly_spaced
from tokt_studies.baselines.thesis_models import TITLES, thesis_classifier
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.speed.models import FEATURE_SETS
from tokt_studies.thesis.patch_scores import pooled_score

from .exhibit import Claim, ClaimAgreement, Exhibit, Plot, StudyContext, Table
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


def described(picture: U8, grid: Grid = GRID) -> dict[str, F64]:
    """The thesis's features of each patch of a picture, by extractor."""
    return {key: texture.describe(picture, grid) for key, texture in EXTRACTORS.items()}


KIND_COLORS = {
    BinKind.FLAT: "#4da3ff",
    BinKind.EDGE: "#ff7043",
    BinKind.CORNER: "#8e5bd0",
    BinKind.BETWEEN: "#c4c8cc",
    BinKind.NOT_UNIFORM: "#6b7075",
}
ALIKE, F1 = "rows alike", "F1"
"""Columns of the table; those of shares of bins are `BinKind`s."""
CONTROL, STRUCTURE, BRICK, BRANCHES = "ocean frame", "structure frame", "brick", "branches"
_KEY = LBP_KEYS[0]
_SCORED_FRAMES = 24
_PHOTOS = (BRICK, "gravel", "grass", "coffee")
_BRANCHES, _BRANCH_SEED = 60, 4
"""Limbs of the rendered branches; each forks until it is thin."""
_RANKED = -0.5
"""Rank correlation from which varied images count as better to learn from."""

Tested = Mapping[int, dict[str, F64]]
"""By labelled frame that models are scored on: its features by extractor."""


@dataclass(frozen=True)
class Image:
    """An image, with the features of its patches by extractor."""

    name: str
    words: str
    picture: U8
    rows: dict[str, F64]

    def shares(self) -> dict[BinKind, float]:
        """Parts of its patches' mean LBP histogram by the kind of the bins."""
        mean = self.rows[_KEY].mean(axis=0)
        kinds = np.array(bin_kinds(len(mean) - 2))
        return {kind: float(mean[kinds == kind].sum()) for kind in BinKind}

    def alike(self) -> float:
        """Mean correlation of two of its patches' rows: 1 where the texture is all the same."""
        rows = self.rows[_KEY]
        return float((np.corrcoef(rows).sum() - len(rows)) / (len(rows) * (len(rows) - 1)))


def training_images(context: StudyContext) -> Exhibit:
    """Histograms of the images the thesis's models could learn from (figures 3.11 to 3.13)."""
    ocean = _image("ocean", context.ocean.words, context.ocean.image)
    images = {image.name: image for image in _candidates(context)}
    tested = _tested(context)
    rows = [_row(context, ocean, image, tested) for image in images.values()]
    table = pd.DataFrame(rows).sort_values(ALIKE, ignore_index=True)
    caption = (
        "Shares of the bins of LBP (10, 5), and how alike the rows of an image's patches are (mean "
        "correlation). F1 by patch is of a model that learnt from ocean and this image, over "
        f"{len(tested)} labelled frames. No frame is both learnt from and scored."
    )
    histograms = (
        "Mean LBP histogram of the patches of each image, on one scale; a bar that is cut off has "
        "its value beside it. First ocean, then what could be learnt from, the most varied image "
        f"first. {SHOWN}"
    )
    shown = [ocean, *(images[name] for name in table["image"])]
    return Exhibit(
        (
            "Bins are coloured by the share of the circle that is brighter than its centre. None "
            "or all of it is flat, half an edge, a quarter or three quarters a corner, each "
            "within a twelfth. Patterns of several runs, which noise makes, are the last bin.",
            f"Ocean is {ocean.words}. The thesis's other images are not at hand: a photo of bricks "
            "and rendered branches stand for them.",
        ),
        (
            structure_claim(ocean, images[STRUCTURE]),
            spike_claim(ocean, images[BRICK], images[BRANCHES]),
            variety_claim(table),
        ),
        (Table("candidates", caption, table),),
        (Plot("histograms", histograms, png_of(_histograms(shown))),),
    )


def structure_claim(ocean: Image, structure: Image) -> Claim:
    """Whether ocean is mostly flat, and a structure makes it less so, and edges more."""
    water, other = ocean.shares(), structure.shares()
    kinds = BinKind.FLAT, BinKind.EDGE, BinKind.CORNER
    mostly = max(kinds, key=lambda kind: water[kind]) is BinKind.FLAT
    moved = other[BinKind.FLAT] < water[BinKind.FLAT] and other[BinKind.EDGE] > water[BinKind.EDGE]
    return Claim(
        "ocean is mostly flat; with a structure flat falls slightly, and edge rises",
        "figure 3.11",
        f"ocean {_listed(water, kinds)}; with the structure {_listed(other, kinds)}",
        "to agree: flat is ocean's largest, and both move so; in part: one of both",
        agreement=ClaimAgreement.of(mostly and moved, mostly or moved),
    )


def _listed(shares: Mapping[BinKind, float], kinds: Sequence[BinKind]) -> str:
    return ", ".join(f"{kind} {shares[kind]:.1%}" for kind in kinds)


def spike_claim(ocean: Image, brick: Image, branches: Image) -> Claim:
    """Whether branches have more edges than brick, and brick more than ocean."""
    least, middle, most = (image.shares()[BinKind.EDGE] for image in (ocean, brick, branches))
    return Claim(
        "branches have a large edge spike, brick a smaller one, ocean none",
        "figures 3.12 and 3.13",
        f"share of the edge bins: branches {most:.1%}, brick {middle:.1%}, ocean {least:.1%}",
        "to agree: in this order; in part: both above ocean. A photo and a rendering stand for "
        "the thesis's images",
        agreement=ClaimAgreement.of(most > middle > least, most > least and middle > least),
    )


def variety_claim(table: pd.DataFrame) -> Claim:
    """Whether a model learns better from an image whose patches are less alike."""
    claim = Claim.about(
        "varied texture, whose rows are less correlated, is better to learn from",
        "section 3.2.1; a film still was chosen by that",
    )
    f1 = table[F1]
    if f1.isna().any() or f1.nunique() < 2:
        return claim("not scored", "there are no labels to score a model by")
    elsewhere = table[~table["image"].isin([CONTROL, STRUCTURE])]
    ranks = [_rank(images) for images in (table, elsewhere)]
    best = table.loc[f1.idxmax()]
    return claim(
        f"rank correlation of F1 with how alike rows are: {ranks[0]:+.2f} over {len(table)} "
        f"images, {ranks[1]:+.2f} without the mission's own; best {best['image']} ({f1.max():.2f})",
        f"to agree: both {_RANKED} or less; in part: one. The mission's own show water too",
        agreement=ClaimAgreement.of(max(ranks) <= _RANKED, min(ranks) <= _RANKED),
    )


def _rank(images: pd.DataFrame) -> float:
    """Rank correlation of F1 with how alike rows are; 0 where there is nothing to rank."""
    places = images[[ALIKE, F1]].astype(float)
    return 0.0 if (places.nunique() < 2).any() else float(spearmanr(places).statistic)


def _image(name: str, words: str, picture: Any) -> Image:
    pixels = np.ascontiguousarray(picture, np.uint8)
    return Image(name, words, pixels, described(pixels))


def _candidates(context: StudyContext) -> list[Image]:
    """What could stand for "anything else", and as a control an ocean frame that should not.

    The image asked for or the rendered texture; photos that come with scikit-image, rough, bright
    and in focus as a film still is; branches; and the mission's own frame of the structure.
    """
    found = [_image("other", context.other.words, context.other.image)]
    for name in _PHOTOS:
        picture = np.asarray(getattr(data, name)())
        if picture.ndim == 3:
            picture = picture[..., ::-1]  # RGB; frames are BGR
        found.append(_image(name, f"photo of {name}, from scikit-image", picture))
    found.append(_image(BRANCHES, "rendered branches", rendered_branches()))
    number, control = context.structure_frame, _control(context)
    found.append(_image(STRUCTURE, f"frame {number}, whole", context.picture(number)))
    if control is not None:
        words = f"frame {control}: ocean too, so it should not separate"
        found.append(_image(CONTROL, words, context.picture(control)))
    return found


def rendered_branches() -> U8:
    """Dark branches before a bright sky: gray, (540, 720)."""
    rng = np.random.default_rng(_BRANCH_SEED)
    picture = np.full((540, 720), 205, np.uint8)
    for _ in range(_BRANCHES):
        growing = [(rng.uniform(0, [720, 540]), rng.uniform(0, 2 * np.pi), rng.uniform(8, 16))]
        while growing:
            start, angle, width = growing.pop()
            end = start + rng.uniform(30, 80) * np.array([np.cos(angle), np.sin(angle)])
            ends = start.astype(int).tolist(), end.astype(int).tolist()
            cv2.line(picture, *ends, rng.uniform(30, 90), int(width), cv2.LINE_AA)
            if width > 3:
                forks = rng.normal(angle, 0.5, 2)
                growing += [(end, float(fork), 0.7 * width) for fork in forks]
    return picture


def _control(context: StudyContext) -> int | None:
    """Another frame of open ocean, by the labels."""
    other = [number for number in context.ocean_frames if number != context.ocean.frame]
    return other[len(other) // 2] if other else None


def _tested(context: StudyContext) -> Tested:
    """Labelled frames spread over the mission; none that a candidate is made of."""
    left_out = {context.structure_frame, _control(context)}
    labelled = [number for number in context.truths if number not in left_out]
    chosen = evenly_spaced(labelled, _SCORED_FRAMES)
    return {number: described(frame) for number, frame in context.decoded(chosen)}


def _row(context: StudyContext, ocean: Image, image: Image, tested: Tested) -> dict[str, Any]:
    """Figures of an image, and F1 over the tested frames of a model of it and ocean."""
    f1 = None
    if tested:
        model = thesis_classifier(ocean.rows[_KEY], image.rows[_KEY])
        said = {number: model.predict(rows[_KEY]) == 1 for number, rows in tested.items()}
        f1 = pooled_score(said, context.truths).f1
    shares = {str(kind): share for kind, share in image.shares().items()}
    return {"image": image.name, "what": image.words, **shares, ALIKE: image.alike(), F1: f1}


def _histograms(shown: Sequence[Image]) -> Figure:
    """A row an image: the picture, and its mean histogram with the kinds of bins in colour."""
    figure, axes = new_figure(
        10.5, 1.5 * len(shown) + 0.6, len(shown), 3, width_ratios=(1.1, 1.6, 2.6), squeeze=False
    )
    for line, image in zip(axes, shown, strict=True):
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
