"""Figures 3.17 and 3.20: what each method predicts for the patches of one picture, as dots."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from tokt.features.common.arrays import U8, Bools
from tokt.features.common.errors import ToktError
from tokt.inference.frame import Frame
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.verdict import STATUS_WORDS, UNKNOWN, verdict_from_mask
from tokt_studies.baselines.thesis_stereo import CROP_PX, cropped
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.simulation.rendering.patch_labels import MIN_COVERAGE
from tokt_studies.thesis.methods.curves import OURS, THESIS, THESIS_DISPARITY, TOKT_STEREO
from tokt_studies.thesis.patch_scores import (
    PatchScore,
    Truth,
    patches_of_mask,
    pooled_score,
    score_patches,
)

from . import frame_drawing as drawing
from .disparity_figures import patches_in_map, thesis_map
from .exhibit import LEARNT_ELSEWHERE, Claim, ClaimAgreement, Exhibit, Plot, StudyContext
from .training_image_figures import described

_HIGH, _HALF = 0.8, 0.5
_RULE = f"to agree: {_HIGH} or more; in part: {_HALF}"


@dataclass(frozen=True)
class MethodPrediction:
    """One method's predictions of a picture: its patches, and its 0/255 mask at the grid's width.

    Both are None where it could not judge the picture, for what `fault` says, which is never the
    same as clear. `words` say what it learnt from; `kind` is as in `curves`.
    """

    name: str
    title: str
    kind: str
    words: str
    patches: Bools | None = None
    mask: U8 | None = None
    fault: str = ""

    @property
    def status(self) -> str:
        """``obstacle``, ``clear`` or ``unknown``, by the mean of the mask alone."""
        status = UNKNOWN if self.mask is None else verdict_from_mask(self.mask, self.name).status
        return STATUS_WORDS[status]

    def score(self, truth: Truth | None) -> PatchScore:
        """By the truth of the picture; of nothing without one, and where it was not judged."""
        if self.patches is None or truth is None:
            return PatchScore()
        return score_patches(self.patches, truth)


def said_by_patches(
    name: str, title: str, kind: str, words: str, patches: Bools | str, frame: U8
) -> MethodPrediction:
    """Predictions of a method that judges patches of the grid, or says why it cannot."""
    if isinstance(patches, str):
        return MethodPrediction(name, title, kind, words, fault=patches)
    mask = GRID.paint(patches, *GRID.resized(*frame.shape[:2]))
    return MethodPrediction(name, title, kind, words, patches, mask)


def by_thesis(context: StudyContext, frame: U8) -> list[MethodPrediction]:
    """The thesis's three texture models on a picture, by tokt's kernels of the same features."""
    rows, words = described(frame), context.two_images
    return [
        said_by_patches(
            name, model.title, THESIS, words, model.classifier.predict(rows[name]) == 1, frame
        )
        for name, model in context.thesis.items()
    ]


def by_stereo(
    calibration: StereoCalibration | None, left: U8, right: U8 | None, words: str
) -> MethodPrediction:
    """Our stereo on a pair; `words` say where the calibration is from, or why there is none."""
    who = TOKT_STEREO, "tokt stereo", OURS, words
    if right is None:
        return MethodPrediction(*who, fault="there is no right picture")
    if calibration is None:
        return MethodPrediction(*who, fault=words)
    try:
        found = DisparityDetector(calibration, GRID).detect(Frame(1, 0.0, left, right))
    except ToktError as error:
        return MethodPrediction(*who, fault=str(error))
    if found.mask is None:
        return MethodPrediction(*who, fault=str(found.fault))
    return MethodPrediction(*who, patches_of_mask(found.mask), found.mask)


def by_disparity(left: U8, right: U8 | None) -> MethodPrediction:
    """The thesis's disparity on a pair, by the patches that its map shows; it learns nothing."""
    who = THESIS_DISPARITY, "disparity", THESIS, "the thesis's pipeline; it learns nothing"
    if right is None:
        return MethodPrediction(*who, fault="there is no right picture")
    mask, shown = cropped(thesis_map(left, right)), patches_in_map()[:, CROP_PX:-CROP_PX]
    counted = shown[shown >= 0]
    pixels = np.bincount(counted, minlength=GRID.n_patches)
    white = np.bincount(counted, mask[shown >= 0] > 0, minlength=GRID.n_patches)
    return MethodPrediction(*who, white >= MIN_COVERAGE * np.maximum(pixels, 1), mask)


def prediction_dots(context: StudyContext) -> Exhibit:
    """Predictions for each patch of the frame that shows the structure (figures 3.17, 3.20)."""
    number = context.structure_frame
    frame, truth = context.picture(number), context.labelled.get(number)
    said = by_thesis(context, frame)
    patches, truths = context.curves.patches, context.truths
    pooled = {one.name: pooled_score(patches.get(one.name, {}), truths) for one in said}
    caption = (
        f"Frame {number}: dots and mask by each method; green outlines are patches labelled as an "
        f"obstacle. {drawing.SHOWN}"
    )
    return Exhibit(
        (
            f"Frame {number}, which no method learnt from. Red dots are patches said to be other "
            f"than ocean; they are white in the mask. {LEARNT_ELSEWHERE}",
        ),
        (dot_claim(said, truth, pooled), alike_claim(patches, context.scored)),
        plots=(Plot("dots", caption, drawing.png_of(_figure(frame, said, truth))),),
    )


def dot_claim(
    said: Sequence[MethodPrediction], truth: Truth | None, pooled: Mapping[str, PatchScore]
) -> Claim:
    """Whether the thesis's red dots lie on the structure, and the blue ones on ocean."""
    claim = Claim.about(
        "red dots lie on the structure, blue ones on ocean", "figures 3.17 and 3.20"
    )
    if truth is None or not (truth == 1).any():
        why = "the frame has no obstacle labelled, so that dots cannot be judged"
        return claim("not scored", why)
    scores = {one.name: one.score(truth).f1 or 0.0 for one in said}
    least = min(scores.values())
    return claim(
        "F1 in this frame, and in all labelled frames: "
        + ", ".join(
            f"{one.title} {scores[one.name]:.2f}, {pooled.get(one.name, PatchScore()).f1 or 0:.2f}"
            for one in said
        ),
        f"by F1 in the frame: {_RULE}",
        agreement=ClaimAgreement.of(least >= _HIGH, least >= _HALF),
    )


def alike_claim(patches: Mapping[str, Mapping[int, Bools]], frames: Sequence[int]) -> Claim:
    """Whether the masks of LBP and of Haralick look alike, over frames that neither learnt from."""
    claim = Claim.about("masks of LBP and of Haralick look very alike", "section 3.4.2")
    lbp, haralick = (patches.get(name, {}) for name in ("lbp_10_5", "haralick"))
    both = [number for number in frames if number in lbp and number in haralick]
    hits = sum(int((lbp[n] & haralick[n]).sum()) for n in both)
    either = sum(int((lbp[n] | haralick[n]).sum()) for n in both)
    if not either:
        return claim("no mask has anything", "empty masks cannot be told apart")
    share = hits / either
    return claim(
        f"of {either} patches that LBP (10, 5) or Haralick marks, {share:.0%} by both",
        f"by that share: {_RULE}",
        agreement=ClaimAgreement.of(share >= _HIGH, share >= _HALF),
    )


def _figure(frame: U8, said: Sequence[MethodPrediction], truth: Truth | None) -> Figure:
    figure, rows = drawing.new_figure(10.5, 3.55 * len(said) + 0.3, len(said), 2, squeeze=False)
    for (dots, mask), one in zip(rows, said, strict=True):
        size = drawing.show_frame(dots, frame)
        drawing.draw_grid(dots, *size)
        if truth is not None:
            drawing.draw_truth(dots, truth, *size)
        dots.set_title(one.title, fontsize=10, loc="left")
        drawing.draw_dots(dots, np.asarray(one.patches), *size)
        drawing.show_mask(mask, np.asarray(one.mask))
    drawing.explain_dots(rows[-1][0], truth is not None, ncols=4)
    return figure
