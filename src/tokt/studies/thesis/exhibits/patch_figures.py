"""Figures 3.16 and 3.19: what one patch on the structure and one of ocean look like as features."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from sklearn.metrics import roc_auc_score

from tokt.features.common.arrays import F64, U8
from tokt.features.extractors.extractor import HARALICK_NAMES
from tokt.features.frames.grid import Grid
from tokt.studies.baselines.thesis_models import TITLES
from tokt.studies.baselines.thesis_texture import GRID, resized_gray

from .exhibit import NOT_KNOWN, Claim, ClaimAgreement, Exhibit, Plot, StudyContext, Table
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
_WHOLE = Grid(1, 1, None)
_BINS = len(HARALICK_NAMES)
"""The thesis's program sorts the 13 features' *values* into 13 bins from 0 to 13."""

_APART, _DISTANCE_AREA, _MODEL_AREA = (
    "distance between the two patches",
    "ROC area, distance from ocean",
    "ROC area, the thesis's model",
)
_QUOTED = {_APART: "hellinger", _DISTANCE_AREA: "distance_roc_area", _MODEL_AREA: "model_roc_area"}
"""By column, the end of the name of a figure that other pages quote."""

Cells = Mapping[str, int]
"""The two patches: numbers of their cells, by the names of `_DRAWN_CELLS`."""


def patch_histograms(context: StudyContext) -> Exhibit:
    """LBP histograms and Haralick features of two patches of one frame (figures 3.16, 3.19)."""
    number = context.structure_frame
    frame, labels = context.left(number), context.truth(number)
    rows = described(frame)
    patches, how = _choose(labels)
    told = _told_apart(context, rows, patches, labels)
    outside = {
        name: int((rows["haralick"][cell] > _BINS).sum() + (rows["haralick"][cell] < 0).sum())
        for name, cell in patches.items()
    }
    numbers: dict[str, Any] = {"frame": number}
    for column, name in _QUOTED.items():
        numbers |= {f"{key}_{name}": value for key, value in told[column].dropna().items()}
    numbers |= {f"haralick_outside_{name}": count for name, count in outside.items()}
    return Exhibit(
        (
            f"Frame {number}; {how}. The features are the thesis's, of the patch cut out first.",
            "The area under the ROC curve says how well the features tell the two kinds of patch "
            "apart (0.5: not at all, 1: perfectly). It is taken over the frame's labelled patches, "
            "of a patch's distance from the ocean training image's mean, and of the thesis's "
            "model's decision value. Distances are Hellinger's for histograms; for Haralick's "
            "features, that image's standard deviations.",
        ),
        _claims(frame, told, outside),
        _tables(rows["haralick"], patches, told),
        _plots(frame, rows, patches, number),
        numbers,
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


def _away_from_ocean(key: str, rows: F64, water: F64) -> F64:
    """How far each patch is from the ocean image's mean: float64, (n_patches,)."""
    if key in LBP_KEYS:
        return np.asarray(hellinger(rows, water.mean(axis=0)[None])[:, 0])
    spread = water.std(axis=0)
    varies = spread > 0
    apart = (rows - water.mean(axis=0))[:, varies] / spread[varies]
    return np.asarray(np.sqrt(np.square(apart).mean(axis=1)))


def _told_apart(
    context: StudyContext, rows: dict[str, F64], patches: Cells, labels: NDArray[np.int8]
) -> pd.DataFrame:
    """How far apart the two patches are, and all labelled ones; index: the extractor's key."""
    water = described(context.ocean.image)
    told = {}
    for key in EXTRACTORS:
        away = _away_from_ocean(key, rows[key], water[key])
        model = context.thesis[key].classifier
        two = [rows[key][[cell]] for cell in patches.values()]
        told[key] = {
            "features": TITLES[key],
            _APART: float(hellinger(*two)[0, 0]) if key in LBP_KEYS else None,
            "structure patch from ocean's mean": away[patches["structure"]],
            "ocean patch from ocean's mean": away[patches["ocean"]],
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


def _claims(frame: U8, told: pd.DataFrame, outside: Mapping[str, int]) -> tuple[Claim, ...]:
    seen = f"the two are {told[_APART].iloc[0]:.2f} apart (Hellinger, LBP (10, 5))"
    area = told.dropna(subset=_MODEL_AREA)
    if len(area):
        pairs = zip(area["features"], area[_MODEL_AREA], strict=True)
        measured = ", ".join(f"{title} {value:.2f}" for title, value in pairs)
        seen += f"; area under the ROC curve of the models over the frame: {measured}"
    drawn = _drawn_and_sliced(frame)
    moved = "; ".join(f"{name}: {value:.2f}" for name, value in drawn.items())
    return (
        Claim(
            "a patch on the structure has another histogram than one of ocean",
            NOT_KNOWN,
            seen,
            "The figures' bars are not at hand; measured over all labelled patches of the frame."
            if len(area)
            else "The figures' bars are not at hand, and this frame has no labels of both kinds.",
        ),
        Claim(
            "the histogram drawn is of the patch that is framed in the picture",
            "figures 3.16 and 3.19 frame a patch and plot a histogram (the published notebooks)",
            "the notebooks slice rows by the patch's width and columns by its height: another "
            f"place. Hellinger distance of the two, LBP (10, 5): {moved}",
            "Read from the published notebooks; here the framed patch is the one described.",
            agreement=ClaimAgreement.NO,
        ),
        Claim(
            "the Haralick figure shows the 13 features",
            "a histogram of 13 bins (the published notebooks)",
            f"it sorts the features' values into bins from 0 to {_BINS}. Outside are "
            f"{outside['structure']} of {_BINS} features on the structure, {outside['ocean']} "
            "on ocean",
            "Read from the published notebooks; the features themselves are drawn here as well.",
            agreement=ClaimAgreement.NO,
        ),
    )


def _drawn_and_sliced(frame: U8) -> dict[str, float]:
    """How far the histogram of a framed patch is from that of the place the notebooks slice."""
    gray, key = resized_gray(frame), LBP_KEYS[0]
    patch_height, patch_width = GRID.patch_size(*gray.shape)
    rows = described(frame)[key]
    found = {}
    for name, (row, col) in _DRAWN_CELLS.items():
        top, left = col * patch_width, row * patch_height
        sliced = gray[top : top + patch_width, left : left + patch_height]
        if sliced.shape != (patch_width, patch_height):
            continue  # the frame is flatter than the mission's: the slice leaves it
        other = EXTRACTORS[key].describe(np.ascontiguousarray(sliced), _WHOLE)
        framed = rows[[row * GRID.cols + col]]
        found[f"the {name}'s cell ({row}, {col})"] = float(hellinger(framed, other)[0, 0])
    return found


def _tables(haralick: F64, patches: Cells, told: pd.DataFrame) -> tuple[Table, ...]:
    two = {name: haralick[cell] for name, cell in patches.items()}
    inside = sum(((row >= 0) & (row <= _BINS)).astype(int) for row in two.values())
    features = pd.DataFrame(
        {"feature": HARALICK_NAMES, **two, "in the notebooks' histogram": inside}
    )
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
            "contrast and variances. Last: for how many of the two the value lies in the 0 to "
            f"{_BINS} that the notebooks' histogram shows.",
            features,
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
            f"Frame {number}, left: the size of Haralick's 13 features of the two patches, "
            "logarithmic. Right: the same values as the notebooks plot them, a histogram in which "
            f"what is larger than {_BINS} is lost (figure 3.19).",
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
    figure, (features, values) = new_figure(10.5, 4.2, 1, 2, width_ratios=(1.5, 1))
    place = np.arange(_BINS)
    for shift, (name, cell) in zip((-0.2, 0.2), patches.items(), strict=True):
        features.barh(place + shift, np.abs(rows[cell]), 0.4, color=_COLORS[name], label=name)
    features.set_yticks(place, [name.replace("_", " ") for name in HARALICK_NAMES], fontsize=8)
    features.invert_yaxis()
    features.set_xscale("log")
    features.set_xlabel("absolute value (unscaled, as the thesis feeds it to the classifier)")
    features.legend(fontsize=8)
    features.axvline(_BINS, color="0.4", lw=0.8, ls=":")
    shown = [rows[cell] for cell in patches.values()]
    values.hist(shown, bins=_BINS, range=(0, _BINS), color=[_COLORS[name] for name in patches])
    values.set(xlabel="value of a feature", ylabel="features", title="as the notebooks plot it")
    features.set_title("the 13 features")
    return figure
