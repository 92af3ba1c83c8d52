"""Figures 5.3 to 5.5: images along the mission, and the mean value of every method."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tokt.features.frames.mission import format_frames
from tokt.inference.verdict import OBSTACLE, STATUS_MEAN_THRESHOLD, UNKNOWN
from tokt.training.evaluation.evaluate import first_detection
from tokt.training.rig.calibrate.frame_selection import evenly_spaced
from tokt_studies.thesis.methods.curves import COMPARED, OURS, THESIS, Curves, learnt_words
from tokt_studies.thesis.patch_scores import pooled_score

from .exhibit import Claim, ClaimAgreement, Exhibit, Plot, StudyContext, Table
from .frame_drawing import SHOWN, new_figure, png_of, show_frame

MIN_FRAMES = 8
"""Of fewer frames that both curves have no correlation is told."""
NEARLY_ALWAYS, GOES_WITH = 0.95, 0.7
"""Rank correlations of mean value and nearness, or shares of equal signs, from which the one tells
the other, and from which it does so with exceptions."""
WORST_RULE = f"to agree: {NEARLY_ALWAYS} or more; in part: {GOES_WITH}"
ALIKE, SAME_RATE = 0.9, 1.5
"""Correlation of two curves from which they are very alike, and how many times as steep as the
other one may then be for their rates of change to be about the same."""
TOGETHER_FRAMES = 5
"""First detections no farther apart are together."""
_OF_THE_FIGURES = "lbp_10_5", "haralick", "disparity"
_ZOOM_BEFORE, _ZOOM_AFTER = 15, 12
FIRST, FALSE = "first detection", "false status"
"""Columns of the scores."""
_STRIP = 8
"""Frames of the image strip."""


def curve_figures(context: StudyContext) -> Exhibit:
    """Draw and score the curves of all methods."""
    scores = score_methods(context)
    firsts = {name: int(first) for name, first in scores[FIRST].dropna().items()}
    order = order_claim(dict.fromkeys(scores.index) | firsts)
    return Exhibit(
        _words(context),
        (_detection_claim(context, scores), order, alike_claim(context.curves)),
        _tables(context, scores),
        _plots(context, firsts),
    )


def score_methods(context: StudyContext) -> pd.DataFrame:
    """Score every curve: a row a method, missing what it does not have.

    A first detection is the first of three judged frames in a row with status 1. Ocean frames have
    every patch labelled, as clear; obstacle frames have a patch labelled as an obstacle. F1 is over
    all sure labels, of methods that judge patches of the grid.
    """
    curves, labelled = context.curves, context.labels is not None
    with_obstacle = [number for number, count in context.obstacle_patches.items() if count]
    rows = {}
    for name, method in curves.methods.items():
        mean, status = curves.mean[name], curves.status[name]
        if method.sampled:
            status = status[mean.notna()]
        ocean, false = _counted(status, context.ocean_frames) if labelled else (None, None)
        obstacle, detected = _counted(status, with_obstacle) if labelled else (None, None)
        patches = pooled_score(curves.patches.get(name, {}), context.truths)
        first = first_detection(status.index.tolist(), [0] * len(status), status.tolist())
        rows[name] = {
            "method": method.title,
            "whose": method.kind,
            "frames": int(mean.notna().sum()),
            FIRST: None if method.sampled else first,
            FALSE: false,
            "of ocean frames": ocean,
            "detected": detected,
            "of obstacle frames": obstacle,
            "unknown": int((status == UNKNOWN).sum()),
            "largest mean": float(mean.max()),
            "patch F1": None if patches.recall is None else patches.f1,
        }
    whole = (FIRST, FALSE, "of ocean frames", "detected", "of obstacle frames")
    return pd.DataFrame.from_dict(rows, orient="index").astype(dict.fromkeys(whole, "Int64"))


def _counted(status: pd.Series, frames: Iterable[int]) -> tuple[int, int]:
    """How many of some frames were judged, and how many of these have status 1."""
    there = status[status.index.isin(list(frames))]
    return int((there != UNKNOWN).sum()), int((there == OBSTACLE).sum())


def agreement_of_worst(shares: Iterable[float]) -> ClaimAgreement:
    """What the worst of some correlations or shares comes to."""
    worst = min(shares)
    return ClaimAgreement.of(worst >= NEARLY_ALWAYS, worst >= GOES_WITH)


def _words(context: StudyContext) -> tuple[str, ...]:
    curves = context.curves
    scored = (
        f"{len(curves.mean)} {context.request.camera} frames of {context.mission.name} are judged"
    )
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
        f"{STATUS_MEAN_THRESHOLD:g}. Growing keypoints and thirds of disparity have rules of their "
        "own. A first detection is the first of 3 frames in a row with status 1."
    )
    methods = learnt_words((method.title, method.words) for method in curves.methods.values())
    missing = [f"Left out: {why}." for why in curves.left_out]
    return (f"{scored}. {limit}", *methods, *missing)


def _tables(context: StudyContext, scores: pd.DataFrame) -> tuple[Table, ...]:
    curves = context.curves
    labels = "Ocean frames have every patch labelled, as clear." if context.labels else ""
    return (
        Table(
            "scores",
            f"What the curves come to. {labels} Patch F1 is of the grid's patches at their own "
            "threshold, over all sure labels; empty where a method has none.",
            scores,
        ),
        Table(
            "means",
            "Mean value by frame, 0 to 255; empty where a method did not judge the frame.",
            curves.mean.reset_index(),
        ),
        Table("statuses", "1, 0, or -1 where it was not judged.", curves.status.reset_index()),
    )


def _plots(context: StudyContext, firsts: Mapping[str, int]) -> tuple[Plot, ...]:
    shaded = " Gray: an obstacle is labelled; hatched: not labelled." if context.labels else ""
    words = f"Each curve as a share of its largest value; dotted: first detections.{shaded}"
    plots = [
        Plot("figure_5_3_strip", f"Frames along the mission. {SHOWN}", png_of(_strip(context))),
        Plot("figure_5_4_normalised", words, png_of(_curves(context, firsts, None, None))),
    ]
    if firsts:
        ends = min(firsts.values()) - _ZOOM_BEFORE, max(firsts.values()) + _ZOOM_AFTER
        words = "The same around the first detections."
        plots.append(Plot("figure_5_5_zoomed", words, png_of(_curves(context, firsts, *ends))))
    return tuple(plots)


def _curves(
    context: StudyContext, firsts: Mapping[str, int], begin: int | None, end: int | None
) -> Figure:
    """Figures 5.4 and 5.5: a panel a kind, each curve as a share of its largest.

    Beside them stands how near the object is. First detections are dotted.
    """
    curves, near = context.curves, 1.0 / context.curves.distance_m
    shares = curves.shares()
    kinds = [kind for kind in (THESIS, COMPARED, OURS) if curves.named(kind)]
    size = 10.5, 1.0 + 2.2 * len(kinds)
    figure, panels = new_figure(*size, len(kinds), 1, sharex=True, squeeze=False)
    for axes, kind in zip(panels[:, 0], kinds, strict=True):
        for place, name in enumerate(curves.named(kind)):
            method, color = curves.methods[name], f"C{place}"
            _draw(axes, shares[name], method.sampled, method.title, color)
            if name in firsts:
                axes.axvline(firsts[name], color=color, lw=0.8, ls=":")
        if near.notna().any():
            _draw(axes, near / near.max(), False, "1 / distance (stereo)", "black")
        axes.set(xlim=(begin, end), ylim=(0, 1.05), ylabel="share of the largest")
        axes.set_title(kind, loc="left", fontsize=9)
        _shade(axes, context.obstacle_patches, curves.mean.index)
        axes.legend(loc="upper left", fontsize=7)
    axes.set_xlabel("frame")
    return figure


def _draw(axes: Any, values: pd.Series, sampled: bool, label: str, color: str) -> None:
    """A line that breaks where frames are missing; points for a sample."""
    if sampled:
        there = values.dropna()
        axes.plot(there.index, there, "o", ms=4, color=color, label=f"{label} (sample)")
        return
    numbers = np.arange(values.index.min(), values.index.max() + 1)
    axes.plot(numbers, values.reindex(numbers), lw=1.3, color=color, label=label)


def _shade(axes: Any, labels: Mapping[int, int], every: pd.Index) -> None:
    """Gray where an obstacle is labelled, hatched where nothing is."""
    top = axes.get_ylim()[1]
    numbers = every.to_numpy()
    if labels:
        seen = np.isin(numbers, [number for number, count in labels.items() if count])
        axes.fill_between(numbers, 0, top, where=seen, color="0.9", step="mid", zorder=0)
        unknown = ~np.isin(numbers, list(labels))
        axes.fill_between(
            numbers, 0, top, where=unknown, facecolor="none", edgecolor="0.85", hatch="///",
            step="mid", zorder=0, lw=0,
        )  # fmt: skip
    axes.set_ylim(0, top)


def _strip(context: StudyContext) -> Figure:
    """Figure 5.3: the vehicle comes nearer, and goes back."""
    numbers = evenly_spaced(context.curves.mean.index.tolist(), _STRIP)
    figure, axes = new_figure(10.5, 1.6, 1, len(numbers), squeeze=False)
    for panel, number in zip(axes[0], numbers, strict=True):
        show_frame(panel, context.picture(number))
        panel.set_title(str(number), fontsize=8)
    return figure


def _detection_claim(context: StudyContext, scores: pd.DataFrame) -> Claim:
    """Cameras can be used: each method warns before the nearest approach, without false status."""
    claim = Claim.about(
        "Cameras can be used for underwater obstacle avoidance",
        "said in the abstract, from the sea trial",
    )
    names = [name for name, method in context.curves.methods.items() if not method.sampled]
    if not context.labels or not any(context.obstacle_patches.values()):
        why = "no obstacle is labelled in this mission, so nothing says what a detection is"
        return claim("not measured", why)
    nearest = max(context.obstacle_patches, key=lambda number: context.obstacle_patches[number])
    warns = (scores[FIRST] < nearest).fillna(False) & (scores[FALSE] == 0)
    good = [name for name in names if warns[name]]
    found = (
        f"{len(good)} of {len(names)} methods warn before frame {nearest}, the nearest, and in no "
        "ocean frame"
    )
    agreement = ClaimAgreement.of(len(good) == len(names), bool(good))
    why = "by this mission alone; not: " + (
        ", ".join(context.curves.methods[n].title for n in names if n not in good) or "none"
    )
    return claim(found, why, agreement=agreement)


def order_claim(firsts: Mapping[str, int | None]) -> Claim:
    """Sections 6.2 and 7.1: which method sees the obstacle first; None for one that never does."""
    claim = Claim.about(
        "Haralick sees the obstacle first, LBP and disparity together",
        "Haralick a few images before LBP (sections 6.2 and 7.1; 5.2.1 says at the same time)",
    )
    seen = [firsts[name] for name in _OF_THE_FIGURES if name in firsts]
    if len(seen) < len(_OF_THE_FIGURES) or set(seen) == {None}:
        return claim("not measured", "it needs all three methods, and a detection by one")
    lbp, haralick, disparity = (np.inf if one is None else one for one in seen)
    first, together = haralick < min(lbp, disparity), abs(lbp - disparity) <= TOGETHER_FRAMES
    said = ("never" if one is None else one for one in seen)
    return claim(
        "first detections: LBP (10, 5) {}, Haralick {}, disparity {}".format(*said),
        f"together: {TOGETHER_FRAMES} frames apart at most; in part: Haralick's place alone. "
        "Another image than the film still moves LBP's and Haralick's",
        agreement=ClaimAgreement.of(first and together, first),
    )


def alike_claim(curves: Curves) -> Claim:
    """Section 5.2.1: the curves are very alike, and change at about the same rate."""
    claim = Claim.about(
        "The curves of LBP, Haralick and disparity are very alike and rise at the same rate",
        "figures 5.4 and 5.5, each curve's largest value 1 (section 5.2.1)",
    )
    there = [name for name in _OF_THE_FIGURES if name in curves.mean]
    shares = curves.shares()[there].dropna()
    if len(there) < len(_OF_THE_FIGURES) or len(shares) < MIN_FRAMES or not shares.max().all():
        return claim("not measured", "it needs the three methods' curves")
    alike = float(shares.corr().to_numpy().min())
    rates = {name: steepest(shares[name]) for name in there}
    times = max(rates.values()) / max(min(rates.values()), 1e-9)
    return claim(
        f"least correlation of two {alike:.2f}; the steepest rises {times:.1f} times as fast",
        f"to agree: {ALIKE:g} or more, {SAME_RATE:g} times or less; in part: {GOES_WITH:g} or more",
        agreement=ClaimAgreement.of(alike >= ALIKE and times <= SAME_RATE, alike >= GOES_WITH),
    )


def steepest(shares: pd.Series) -> float:
    """The mean rise a frame of a curve's shares, from a tenth of its largest to that."""
    top = int(np.argmax(shares))
    low = np.flatnonzero(shares.to_numpy()[: top + 1] <= 0.1)
    begin = int(low[-1]) if len(low) else 0
    return float((shares.iloc[top] - shares.iloc[begin]) / max(top - begin, 1))
