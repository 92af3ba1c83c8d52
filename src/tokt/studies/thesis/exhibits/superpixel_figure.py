"""Figure 5.1: SLIC superpixels against the grid."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray
from skimage.segmentation import find_boundaries

from tokt.studies.baselines.slic import SlicTexture
from tokt.studies.baselines.superpixels import resized_bgr, superpixels
from tokt.studies.baselines.thesis_models import TITLES, ThesisModel
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.context import StudyContext
from tokt.studies.thesis.exhibit import Claim, ClaimAgreement, Exhibit, Plot, Table
from tokt.studies.thesis.frame_drawing import SHOWN, draw_grid, png_of, show_frame, show_mask
from tokt.studies.thesis.methods.patch_scores import (
    PatchScore,
    patches_of_mask,
    score_patches,
    truth_by_labels,
)

from .runtime_tables import agreement_of

Image = NDArray[np.uint8]
Segments = NDArray[np.int64]

KEY = "figure-5.1"
TITLE = "SLIC superpixels against the grid"
SECTION = "figure 5.1"
FEATURES = ("lbp_10_5", "haralick")
THESIS_RATIO = 20.0
"""By how much the thesis says that SLIC is slower."""
_NOTHING = PatchScore(0, 0, 0, 0)
_COLUMNS = {
    "segments_median": "superpixels",
    "slic_ms": "SLIC ms",
    "grid_ms": "grid ms",
    "slic_over_grid": "SLIC, times the grid",
    "pixels_same": "pixels alike",
    "same_status": "same status",
    "slic_f1": "SLIC F1",
    "grid_f1": "grid F1",
}


@dataclass(frozen=True)
class SuperpixelComparison:
    """One frame judged by superpixels and by the grid, with the same features.

    Parameters
    ----------
    frame : int
    features : str
    slic_mask, grid_mask : array of uint8, shape (271, 360)
        0 or 255.
    slic_s, grid_s : float
        Seconds from the decoded frame to the verdict.
    segments : int
        Superpixels of the frame.
    slic_score, grid_score : PatchScore
        Against the frame's labels; zeros where there are none.
    """

    frame: int
    features: str
    slic_mask: Image
    grid_mask: Image
    slic_s: float
    grid_s: float
    segments: int
    slic_score: PatchScore
    grid_score: PatchScore

    @property
    def same(self) -> float:
        """Part of the pixels on which the two masks agree."""
        return float((self.slic_mask == self.grid_mask).mean())

    @property
    def overlap(self) -> tuple[int, int]:
        """Pixels that both have white, and that either has."""
        slic, grid = self.slic_mask > 0, self.grid_mask > 0
        return int((slic & grid).sum()), int((slic | grid).sum())

    @property
    def statuses(self) -> tuple[bool, bool]:
        """Whether superpixels and grid say obstacle: one white patch is far above the threshold."""
        return bool(self.slic_mask.any()), bool(self.grid_mask.any())


def superpixel_figure(context: StudyContext) -> Exhibit:
    """The exhibit of figure 5.1, on the request's sample of frames."""
    shown = context.structure_frame
    numbers = sorted({*context.spread(), shown})
    ocean, other = context.ocean, context.other
    found: list[SuperpixelComparison] = []
    segments = {number: _superpixels(left) for number, left in context.decoded(numbers)}
    for name in FEATURES:
        model = context.thesis[name]
        slic = SlicTexture.train(ocean.image, other.image, model.describe, name)
        found += [_compared(context, number, slic, model, segments[number]) for number in segments]
    summaries = {
        name: _summary([one for one in found if one.features == name]) for name in FEATURES
    }
    return Exhibit(
        KEY,
        TITLE,
        SECTION,
        words=_words(context, numbers),
        claims=(_time_claim(summaries), _mask_claim(summaries)),
        tables=(_summary_table(summaries), _frame_table(found)),
        plots=(_plot(context, [one for one in found if one.frame == shown], segments[shown]),),
        numbers={
            f"{name}_{key}": value
            for name, summary in summaries.items()
            for key, value in summary.items()
            if value is not None
        },
    )


def _compared(
    context: StudyContext, number: int, slic: SlicTexture, model: ThesisModel, segments: Segments
) -> SuperpixelComparison:
    left = context.left(number)
    by_slic, slic_s = _timed(lambda: slic.judge(left, None, 0.0).mask)
    by_grid, grid_s = _timed(lambda: model.judge(left).obstacle)
    size = GRID.resized(*left.shape[:2])
    if by_slic is None:
        by_slic = np.zeros(size, np.uint8)
    truth = truth_by_labels(context.truth(number))
    scores = [
        _NOTHING if truth is None else score_patches(said, truth)
        for said in (patches_of_mask(by_slic, GRID), by_grid)
    ]
    return SuperpixelComparison(
        number,
        model.name,
        by_slic,
        GRID.paint(by_grid, *size),
        slic_s,
        grid_s,
        len(np.unique(segments)),
        *scores,
    )


def _superpixels(left: Image) -> Segments:
    return superpixels(resized_bgr(left))


def _timed(judge: Callable[[], Any]) -> tuple[Any, float]:
    """What a call gives, and the seconds that it takes."""
    began = time.perf_counter()
    found = judge()
    return found, time.perf_counter() - began


def _summary(found: Sequence[SuperpixelComparison]) -> dict[str, Any]:
    """Figures over all frames of one kind of features."""
    both, either = np.sum([one.overlap for one in found], axis=0)
    slic, grid = _NOTHING, _NOTHING
    for one in found:
        slic, grid = slic + one.slic_score, grid + one.grid_score
    slic_s, grid_s = (
        float(np.median([getattr(one, name) for one in found])) for name in ("slic_s", "grid_s")
    )
    return {
        "frames": len(found),
        "segments_median": float(np.median([one.segments for one in found])),
        "slic_ms": 1000 * slic_s,
        "grid_ms": 1000 * grid_s,
        "slic_over_grid": slic_s / grid_s,
        "pixels_same": float(np.mean([one.same for one in found])),
        "overlap": int(both) / int(either) if either else None,
        "same_status": sum(one.statuses[0] == one.statuses[1] for one in found),
        "slic_f1": slic.f1,
        "grid_f1": grid.f1,
    }


def _time_claim(summaries: dict[str, dict[str, Any]]) -> Claim:
    ratios = {name: summary["slic_over_grid"] for name, summary in summaries.items()}
    ratio = ratios[FEATURES[0]]
    agreement = agreement_of(ratio, THESIS_RATIO)
    if agreement is ClaimAgreement.YES:
        why = "within a quarter of the printed ratio"
    elif ratio > 1:
        why = (
            "slower it is, but by another factor, which hangs on how fast the libraries of the day "
            "are at either; the thesis's machine and its releases are not known here"
        )
    else:
        why = "on this machine it is not slower at all"
    found = ", ".join(f"{TITLES[name]} {value:.1f} times" for name, value in ratios.items())
    return Claim(
        "superpixels take so many times as long as a grid",
        f"SLIC + LBP is about {THESIS_RATIO:.0f} times as slow",
        f"medians of the same frames, decoded before: {found}",
        agreement,
        why,
    )


def _mask_claim(summaries: dict[str, dict[str, Any]]) -> Claim:
    said = [
        f"{TITLES[name]}: {100 * one['pixels_same']:.1f} % of the pixels alike, "
        + ("neither has a white one" if one["overlap"] is None
           else f"{100 * one['overlap']:.0f} % of what either has white is white in both")
        + f", the same status in {one['same_status']} of {one['frames']} frames"
        for name, one in summaries.items()
    ]  # fmt: skip
    return Claim(
        "superpixels and a grid see the same",
        "a superpixel follows outlines, a patch does not; how alike their masks are is not known",
        "; ".join(said),
        ClaimAgreement.UNCOMPARABLE,
        "the figure's picture and numbers are not at hand; the masks of both are drawn and counted",
    )


def _words(context: StudyContext, numbers: Sequence[int]) -> tuple[str, ...]:
    return (
        f"Both learn from the same two images ({context.ocean.words}; {context.other.words}), "
        "describe with the same features and use the same classifier; one takes a rectangle "
        "around each superpixel, the other a patch of a 10x10 grid.",
        f"On a sample of {len(numbers)} frames, spread over the mission, with frame "
        f"{context.structure_frame} among them, because SLIC is slow. No frame of the sample was "
        "learnt from. Scored against labels by patches: of a superpixel mask those that are white "
        "to a tenth or more, as for labels.",
    )


def _rounded(value: Any) -> Any:
    return round(value, 3) if isinstance(value, float) else value


def _summary_table(summaries: dict[str, dict[str, Any]]) -> Table:
    rows = [
        {
            "features": TITLES[name],
            **{_COLUMNS.get(key, key): _rounded(value) for key, value in summary.items()},
        }
        for name, summary in summaries.items()
    ]
    caption = (
        "Medians over the sample, ms from a decoded frame to its verdict; pixels alike: mean part "
        "of them; overlap: white in both over white in either, over all frames; F1: "
        "over all sure patches of the sample (empty without labels)."
    )
    return Table("slic_against_grid", caption, pd.DataFrame(rows), TITLE)


def _frame_table(found: Sequence[SuperpixelComparison]) -> Table:
    rows = [
        {
            "frame": one.frame,
            "features": TITLES[one.features],
            "superpixels": one.segments,
            "SLIC ms": round(1000 * one.slic_s, 1),
            "grid ms": round(1000 * one.grid_s, 1),
            "SLIC mean value": round(float(one.slic_mask.mean()), 3),
            "grid mean value": round(float(one.grid_mask.mean()), 3),
            "pixels alike %": round(100 * one.same, 2),
        }
        for one in found
    ]
    title = f"{TITLE}, frame by frame"
    return Table("slic_against_grid_frames", "The sample.", pd.DataFrame(rows), title)


def _plot(context: StudyContext, shown: Sequence[SuperpixelComparison], segments: Segments) -> Plot:
    number = shown[0].frame
    left = context.left(number)
    figure = Figure(figsize=(10.5, 5.9), layout="constrained")
    axes = figure.subplots(2, 1 + len(shown))
    height, width = show_frame(axes[0, 0], left, GRID)
    _draw_outlines(axes[0, 0], segments, height, width)
    axes[0, 0].set_title(f"frame {number}: {shown[0].segments} superpixels", fontsize=10)
    show_frame(axes[1, 0], left, GRID)
    draw_grid(axes[1, 0], GRID, height, width)
    axes[1, 0].set_title(f"{GRID.n_patches} patches", fontsize=10)
    for column, one in enumerate(shown, 1):
        for row, (mask, took, what) in enumerate(
            ((one.slic_mask, one.slic_s, "SLIC"), (one.grid_mask, one.grid_s, "grid"))
        ):
            show_mask(axes[row, column], mask)
            title = f"{what}, {TITLES[one.features]}: {1000 * took:.0f} ms"
            axes[row, column].set_title(title, fontsize=10)
    return Plot(
        "slic_against_grid",
        f"Frame {number} cut into superpixels and into patches, and what is not ocean in each "
        f"(white). {SHOWN}",
        png_of(figure),
    )


def _draw_outlines(axes: Any, segments: Segments, height: int, width: int) -> None:
    """The superpixels' borders, drawn at twice the grid's width."""
    large = cv2.resize(
        segments.astype(np.int32), (2 * width, 2 * height), interpolation=cv2.INTER_NEAREST
    )
    borders = find_boundaries(large, mode="inner")
    picture = np.zeros((*borders.shape, 4))
    picture[borders] = (1.0, 0.85, 0.2, 0.9)
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    axes.imshow(picture, extent=extent, interpolation="nearest")
