"""Figures 5.3 to 5.5: the mean value of every method along the mission."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from tokt.features.frames.mission import format_frames
from tokt.inference.verdict import STATUS_MEAN_THRESHOLD
from tokt.studies.thesis.context import StudyContext
from tokt.studies.thesis.exhibit import NOT_KNOWN, Claim, ClaimAgreement, Exhibit, Plot, Table
from tokt.studies.thesis.frame_drawing import png_of
from tokt.studies.thesis.methods.curves import OURS, THESIS, Curves

from .curve_plots import correlation_picture, normalised, sequence, zoomed
from .curve_scores import (
    GOES_WITH,
    IN_A_ROW,
    NEARLY_ALWAYS,
    MethodScore,
    agreement_with_distance,
    correlations,
    score_methods,
    scores_table,
    with_nearness,
)

KEY, TITLE, SECTION = (
    "figure-5.3-to-5.5",
    "Mean value along the mission",
    "Figures 5.3 to 5.5; sections 5.2.1 and 7.2",
)


def curve_figures(context: StudyContext) -> Exhibit:
    """Draw and score the curves of all methods."""
    curves, scores = context.curves, score_methods(context)
    whole = [name for name, method in curves.methods.items() if not method.sampled]
    together = correlations(curves, whole)
    nearness = {name: with_nearness(curves, name) for name in whole}
    return Exhibit(
        KEY,
        TITLE,
        SECTION,
        _words(context),
        _claims(context, scores, nearness),
        _tables(context, scores, together, nearness),
        _plots(context, scores, together),
        _numbers(curves, scores, nearness),
    )


def _words(context: StudyContext) -> tuple[str, ...]:
    curves = context.curves
    scored = f"{len(curves.mean)} left frames of {context.mission.name} are judged"
    left_out = (context.ocean.frame, context.other.frame)
    training = [str(number) for number in left_out if number is not None]
    if training:
        scored += (
            f"; frame {' and '.join(training)} is not scored, as the thesis's models learnt it"
        )
    if curves.unreadable:
        scored += f"; frames {format_frames(curves.unreadable)} cannot be read"
    limit = (
        "The mean value is that of the 0/255 mask; the status is 1 above "
        f"{STATUS_MEAN_THRESHOLD:g}, except for growing keypoints and thirds of disparity, which "
        "have rules of their own. A first detection is the first of "
        f"{IN_A_ROW} frames in a row with status 1."
    )
    methods = [f"{method.title}: {method.words.rstrip('.')}." for method in curves.methods.values()]
    missing = [f"Left out: {why}." for why in curves.left_out]
    return (f"{scored}. {limit}", *methods, *missing)


def _tables(
    context: StudyContext,
    scores: Mapping[str, MethodScore],
    together: pd.DataFrame,
    nearness: Mapping[str, float | None],
) -> tuple[Table, ...]:
    curves = context.curves
    titles = {name: method.title for name, method in curves.methods.items()}
    labels = "Ocean frames have every patch labelled, as clear." if context.labels else ""
    pairs = together.rename(index=titles, columns=titles)
    pairs["1 / distance"] = [nearness[name] for name in together.index]
    return (
        Table(
            "scores",
            f"What the curves come to. {labels} Patch F1 is of the grid's patches at their own "
            "threshold, over all sure labels; empty where a method has none.",
            scores_table(curves, scores),
        ),
        Table(
            "correlations",
            "Spearman's rank correlation between curves, on the frames that both judged; the last "
            "column with 1 / distance where stereo measures one.",
            pairs.reset_index(names="method"),
        ),
        Table(
            "means",
            "Mean value by frame, 0 to 255; empty where a method did not judge the frame.",
            curves.mean.reset_index(),
            "Mean value by frame",
        ),
        Table(
            "statuses",
            "1, 0, or -1 where it was not judged.",
            curves.status.reset_index(),
            "Status by frame",
        ),
    )


def _plots(
    context: StudyContext, scores: Mapping[str, MethodScore], together: pd.DataFrame
) -> tuple[Plot, ...]:
    curves, labels = context.curves, context.obstacle_patches
    firsts = {name: one.first_detection for name, one in scores.items()}
    shaded = " Gray: an obstacle is labelled; hatched: not labelled." if context.labels else ""
    plots = [
        Plot(
            "figure_5_3_sequence",
            f"Mean value by frame, logarithmic above 1.{shaded}",
            png_of(sequence(curves, labels, firsts)),
        ),
        Plot(
            "figure_5_4_normalised",
            f"Each curve as a share of its largest value.{shaded}",
            png_of(normalised(curves, labels)),
        ),
    ]
    zoom = zoomed(curves, labels, firsts)
    if zoom is not None:
        words = f"Small mean values around the first detections.{shaded}"
        plots.append(Plot("figure_5_5_zoomed", words, png_of(zoom)))
    titles = [curves.methods[name].title for name in together.index]
    words = "Rank correlations between the curves."
    plots.append(Plot("correlations", words, png_of(correlation_picture(together, titles))))
    return tuple(plots)


def _claims(
    context: StudyContext,
    scores: Mapping[str, MethodScore],
    nearness: Mapping[str, float | None],
) -> tuple[Claim, ...]:
    curves = context.curves
    return (
        _detection_claim(context, scores),
        _distance_claim(curves, nearness),
        _printed_curves_claim(curves, scores),
    )


def _detection_claim(context: StudyContext, scores: Mapping[str, MethodScore]) -> Claim:
    """Cameras can be used: each method warns before the nearest approach, without false status."""
    what = "Cameras can be used for underwater obstacle avoidance"
    printed = "said in the abstract, from the sea trial"
    names = [name for name, method in context.curves.methods.items() if not method.sampled]
    if not context.labels or not any(context.obstacle_patches.values()):
        why = "no obstacle is labelled in this mission, so nothing says what a detection is"
        return Claim(what, printed, "not measured", ClaimAgreement.UNCOMPARABLE, why)
    nearest = max(context.obstacle_patches, key=lambda number: context.obstacle_patches[number])
    good = [
        name
        for name in names
        if (first := scores[name].first_detection) is not None
        and first < nearest
        and not scores[name].false_status
    ]
    found = (
        f"{len(good)} of {len(names)} methods have status 1 before frame {nearest}, where most "
        "patches are obstacle, and none in an ocean frame"
    )
    agreement = (
        ClaimAgreement.YES
        if len(good) == len(names)
        else ClaimAgreement.PARTLY
        if good
        else ClaimAgreement.NO
    )
    why = "judged by first detections and false statuses of this mission alone; not: " + (
        ", ".join(context.curves.methods[n].title for n in names if n not in good) or "none"
    )
    return Claim(what, printed, found, agreement, why)


def _distance_claim(curves: Curves, nearness: Mapping[str, float | None]) -> Claim:
    """Sections 5.2.1 and 7.2: the mean value over time as a relative distance."""
    what = "The mean value over time tells the relative distance"
    printed = f"sections 5.2.1 and 7.2 use it so; how well it does is {NOT_KNOWN}"
    known = {name: value for name, value in nearness.items() if value is not None}
    thesis = {name: value for name, value in known.items() if curves.methods[name].kind == THESIS}
    if not thesis:
        why = "no distance is measured here to hold the curves against (no pairs, or nothing near)"
        return Claim(what, printed, "not measured", ClaimAgreement.UNCOMPARABLE, why)
    told = ", ".join(f"{curves.methods[n].title} {value:.2f}" for n, value in known.items())
    agreement = agreement_with_distance(thesis.values())
    measured = int(curves.distance_m.notna().sum())
    why = (
        f"judged by the thesis's methods: agrees where each rank correlation is "
        f"{NEARLY_ALWAYS:g} or more, in part from {GOES_WITH:g} on, over the {measured} frames of "
        "which tokt's stereo measures a distance; an order, not metres. What stereo itself gives "
        "is no second witness: its mean and that of the thirds are of the same matches"
    )
    return Claim(what, printed, f"rank correlation with 1 / distance: {told}", agreement, why)


def _printed_curves_claim(curves: Curves, scores: Mapping[str, MethodScore]) -> Claim:
    told = ", ".join(
        f"{curves.methods[name].title} {one.first_detection or 'none'}"
        for name, one in scores.items()
        if not curves.methods[name].sampled
    )
    return Claim(
        "Where the curves begin to rise",
        NOT_KNOWN,
        f"first detections: {told}",
        ClaimAgreement.UNCOMPARABLE,
        "the figures' numbers are not at hand, and the thesis's other training image, a film "
        "still, is not included: another image moves the texture methods' first detections",
    )


def _numbers(
    curves: Curves, scores: Mapping[str, MethodScore], nearness: Mapping[str, float | None]
) -> dict[str, float | int | str | bool]:
    numbers: dict[str, float | int | str | bool] = {"frames": len(curves.mean)}
    for name, one in scores.items():
        for key, value in vars(one).items():
            if value is not None:
                numbers[f"{name}_{key}"] = value
        near = nearness.get(name)
        if near is not None:
            numbers[f"{name}_with_nearness"] = near
    ours = [name for name in curves.named(OURS) if scores[name].first_detection is not None]
    if ours:
        numbers["earliest_of_ours"] = min(ours, key=lambda n: scores[n].first_detection or 0)
    return numbers
