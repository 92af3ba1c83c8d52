"""Figure 5.1: SLIC superpixels against the grid."""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from skimage.segmentation import find_boundaries

from tokt.features.common.arrays import I64, U8
from tokt_studies.baselines.slic import SlicTexture, resized_bgr, superpixels
from tokt_studies.baselines.thesis_centre import outer_contours
from tokt_studies.baselines.thesis_models import ThesisModel
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.thesis.methods.mission_models import SLIC
from tokt_studies.thesis.patch_scores import Truth, patches_of_mask, pooled_score

from .exhibit import Claim, ClaimAgreement, Exhibit, Plot, StudyContext
from .frame_drawing import SHOWN, draw_grid, new_figure, png_of, show_frame, show_mask

NO_BETTER, SIMILAR = 0.02, 0.5
"""F1 that SLIC may be ahead and still see no better; white in both, of that in either, from which
two masks are very similar."""


def superpixel_figure(context: StudyContext) -> Exhibit:
    """The exhibit of figure 5.1, on the request's sample of frames."""
    shown = context.structure_frame
    numbers = sorted({*context.spread(), shown})
    frames = {shown: context.picture(shown)} | dict(context.decoded(numbers))
    methods = [
        (slic, context.thesis[name])
        for name, slic in zip(SLIC, context.superpixel_methods.textures, strict=True)
    ]
    summary = compare(frames, *methods[0], context.labelled)
    return Exhibit(
        words=_words(context, len(frames)),
        claims=(mask_claim(summary),),
        plots=(_plot(shown, frames[shown], methods),),
    )


def _both_masks(frame: U8, slic: SlicTexture, model: ThesisModel) -> tuple[U8, U8]:
    """Masks of a frame by superpixels and by the grid."""
    by_grid = model.judge(frame).obstacle
    return slic.mask(frame), GRID.paint(by_grid, *GRID.resized(*frame.shape[:2]))


def compare(
    frames: Mapping[int, U8], slic: SlicTexture, model: ThesisModel, labelled: Mapping[int, Truth]
) -> dict[str, Any]:
    """Hold superpixels against the grid over frames: see `mask_claim`.

    The overlap is white in both over white in either, F1 is over all sure patches.
    """
    ways = list(zip(*(_both_masks(one, slic, model) for one in frames.values()), strict=True))
    overlap = sum(
        np.count_nonzero(by_slic & by_grid) for by_slic, by_grid in zip(*ways, strict=True)
    )
    slic_area, grid_area = (sum(map(np.count_nonzero, masks)) for masks in ways)
    slic_contours, grid_contours = (
        sum(len(outer_contours(mask)) for mask in masks) for masks in ways
    )
    slic_f1, grid_f1 = (
        pooled_score(dict(zip(frames, map(patches_of_mask, masks), strict=True)), labelled).f1
        for masks in ways
    )
    either = slic_area + grid_area - overlap
    return {
        "overlap": overlap / either if either else None,
        "area_ratio": grid_area / max(slic_area, 1),
        "slic_contours": slic_contours,
        "grid_contours": grid_contours,
        "slic_f1": slic_f1,
        "grid_f1": grid_f1,
    }


def mask_claim(summary: Mapping[str, Any]) -> Claim:
    """Section 5.1.1, of SLIC + LBP and LBP on the grid."""
    claim = Claim.about(
        "SLIC sees no better; the grid's area is larger, its blocks join to fewer contours",
        "very similar, both detect (figure 5.1, section 5.1.1)",
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
        f"{100 * SIMILAR:.0f} % in both; in part: two of these",
        agreement=ClaimAgreement.of(all(true), sum(true) >= len(true) / 2),
    )


def _words(context: StudyContext, count: int) -> tuple[str, ...]:
    return (
        "Both have the same two training images, features and classifier. One takes a rectangle "
        "around each superpixel, the other a patch of a 10x10 grid.",
        f"On a sample of {count} frames, as SLIC is slow; frame {context.structure_frame} "
        "is among them, and none was learnt from. Scored by patches: of a superpixel mask those "
        "with a tenth or more white.",
    )


def _plot(number: int, frame: U8, methods: Sequence[tuple[SlicTexture, ThesisModel]]) -> Plot:
    segments = superpixels(resized_bgr(frame))
    figure, axes = new_figure(10.5, 5.9, 2, 1 + len(methods))
    height, width = show_frame(axes[0, 0], frame)
    _draw_outlines(axes[0, 0], segments, height, width)
    axes[0, 0].set_title(f"frame {number}: {len(np.unique(segments))} superpixels", fontsize=10)
    show_frame(axes[1, 0], frame)
    draw_grid(axes[1, 0], height, width)
    axes[1, 0].set_title(f"{GRID.n_patches} patches", fontsize=10)
    for column, (slic, model) in zip(axes.T[1:], methods, strict=True):
        masks = zip(("SLIC", "grid"), _both_masks(frame, slic, model), strict=True)
        for panel, (what, mask) in zip(column, masks, strict=True):
            show_mask(panel, mask)
            panel.set_title(f"{what}, {model.title}", fontsize=10)
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
