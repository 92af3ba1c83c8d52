"""Figures 3.15 to 3.19: what a patch on the structure and one of ocean look like as features."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from tokt.features.common.arrays import F64, U8, Bools
from tokt.features.extractors.extractor import HARALICK_NAMES
from tokt_studies.baselines.thesis_models import TITLES
from tokt_studies.baselines.thesis_texture import GRID

from . import frame_drawing as drawing
from .exhibit import Claim, ClaimAgreement, Exhibit, Plot, StudyContext
from .training_image_figures import LBP_KEYS, described, draw_histogram, kind_legend

_DRAWN_CELLS = {"structure": (5, 5), "ocean": (3, 3)}
"""Row and column of the two patches that the thesis's program draws, red and blue."""
_COLORS = {"structure": drawing.OTHER_COLOR, "ocean": drawing.OCEAN_COLOR}
_DIFFERS = 0.95
"""Part of the clear patches that must be more like the ocean patch than the structure's is."""

Cells = Mapping[str, int]
"""The two patches: numbers of their cells, by the names of `_DRAWN_CELLS`."""


def patch_histograms(context: StudyContext) -> Exhibit:
    """LBP histograms and Haralick features of two patches of one frame (figures 3.15 to 3.19)."""
    number = context.structure_frame
    frame, labels = context.picture(number), context.truth(number)
    rows = described(frame)
    patches, how = _choose(labels)
    lbp = (
        f"Frame {number} with the two patches, and their LBP histograms (figure 3.16); a bar that "
        f"is cut off has its value beside it. {drawing.SHOWN}"
    )
    haralick = (
        f"Frame {number}: the size of Haralick's 13 features of the two patches, logarithmic "
        "(figure 3.19)."
    )
    return Exhibit(
        words=(
            f"Frame {number}; {how}. The features are the thesis's, of the patch cut out first.",
        ),
        claims=(histogram_claim(rows, patches, labels == 0),),
        plots=(
            Plot("lbp-patches", lbp, drawing.png_of(_lbp_figure(frame, rows, patches))),
            Plot(
                "haralick-patches",
                haralick,
                drawing.png_of(_haralick_figure(rows["haralick"], patches)),
            ),
        ),
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


def histogram_claim(rows: Mapping[str, F64], patches: Cells, clear: Bools) -> Claim:
    """Whether the structure's patch is less like the ocean patch than the clear patches are.

    By Hellinger's distance of LBP histograms, and by Haralick's features in standard deviations of
    the clear patches.
    """
    claim = Claim.about(
        "a patch on the structure has another histogram than one of ocean", "figures 3.15 to 3.19"
    )
    if not clear.any():
        return claim("not measured", "the frame has no patch labelled as clear")
    liker = {}
    for key, features in rows.items():
        ocean = features[patches["ocean"]]
        spread = np.maximum(features[clear].std(axis=0), 1e-12)
        scaled = np.sqrt(features) if key in LBP_KEYS else features / spread
        place = np.sqrt(ocean) if key in LBP_KEYS else ocean / spread
        away = np.linalg.norm(scaled - place, axis=1)
        liker[TITLES[key]] = float((away[clear] < away[patches["structure"]]).mean())
    differs = [share >= _DIFFERS for share in liker.values()]
    return claim(
        "clear patches that are more like the ocean patch than it is: "
        + ", ".join(f"{title} {share:.0%}" for title, share in liker.items()),
        f"to agree: {_DIFFERS:.0%} by each; in part: by some",
        agreement=ClaimAgreement.of(all(differs), any(differs)),
    )


def _lbp_figure(frame: U8, rows: dict[str, F64], patches: Cells) -> Figure:
    figure = Figure(figsize=(10.5, 4.4), layout="constrained")
    axes = figure.subplot_mosaic(
        [["frame", "structure lbp_10_5", "structure lbp_24_8"],
         ["frame", "ocean lbp_10_5", "ocean lbp_24_8"]],
        width_ratios=(1.5, 1, 1.7),
    )  # fmt: skip
    height, width = drawing.show_frame(axes["frame"], frame)
    drawing.draw_grid(axes["frame"], height, width)
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
    figure, features = drawing.new_figure(7.0, 4.2)
    place = np.arange(len(HARALICK_NAMES))
    for shift, (name, cell) in zip((-0.2, 0.2), patches.items(), strict=True):
        features.barh(place + shift, np.abs(rows[cell]), 0.4, color=_COLORS[name], label=name)
    features.set_yticks(place, [name.replace("_", " ") for name in HARALICK_NAMES], fontsize=8)
    features.invert_yaxis()
    features.set_xscale("log")
    features.set_xlabel("absolute value (unscaled, as the thesis feeds it to the classifier)")
    features.legend(fontsize=8)
    return figure
