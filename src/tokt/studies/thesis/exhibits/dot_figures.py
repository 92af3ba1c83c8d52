"""Figures 3.17 and 3.20: what is predicted for each patch, as dots over the grid, and the mask."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.context import StudyContext
from tokt.studies.thesis.exhibit import NOT_KNOWN, Claim, ClaimAgreement, Exhibit, Plot, Table
from tokt.studies.thesis.frame_drawing import (
    SHOWN,
    draw_dots,
    draw_grid,
    draw_truth,
    explain_dots,
    png_of,
    show_frame,
    show_mask,
)
from tokt.studies.thesis.methods.patch_scores import (
    Flags,
    PatchScore,
    PatchTruth,
    score_patches,
    truth_by_labels,
)
from tokt.studies.thesis.methods.sequence_methods import TOKT_MODEL

from .picture_predictions import (
    MethodPrediction,
    by_bundle,
    by_held_out,
    by_stereo,
    by_thesis,
    learnt_words,
)

_MASK_RULE = "the patches of which its mask has a tenth or more white, as for labels"


def prediction_dots(context: StudyContext) -> Exhibit:
    """Predictions for each patch of the frame that shows the structure (figures 3.17, 3.20).

    Raises
    ------
    ToktError
        If the frame or a file of the request cannot be read.
    """
    number = context.structure_frame
    frame, truth = context.left(number), truth_by_labels(context.truth(number))
    stereo = by_stereo(context.calibration, frame, context.right(number), context.calibration_words)
    said = [
        *by_thesis(context, frame),
        *by_held_out(context, number, frame),
        *by_bundle(context, frame, context.curves.words.get(TOKT_MODEL, "")),
        stereo,
    ]
    scores = {
        one.name: score_patches(one.patches, truth)
        for one in said
        if one.patches is not None and truth is not None
    }
    pooled, n_labelled = pooled_scores(context, context.curves.patches)
    return Exhibit(
        "figure-3.17-3.20",
        "Prediction dots over the grid, and the mask",
        "thesis sections 3.4 and 3.5, figures 3.17 and 3.20",
        (
            f"Frame {number}, by the thesis's three models and by ours. Red dots are patches said "
            "to be other than ocean; they are white in the mask. Of stereo, which judges pixels, "
            f"the dots are {_MASK_RULE}.",
            *learnt_words(said),
        ),
        _claims(said, scores, number),
        _tables(said, scores, pooled, number, n_labelled),
        (
            Plot(
                "dots",
                f"Frame {number}: dots and mask by each method; green outlines are patches "
                f"labelled as an obstacle. {SHOWN}",
                png_of(_figure(frame, said, truth)),
            ),
        ),
        _numbers(number, scores, pooled, n_labelled),
    )


def pooled_scores(
    context: StudyContext, patches: Mapping[str, Mapping[int, Flags]]
) -> tuple[dict[str, PatchScore], int]:
    """Each method's score over all labelled frames that it judged, and how many frames there are.

    Parameters
    ----------
    patches : mapping of str to mapping of int to array of bool
        By method and frame.
    """
    truths = {
        number: truth
        for number in context.scored
        if (truth := truth_by_labels(context.truth(number)))
    }
    pooled = {}
    for name, by_frame in patches.items():
        total = PatchScore(0, 0, 0, 0)
        for number, truth in truths.items():
            if number in by_frame:
                total += score_patches(by_frame[number], truth)
        pooled[name] = total
    return (pooled, len(truths)) if truths else ({}, 0)


def score_row(score: PatchScore | None) -> dict[str, Any]:
    """Columns of a table; empty where there is no score."""
    names = ("precision", "recall", "f1", "iou", "hits", "false", "missed", "quiet")
    return {name: None if score is None else getattr(score, name) for name in names}


def whole_counts(frame: pd.DataFrame) -> pd.DataFrame:
    """A table of scores with its counts as whole numbers, missing ones among them."""
    counts = ["obstacle patches", "hits", "false", "missed", "quiet"]
    return frame.astype({name: "Int64" for name in counts if name in frame})


def _tables(
    said: list[MethodPrediction],
    scores: dict[str, PatchScore],
    pooled: dict[str, PatchScore],
    number: int,
    n_labelled: int,
) -> tuple[Table, ...]:
    frame = pd.DataFrame(
        {
            "method": one.title,
            "whose": one.kind,
            "obstacle patches": None if one.patches is None else int(one.patches.sum()),
            **score_row(scores.get(one.name)),
            "not judged": one.fault,
        }
        for one in said
    )
    given = any(one.name == TOKT_MODEL for one in said)
    tables = [
        Table(
            "frame",
            f"Patches of frame {number} against its labels (unsure ones are not scored); counts "
            "of patches. Our texture model is held out; the others did not learn from this frame"
            + ("; the model that was given may have." if given else "."),
            whole_counts(frame),
            "This frame",
        )
    ]
    if n_labelled:
        titles = {one.name: one.title for one in said}
        mission = pd.DataFrame(
            {"method": titles.get(name, name), **score_row(score)} for name, score in pooled.items()
        )
        tables.append(
            Table(
                "mission",
                f"The same over all {n_labelled} labelled frames that no training image is of; "
                "counts of patches. Our texture model: each frame by a model that did not learn "
                "from it or from frames near it.",
                mission,
                "The whole mission",
            )
        )
    return tuple(tables)


def _words(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.2f}"


def _claims(
    said: list[MethodPrediction], scores: dict[str, PatchScore], number: int
) -> tuple[Claim, ...]:
    claims = []
    for one in said:
        score = scores.get(one.name)
        if one.patches is None:
            found = f"not judged: {one.fault}"
        elif score is None:
            found = f"{one.patches.sum()} of {GRID.n_patches} patches are other"
        else:
            found = (
                f"{one.patches.sum()} of {GRID.n_patches} patches are other; precision "
                f"{_words(score.precision)}, recall {_words(score.recall)}"
            )
        claims.append(
            Claim(
                f"{one.title}: the dots that are other lie on the structure",
                NOT_KNOWN,
                found,
                ClaimAgreement.UNCOMPARABLE,
                f"The figures' dots are not at hand; judged by the labels of frame {number}."
                if scores
                else "The figures' dots are not at hand, and the frame has no labels.",
            )
        )
    return tuple(claims)


def _figure(
    frame: NDArray[np.uint8], said: list[MethodPrediction], truth: PatchTruth | None
) -> Figure:
    figure = Figure(figsize=(10.5, 3.55 * len(said) + 0.3), layout="constrained")
    rows = figure.subplots(len(said), 2, squeeze=False)
    for (dots, mask), one in zip(rows, said, strict=True):
        height, width = show_frame(dots, frame, GRID)
        draw_grid(dots, GRID, height, width)
        if truth is not None:
            draw_truth(dots, truth, GRID, height, width)
        dots.set_title(one.title, fontsize=10, loc="left")
        if one.patches is None or one.mask is None:
            mask.set_axis_off()
            mask.text(0.5, 0.5, f"not judged:\n{one.fault}", ha="center", va="center", wrap=True)
            continue
        draw_dots(dots, one.patches, GRID, height, width)
        show_mask(mask, one.mask)
    explain_dots(rows[-1][0], truth is not None, ncols=4)
    return figure


def _numbers(
    number: int,
    scores: dict[str, PatchScore],
    pooled: dict[str, PatchScore],
    n_labelled: int,
) -> dict[str, float | int | str | bool]:
    numbers: dict[str, float | int | str | bool] = {"frame": number, "labelled_frames": n_labelled}
    for place, found in (("frame", scores), ("mission", pooled)):
        for name, score in found.items():
            for figure in ("precision", "recall", "f1", "iou"):
                value = getattr(score, figure)
                if value is not None:
                    numbers[f"{place}_{name}_{figure}"] = value
    return numbers
