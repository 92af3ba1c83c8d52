"""Figures 3.15 to 3.19: what a patch on the structure and one of ocean look like as features."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from sklearn.metrics import roc_auc_score

from tokt.features.common.arrays import F64, U8
from tokt.features.extractors.extractor import HARALICK_NAMES
from tokt.studies.baselines.thesis_models import TITLES
from tokt.studies.baselines.thesis_texture import GRID

from .exhibit import Claim, ClaimAgreement, Exhibit, Plot, StudyContext, Table
from .frame_drawing import (
    OCEAN_COLOR,
    OTHER_COLOR,
    SHOWN,
    draw_grid,
    new_figure,
    png_of,
    show_frame,
)
from .training_image_figures import (
    EXTRACTORS,
    LBP_KEYS,
    described,
    draw_histogram,
    hellinger,
    kind_legend,
)

_DRAWN_CELLS = {"structure": (5, 5), "ocean": (3, 3)}
"""Row and column of the two patches that the thesis's program draws, red and blue."""
_COLORS = {"structure": OTHER_COLOR, "ocean": OCEAN_COLOR}
_LIKER, _DISTANCE_AREA, _MODEL_AREA = (
    "clear patches more like the ocean patch than the structure's is",
    "ROC area, distance from ocean",
    "ROC area, the thesis's model",
)
_DIFFERS = 0.95
"""Part of the clear patches that must be more like the ocean patch than the structure's is."""

Cells = Mapping[str, int]
"""The two patches: numbers of their cells, by the names of `_DRAWN_CELLS`."""


def patch_histograms(context: StudyContext) -> Exhibit:
    """LBP histograms and Haralick features of two patches of one frame (figures 3.15 to 3.19)."""
    number = context.structure_frame
    frame, labels = context.left(number), context.truth(number)
    rows = described(frame)
    patches, how = _choose(labels)
    told = _told_apart(context, rows, patches, labels)
    return Exhibit(
        (
            f"Frame {number}; {how}. The features are the thesis's, of the patch cut out first.",
            "The area under the ROC curve says how well the features tell the two kinds of patch "
            "apart (0.5: not at all, 1: perfectly). It is taken over the frame's labelled patches, "
            "of a patch's distance from the ocean training image's mean, and of the thesis's "
            "model's decision value. Distances are Hellinger's for histograms; for Haralick's "
            "features, that image's standard deviations.",
        ),
        (histogram_claim(told),),
        _tables(rows["haralick"], patches, told),
        _plots(frame, rows, patches, number),
        {"frame": number}
        | {f"{key}_model_roc_area": area for key, area in told[_MODEL_AREA].dropna().items()},
    )


def _choose(labels: NDArray[np.int8]) -> tuple[Cells, str]:
    """A patch amid the structure and one of ocean far from it, and how they were chosen.

    Without labels they are the thesis's two.
    """
    there, clear = np.flatnonzero(labels == 1), np.flatnonzero(labels == 0)
    if not len(there) or not len(clear):
        cells = {name: row * GRID.cols + col for name, (row, col) in _DRAWN_CELLS.items()}
        words = "no labels of both kinds, so the patches are those that the thesis's program draws"
        return cells, words
    row, col = np.divmod(np.arange(GRID.n_patches), GRID.cols)
    middle = np.hypot(row[there] - row[there].mean(), col[there] - col[there].mean()).argmin()
    gap = np.hypot(
        row[clear][:, None] - row[there][None], col[clear][:, None] - col[there][None]
    ).min(axis=1)  # fmt: skip
    # The border's patches have the lens's dark corner in them.
    inner = (row[clear] % (GRID.rows - 1) > 0) & (col[clear] % (GRID.cols - 1) > 0)
    farthest = np.where(inner, gap, gap - GRID.rows).argmax()
    words = "labelled patches: one amid the structure, and the clear one farthest from all of it"
    return {"structure": int(there[middle]), "ocean": int(clear[farthest])}, words


def _away(key: str, rows: F64, place: F64, spread: F64) -> F64:
    """How far each patch is from a place in the features: float64, (n_patches,)."""
    if key in LBP_KEYS:
        return np.asarray(hellinger(rows, place[None])[:, 0])
    varies = spread > 0
    apart = (rows - place)[:, varies] / spread[varies]
    return np.asarray(np.sqrt(np.square(apart).mean(axis=1)))


def _share(such: NDArray[np.bool_]) -> float | None:
    return float(such.mean()) if len(such) else None


def _told_apart(
    context: StudyContext, rows: dict[str, F64], patches: Cells, labels: NDArray[np.int8]
) -> pd.DataFrame:
    """How far apart the two patches are, and all labelled ones; index: the extractor's key."""
    water, clear = described(context.ocean.image), labels == 0
    told = {}
    for key in EXTRACTORS:
        away = _away(key, rows[key], water[key].mean(axis=0), water[key].std(axis=0))
        differs = _away(key, rows[key], rows[key][patches["ocean"]], water[key].std(axis=0))
        model = context.thesis[key].classifier
        told[key] = {
            "features": TITLES[key],
            "structure patch from ocean's mean": away[patches["structure"]],
            "ocean patch from ocean's mean": away[patches["ocean"]],
            _LIKER: _share(differs[clear] < differs[patches["structure"]]),
            _DISTANCE_AREA: _roc_area(away, labels),
            _MODEL_AREA: _roc_area(model.decision_function(rows[key]), labels),
        }
    return pd.DataFrame.from_dict(told, orient="index")


def _roc_area(values: F64, labels: NDArray[np.int8]) -> float | None:
    """None where the frame has no labels of both kinds."""
    sure = labels >= 0
    if len(np.unique(labels[sure])) < 2:
        return None
    return float(roc_auc_score(labels[sure], values[sure]))


def histogram_claim(told: pd.DataFrame) -> Claim:
    """Whether the structure's patch looks unlike ocean's patches, by each of the features."""
    what = "a patch on the structure has another histogram than one of ocean"
    printed = "figures 3.15 to 3.19"
    liker = told.dropna(subset=_LIKER).set_index("features")[_LIKER]
    if liker.empty:
        return Claim(what, printed, "not measured", "the frame has no patch labelled as clear")
    differs = liker >= _DIFFERS
    agreement = ClaimAgreement.PARTLY if differs.any() else ClaimAgreement.NO
    return Claim(
        what,
        printed,
        "clear patches that are more like the ocean patch than it is: "
        + ", ".join(f"{title} {share:.0%}" for title, share in liker.items()),
        f"agrees where {_DIFFERS:.0%} are by each of the features, in part where by some",
        agreement=ClaimAgreement.YES if differs.all() else agreement,
    )


def _tables(haralick: F64, patches: Cells, told: pd.DataFrame) -> tuple[Table, ...]:
    two = {name: haralick[cell] for name, cell in patches.items()}
    return (
        Table(
            "apart",
            "The two patches, and all labelled patches of the frame: distances are Hellinger's "
            "for LBP and standard deviations of the ocean image for Haralick. Nothing is learnt "
            "from this frame.",
            told,
            "How far apart they are",
        ),
        Table(
            "haralick-features",
            "Haralick's features of the two patches. Their units differ: grey levels squared for "
            "contrast and variances.",
            pd.DataFrame({"feature": HARALICK_NAMES, **two}),
        ),
    )


def _plots(frame: U8, rows: dict[str, F64], patches: Cells, number: int) -> tuple[Plot, ...]:
    return (
        Plot(
            "lbp-patches",
            f"Frame {number} with the two patches, and their LBP histograms (figure 3.16); a bar "
            f"that is cut off has its value beside it. {SHOWN}",
            png_of(_lbp_figure(frame, rows, patches)),
        ),
        Plot(
            "haralick-patches",
            f"Frame {number}: the size of Haralick's 13 features of the two patches, logarithmic "
            "(figure 3.19).",
            png_of(_haralick_figure(rows["haralick"], patches)),
        ),
    )


def _lbp_figure(frame: U8, rows: dict[str, F64], patches: Cells) -> Figure:
    figure = Figure(figsize=(10.5, 4.4), layout="constrained")
    axes = figure.subplot_mosaic(
        [["frame", "structure lbp_10_5", "structure lbp_24_8"],
         ["frame", "ocean lbp_10_5", "ocean lbp_24_8"]],
        width_ratios=(1.5, 1, 1.7),
    )  # fmt: skip
    height, width = show_frame(axes["frame"], frame)
    draw_grid(axes["frame"], height, width)
    boxes = GRID.boxes(height, width)
    for name, cell in patches.items():
        y0, y1, x0, x1 = boxes[cell]
        axes["frame"].add_patch(
            Rectangle((x0, y0), x1 - x0 - 1, y1 - y0 - 1, fill=False, ec=_COLORS[name], lw=2.2)
        )
    for key in LBP_KEYS:
        shown = {name: rows[key][cell] for name, cell in patches.items()}
        top = 1.15 * max(float(one[:-1].max()) for one in shown.values())
        for name, histogram in shown.items():
            place = axes[f"{name} {key}"]
            draw_histogram(place, histogram, top)
            place.set_title(f"{TITLES[key]}, {name}", fontsize=9, color=_COLORS[name])
    kind_legend(figure)
    return figure


def _haralick_figure(rows: F64, patches: Cells) -> Figure:
    figure, features = new_figure(7.0, 4.2)
    place = np.arange(len(HARALICK_NAMES))
    for shift, (name, cell) in zip((-0.2, 0.2), patches.items(), strict=True):
        features.barh(place + shift, np.abs(rows[cell]), 0.4, color=_COLORS[name], label=name)
    features.set_yticks(place, [name.replace("_", " ") for name in HARALICK_NAMES], fontsize=8)
    features.invert_yaxis()
    features.set_xscale("log")
    features.set_xlabel("absolute value (unscaled, as the thesis feeds it to the classifier)")
    features.legend(fontsize=8)
    return figure
