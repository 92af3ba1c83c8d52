"""Figures 3.17 and 3.20: what each method predicts for the patches of one picture, as dots."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tokt.features.common.arrays import U8, Bools
from tokt.features.common.errors import ToktError
from tokt.inference.frame import Frame
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.verdict import STATUS_WORDS, UNKNOWN, verdict_from_mask
from tokt.models.bundle.bundle import read_bundle
from tokt.studies.baselines.thesis_stereo import CROP_PX, cropped
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.simulation.rendering.patch_labels import MIN_COVERAGE
from tokt.studies.thesis.methods.curves import (
    OURS,
    THESIS,
    THESIS_DISPARITY,
    TOKT_MODEL,
    TOKT_STEREO,
    title_and_kind,
)
from tokt.studies.thesis.methods.mission_models import TOKT_TEXTURE
from tokt.studies.thesis.patch_scores import (
    PatchScore,
    Truth,
    patches_of_mask,
    pooled_score,
    score_patches,
)

from .disparity_figures import patches_in_map, thesis_map
from .exhibit import LEARNT_ELSEWHERE, Claim, ClaimAgreement, Exhibit, Plot, StudyContext, Table
from .frame_drawing import (
    SHOWN,
    draw_dots,
    draw_grid,
    draw_truth,
    explain_dots,
    new_figure,
    png_of,
    show_frame,
    show_mask,
)
from .training_image_figures import described

_COUNTS = [one.name for one in fields(PatchScore)]
_HIGH, _HALF = 0.8, 0.5
_RULE = f"agrees from {_HIGH}, in part from {_HALF} on"


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

    def score(self, truth: Truth | None) -> PatchScore | None:
        """By the truth of the picture; None without one, and where it could not be judged."""
        if self.patches is None or truth is None:
            return None
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


def by_held_out(context: StudyContext, number: int, frame: U8) -> list[MethodPrediction]:
    """Our texture model on a frame of the mission, by a model that did not learn from it."""
    curves = context.curves
    patches = curves.patches.get(TOKT_TEXTURE, {}).get(number)
    if patches is None:
        return []
    method = curves.methods[TOKT_TEXTURE]
    return [said_by_patches(TOKT_TEXTURE, method.title, OURS, method.words, patches, frame)]


def by_bundle(context: StudyContext, frame: U8, words: str) -> list[MethodPrediction]:
    """The bundle of the request on a picture, by its patches; nothing where none was given."""
    if context.request.model is None:
        return []
    bundle = read_bundle(str(context.request.model))
    who = TOKT_MODEL, f"tokt model {bundle.label}", OURS, words
    if bundle.grid != GRID:
        fault = f"its patches are {bundle.grid}, these figures are of {GRID}"
        return [said_by_patches(*who, fault, frame)]
    try:
        values = bundle.values_of(bundle.features(frame))
    except ValueError as error:
        return [said_by_patches(*who, str(error), frame)]
    return [said_by_patches(*who, bundle.model.obstacle_patches(values), frame)]


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


def by_superpixels(context: StudyContext, number: int, frame: U8) -> list[MethodPrediction]:
    """The methods that cut the picture into superpixels, by the patches that they cover.

    Those of the mission's frame of that number: they did not learn from it.
    """
    found, methods = [], context.superpixel_methods
    for method in methods.of(number):
        mask, who = method.mask(frame), (method.name, *title_and_kind(method))
        patches = patches_of_mask(mask)
        found.append(MethodPrediction(*who, methods.words(method), patches, mask))
    return found


def may_have_learnt(said: Sequence[MethodPrediction]) -> str:
    """The end of a sentence that says that nothing learnt from what it is scored on."""
    given = any(one.name == TOKT_MODEL for one in said)
    return "; the model that was given may have." if given else "."


def scored_predictions(said: Sequence[MethodPrediction], truth: Truth | None) -> pd.DataFrame:
    """One row a method: what it says of the picture, and its scores where there are some."""
    frame = pd.DataFrame(
        {
            "method": one.title,
            "whose": one.kind,
            "status": one.status,
            "obstacle patches": None if one.patches is None else int(one.patches.sum()),
            **_score_row(one.score(truth)),
            "not judged": one.fault,
        }
        for one in said
    )
    return frame.astype(dict.fromkeys(["obstacle patches", *_COUNTS], "Int64"))


def _score_row(score: PatchScore | None) -> dict[str, float | int | None]:
    """Columns of a table; empty where there is no score."""
    row = {**(score or PatchScore()).figures(), **asdict(score or PatchScore())}
    return row if score else dict.fromkeys(row)


def prediction_dots(context: StudyContext) -> Exhibit:
    """Predictions for each patch of the frame that shows the structure (figures 3.17, 3.20)."""
    number = context.structure_frame
    frame, truth = context.left(number), context.labelled.get(number)
    stereo = by_stereo(context.calibration, frame, context.right(number), context.calibration_words)
    learnt = context.curves.methods.get(TOKT_MODEL)
    thesis_said = by_thesis(context, frame)
    said = [
        *thesis_said,
        *by_held_out(context, number, frame),
        *by_bundle(context, frame, learnt.words if learnt else ""),
        stereo,
    ]
    truths = context.truths
    by_method = context.curves.patches.items() if truths else ()
    pooled = {name: pooled_score(patches, truths) for name, patches in by_method}
    return Exhibit(
        (
            f"Frame {number}, by the thesis's three models and by ours. Red dots are patches said "
            "to be other than ocean; they are white in the mask. Stereo judges pixels: its dots "
            f"are patches with a tenth or more white. {LEARNT_ELSEWHERE}",
        ),
        (
            dot_claim(thesis_said, truth, pooled),
            alike_claim(context.curves.patches, context.scored),
        ),
        _tables(said, truth, pooled, number, len(truths)),
        (
            Plot(
                "dots",
                f"Frame {number}: dots and mask by each method; green outlines are patches "
                f"labelled as an obstacle. {SHOWN}",
                png_of(_figure(frame, said, truth)),
            ),
        ),
        {"frame": number, "labelled_frames": len(truths)}
        | {
            f"{place}_{name}_{figure}": value
            for place, name, score in (
                *(("frame", one.name, one.score(truth)) for one in said),
                *(("mission", name, one) for name, one in pooled.items()),
            )
            if score
            for figure, value in score.figures().items()
        },
    )


def _tables(
    said: Sequence[MethodPrediction],
    truth: Truth | None,
    pooled: Mapping[str, PatchScore],
    number: int,
    n_labelled: int,
) -> tuple[Table, ...]:
    frame = Table(
        "frame",
        f"Patches of frame {number} against its labels (unsure ones are not scored); counts "
        "of patches. Our texture model is held out; the others did not learn from this frame"
        + may_have_learnt(said),
        scored_predictions(said, truth).drop(columns="status"),
        "This frame",
    )
    if not n_labelled:
        return (frame,)
    titles = {one.name: one.title for one in said}
    rows = [{"method": titles.get(name, name), **_score_row(one)} for name, one in pooled.items()]
    mission = Table(
        "mission",
        f"The same over all {n_labelled} labelled frames that no training image is of; "
        "counts of patches. Our texture model: each frame by a model that did not learn "
        "from it or from frames near it.",
        pd.DataFrame(rows),
        "The whole mission",
    )
    return frame, mission


def dot_claim(
    said: Sequence[MethodPrediction], truth: Truth | None, pooled: Mapping[str, PatchScore]
) -> Claim:
    """Whether the thesis's red dots lie on the structure, and the blue ones on ocean."""
    what = "red dots lie on the structure, blue ones on ocean"
    printed = "figures 3.17 and 3.20"
    if truth is None or not (truth == 1).any():
        why = "the frame has no obstacle labelled, so that dots cannot be judged"
        return Claim(what, printed, "not scored", why)
    scores = {one.name: (one.score(truth) or PatchScore()).f1 or 0.0 for one in said}
    least = min(scores.values())
    return Claim(
        what,
        printed,
        "F1 in this frame, and in all labelled frames: "
        + ", ".join(
            f"{one.title} {scores[one.name]:.2f}, {pooled.get(one.name, PatchScore()).f1 or 0:.2f}"
            for one in said
        ),
        f"by F1 in the frame: {_RULE}",
        agreement=_agreement(least),
    )


def alike_claim(patches: Mapping[str, Mapping[int, Bools]], frames: Sequence[int]) -> Claim:
    """Whether the masks of LBP and of Haralick look alike, over frames that neither learnt from."""
    what = "masks of LBP and of Haralick look very alike"
    printed = "section 3.4.2"
    lbp, haralick = (patches.get(name, {}) for name in ("lbp_10_5", "haralick"))
    both = [number for number in frames if number in lbp and number in haralick]
    hits = sum(int((lbp[n] & haralick[n]).sum()) for n in both)
    either = sum(int((lbp[n] | haralick[n]).sum()) for n in both)
    if not either:
        return Claim(what, printed, "no mask has anything", "empty masks cannot be told apart")
    return Claim(
        what,
        printed,
        f"of the {either} patches that LBP (10, 5) or Haralick marks in {len(both)} frames, "
        f"{hits / either:.0%} are marked by both",
        f"intersection over union: {_RULE}",
        agreement=_agreement(hits / either),
    )


def _agreement(share: float) -> ClaimAgreement:
    if share >= _HIGH:
        return ClaimAgreement.YES
    return ClaimAgreement.PARTLY if share >= _HALF else ClaimAgreement.NO


def _figure(frame: U8, said: Sequence[MethodPrediction], truth: Truth | None) -> Figure:
    figure, rows = new_figure(10.5, 3.55 * len(said) + 0.3, len(said), 2, squeeze=False)
    for (dots, mask), one in zip(rows, said, strict=True):
        size = show_frame(dots, frame)
        draw_grid(dots, *size)
        if truth is not None:
            draw_truth(dots, truth, *size)
        dots.set_title(one.title, fontsize=10, loc="left")
        if one.patches is None or one.mask is None:
            mask.set_axis_off()
            mask.text(0.5, 0.5, f"not judged:\n{one.fault}", ha="center", va="center", wrap=True)
            continue
        draw_dots(dots, one.patches, *size)
        show_mask(mask, one.mask)
    explain_dots(rows[-1][0], truth is not None, ncols=4)
    return figure
