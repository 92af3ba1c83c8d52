"""Figure 5.1: SLIC superpixels against the grid."""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import pandas as pd
from skimage.segmentation import find_boundaries

from tokt.features.common.arrays import I64, U8
from tokt.studies.baselines.slic import SlicTexture, resized_bgr, superpixels
from tokt.studies.baselines.thesis_models import TITLES, ThesisModel
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.methods.mission_models import SLIC
from tokt.studies.thesis.patch_scores import Truth, patches_of_mask, pooled_score

from .exhibit import Claim, ClaimAgreement, Exhibit, Plot, StudyContext, Table
from .frame_drawing import SHOWN, draw_grid, new_figure, png_of, show_frame, show_mask

TITLE = "SLIC superpixels against the grid"
NO_BETTER, SIMILAR = 0.02, 0.5
"""F1 that SLIC may be ahead and still see no better; white in both, of that in either, from which
two masks are very similar."""


def superpixel_figure(context: StudyContext) -> Exhibit:
    """The exhibit of figure 5.1, on the request's sample of frames."""
    shown = context.structure_frame
    numbers = sorted({*context.spread(), shown})
    frames = {shown: context.picture(shown)} | dict(context.decoded(numbers))
    rows: list[dict[str, Any]] = []
    for name, slic in zip(SLIC, context.superpixel_methods.textures, strict=True):
        model = context.thesis[name]
        rows += [_compared(number, left, slic, model) for number, left in frames.items()]
    compared = pd.DataFrame(rows)
    by_features = compared.groupby("features", sort=False)
    summaries = {name: _summary(one, context.labelled) for name, one in by_features}
    return Exhibit(
        words=_words(context, numbers),
        claims=(mask_claim(summaries[SLIC[0]]),),
        tables=(_summary_table(summaries),),
        plots=(_plot(shown, frames[shown], compared[compared.frame == shown]),),
    )


def _compared(number: int, left: U8, slic: SlicTexture, model: ThesisModel) -> dict[str, Any]:
    """One frame by superpixels and by the grid."""
    slic_mask, by_grid = slic.mask(left), model.judge(left).obstacle
    grid_mask = GRID.paint(by_grid, *GRID.resized(*left.shape[:2]))
    return {
        "frame": number,
        "features": model.name,
        "slic_mask": slic_mask,
        "grid_mask": grid_mask,
        "slic_said": patches_of_mask(slic_mask),
        "grid_said": by_grid,
        "both": int(((slic_mask > 0) & (grid_mask > 0)).sum()),
        "either": int(((slic_mask > 0) | (grid_mask > 0)).sum()),
        "slic_area": int((slic_mask > 0).sum()),
        "grid_area": int((grid_mask > 0).sum()),
        "slic_contours": _contours(slic_mask),
        "grid_contours": _contours(grid_mask),
    }


def _contours(mask: U8) -> int:
    """How many outer contours a mask has."""
    return len(cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0])


def _summary(frames: pd.DataFrame, labelled: Mapping[int, Truth]) -> dict[str, Any]:
    """Figures over all frames of one kind of features."""
    either = int(frames.either.sum())
    by_slic, by_grid = (
        pooled_score(dict(zip(frames.frame, said, strict=True)), labelled)
        for said in (frames.slic_said, frames.grid_said)
    )
    return {
        "frames": len(frames),
        "overlap": int(frames.both.sum()) / either if either else None,
        "area_ratio": float(frames.grid_area.sum() / max(frames.slic_area.sum(), 1)),
        "slic_contours": int(frames.slic_contours.sum()),
        "grid_contours": int(frames.grid_contours.sum()),
        "slic_f1": by_slic.f1,
        "grid_f1": by_grid.f1,
    }


def mask_claim(summary: Mapping[str, Any]) -> Claim:
    """Section 5.1.1, of SLIC + LBP and LBP on the grid."""
    claim = Claim.about(
        "SLIC sees no better; the grid's area is larger, its blocks join to fewer contours",
        "figure 5.1, section 5.1.1",
    )
    overlap, slic, grid = summary["overlap"], summary["slic_f1"], summary["grid_f1"]
    if overlap is None or slic is None or grid is None:
        return claim("not measured", "it needs labels, and masks with white in them")
    larger, fewer = summary["area_ratio"] > 1, summary["grid_contours"] < summary["slic_contours"]
    true = [larger, fewer, grid >= slic - NO_BETTER, overlap >= SIMILAR]
    return claim(
        f"LBP: {summary['area_ratio']:.2f} times SLIC's area, {summary['grid_contours']} contours "
        f"to {summary['slic_contours']}, F1 {grid:.2f} to {slic:.2f}; {100 * overlap:.0f} % of "
        "the white in both",
        f"to agree: a larger area, fewer contours, F1 at most {NO_BETTER:g} lower, "
        f"{100 * SIMILAR:.0f} % in both; in part: one of these",
        agreement=ClaimAgreement.of(all(true), any(true)),
    )


def _words(context: StudyContext, numbers: Sequence[int]) -> tuple[str, ...]:
    return (
        "Both have the same two training images, features and classifier. One takes a rectangle "
        "around each superpixel, the other a patch of a 10x10 grid.",
        f"On a sample of {len(numbers)} frames, as SLIC is slow; frame {context.structure_frame} "
        "is among them, and none was learnt from. Scored by patches: of a superpixel mask those "
        "with a tenth or more white.",
    )


def _summary_table(summaries: dict[str, dict[str, Any]]) -> Table:
    rows = [{"features": TITLES[name], **summary} for name, summary in summaries.items()]
    caption = (
        "Over all frames of the sample. Overlap: white in both over white in either. F1: over all "
        "sure patches (empty without labels)."
    )
    return Table("slic_against_grid", caption, pd.DataFrame(rows).round(3), TITLE)


def _plot(number: int, left: U8, shown: pd.DataFrame) -> Plot:
    segments = superpixels(resized_bgr(left))
    figure, axes = new_figure(10.5, 5.9, 2, 1 + len(shown))
    height, width = show_frame(axes[0, 0], left)
    _draw_outlines(axes[0, 0], segments, height, width)
    count = len(np.unique(segments))
    axes[0, 0].set_title(f"frame {number}: {count} superpixels", fontsize=10)
    show_frame(axes[1, 0], left)
    draw_grid(axes[1, 0], height, width)
    axes[1, 0].set_title(f"{GRID.n_patches} patches", fontsize=10)
    for column, one in zip(axes.T[1:], shown.itertuples(), strict=True):
        methods = ("SLIC", one.slic_mask), ("grid", one.grid_mask)
        for panel, (what, mask) in zip(column, methods, strict=True):
            show_mask(panel, mask)
            panel.set_title(f"{what}, {TITLES[one.features]}", fontsize=10)
    return Plot(
        "slic_against_grid",
        f"Frame {number} cut into superpixels and into patches, and what is not ocean in each "
        f"(white). {SHOWN}",
        png_of(figure),
    )


def _draw_outlines(axes: Any, segments: I64, height: int, width: int) -> None:
    """The superpixels' borders, drawn at twice the grid's width."""
    large = cv2.resize(
        segments.astype(np.int32), (2 * width, 2 * height), interpolation=cv2.INTER_NEAREST
    )
    borders = find_boundaries(large, mode="inner")
    picture = np.zeros((*borders.shape, 4))
    picture[borders] = (1.0, 0.85, 0.2, 0.9)
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    axes.imshow(picture, extent=extent, interpolation="nearest")
