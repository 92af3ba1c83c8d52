"""Tables 5.1 to 5.4: the run time of each method, stage by stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tokt.features.common.errors import FrameError
from tokt.features.common.machine import machine
from tokt.features.frames.mission import LEFT, RIGHT
from tokt.studies.baselines.thesis_stereo import THESIS_FRAME_SIZE
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.speed.paired_timing import single_thread
from tokt.studies.thesis.methods.mission_models import SLIC
from tokt.studies.thesis.methods.stage_clock import (
    STAGES,
    EncodedPair,
    Float,
    StageTimes,
    TimedMethod,
    slic_texture,
    thesis_disparity,
    thesis_model_with_kernels,
    thesis_texture,
    time_stages,
    tokt_stereo,
    tokt_texture,
)

from .exhibit import NOT_KNOWN, Claim, ClaimAgreement, Exhibit, Plot, StudyContext, Table
from .frame_drawing import new_figure, png_of

SPREAD = (10, 90)
PRINTED = {"slic_lbp_10_5": 19.7, "disparity": 1.19, "haralick": 1.726}
"""Times the run time of LBP: our reading of the thesis's three ratios, the only ones at hand."""
NEAR, TWICE = 1.25, 2.0
"""A ratio within a quarter of the printed one agrees; within twice it agrees in part."""
REFERENCE = "lbp_10_5"
_TABLES = {
    "slic_lbp_10_5": ("table_5_1_slic_lbp", "Table 5.1: SLIC + LBP"),
    "lbp_10_5": ("table_5_2_lbp", "Table 5.2: LBP"),
    "disparity": ("table_5_3_disparity", "Table 5.3: disparity"),
    "haralick": ("table_5_4_haralick", "Table 5.4: Haralick"),
}
"""Which table is of which method is the order of the project's task: a reading, too."""

Found = dict[str, StageTimes]
"""By key of the method."""


def runtime_tables(context: StudyContext) -> Exhibit:
    """Time the thesis's methods and ours on the same frames, in turns, in this one run."""
    with single_thread():
        methods = methods_of(context)
        frames = _frames(context)
        measured = time_stages(methods, frames, context.progress)
    found = {one.method.key: one for one in measured}
    summary = _summary(found)
    return Exhibit(
        _words(context, frames),
        tuple(_claims(found)),
        tuple(_tables(found, summary, len(frames))),
        (
            Plot(
                "run_times",
                "Median time of each stage, in ms, on one thread.",
                png_of(_chart(found)),
            ),
        ),
        _numbers(found, summary, len(frames)),
    )


def methods_of(context: StudyContext) -> list[TimedMethod]:
    """All methods that can judge this mission's frames."""
    slic = context.superpixel_methods.textures
    titles = [context.thesis[name].title for name in SLIC]
    methods = [slic_texture(one, title) for one, title in zip(slic, titles, strict=True)]
    methods += [thesis_texture(model) for model in context.thesis.values()]
    size = context.any_left().shape[1::-1]
    if context.pairs and size == THESIS_FRAME_SIZE:
        methods.append(thesis_disparity())
    methods += [thesis_model_with_kernels(model) for model in context.thesis.values()]
    own, _ = context.tokt_model
    if own.grid == GRID:
        methods.append(tokt_texture(own.extractor, own.model))
    if context.calibration is not None:
        methods.append(tokt_stereo(context.calibration))
    return methods


def _frames(context: StudyContext) -> list[EncodedPair]:
    """Encoded frames spread over the mission; pairs where it has pairs."""
    numbers = context.spread()
    if context.pairs:
        both = set(context.pairs)
        numbers = [number for number in numbers if number in both] or context.pairs[:1]
    found = []
    for number in numbers:
        try:
            context.left(number)
        except FrameError:
            continue
        right = context.mission.encoded(number, RIGHT)[0] if context.pairs else None
        if context.pairs and context.right(number) is None:
            continue
        found.append(EncodedPair(number, context.mission.encoded(number, LEFT)[0], right))
    if not found:
        raise FrameError("none of the frames chosen for the run times can be read")
    return found


def _words(context: StudyContext, frames: Sequence[EncodedPair]) -> tuple[str, ...]:
    _, own = context.tokt_model
    seen = ", ".join(str(frame.number) for frame in frames)
    about = machine()
    return (
        f"Every method judges the same {len(frames)} frames ({seen}), once each, in turns, in "
        "one run on one thread, from the bytes of the image file to the verdict: processor time, "
        "which on an idle machine is the time that passes. Medians, with the 10th and 90th "
        "percentile of the single runs. For SLIC, the thesis's disparity and tokt's stereo the "
        "parts of one call are split by doing them once more, outside the total.",
        "The thesis's methods are its settings with today's scikit-image, mahotas, OpenCV and "
        "scikit-learn. The rows of tokt's kernels judge with the very weights of the thesis's "
        f"models. tokt texture is {own}. Times do not depend on what a model learnt.",
        "Of the thesis's tables only the ratios 19.7, 1.19 and 1.726 are at hand, in the order "
        "SLIC + LBP, disparity, Haralick; their seconds are not. That the ratios are times the run "
        "time of LBP, and which table is of which method, is our reading.",
        f"Machine: {about['cpu']}, Python {about['python']}.",
    )


def _ratio(found: Found, key: str, to: str = REFERENCE) -> Float:
    """A method's time over another's, run by run: both of the same frame."""
    return found[key].total_ms / found[to].total_ms


def _middle(values: Float) -> tuple[float, float, float]:
    """Median, 10th and 90th percentile."""
    low, high = np.percentile(values, SPREAD)
    return float(np.median(values)), float(low), float(high)


def _summary(found: Found) -> pd.DataFrame:
    """By key: milliseconds, and times the run time of the thesis's LBP, with their spread."""
    rows = {
        key: [
            one.method.title,
            one.method.kind,
            *_middle(one.total_ms),
            *_middle(_ratio(found, key)),
        ]
        for key, one in found.items()
    }
    figures = [f"{name}{end}" for name in ("ms", "times_lbp") for end in ("", "_p10", "_p90")]
    return pd.DataFrame.from_dict(rows, orient="index", columns=["method", "whose", *figures])


def _tables(found: Found, summary: pd.DataFrame, n_frames: int) -> list[Table]:
    words = ["method", "whose", "median ms", "p10 ms", "p90 ms", "times LBP", "p10", "p90"]
    compared = Table(
        "run_times",
        f"From an image file's bytes to a verdict: {n_frames} frames, once each, one thread; "
        "ms a frame (a pair for the disparities), and times the run time of the thesis's LBP on "
        "the same frame in the same round. Median, 10th and 90th percentile.",
        summary.set_axis(words, axis=1).assign(printed=pd.Series(PRINTED)),
    )
    by_stage = pd.DataFrame([one.stage_ms for one in found.values()])
    by_stage.insert(0, "method", summary["method"].to_numpy())
    stages = Table(
        "run_times_by_stage",
        "Median ms of each stage. Undistort is rectification in tokt's stereo; contours is all "
        "that is left: masks, outlines, the verdict, and in tokt's rows its checks of the frame.",
        by_stage,
    )
    own = [
        Table(
            name,
            f"{found[key].method.title}: profile of one frame, ms.",
            _profile(found[key]),
            title,
        )
        for key, (name, title) in _TABLES.items()
        if key in found
    ]
    return [*own, compared, stages]


def _profile(one: StageTimes) -> pd.DataFrame:
    """The stages that a method has: median ms, spread, and the part of the whole."""
    whole = one.seconds.sum(axis=1)
    rows = [
        [stage, *_middle(seconds * 1e3), float(np.median(seconds / whole))]
        for stage, seconds in zip(STAGES, one.seconds.T, strict=True)
        if seconds.any()
    ]
    rows.append(["whole frame", *_middle(one.total_ms), 1.0])
    columns = ["stage", "median ms", "p10 ms", "p90 ms", "part of the whole"]
    return pd.DataFrame(rows, columns=columns)


def _claims(found: Found) -> list[Claim]:
    claims = []
    for key, what in (
        ("slic_lbp_10_5", "SLIC + LBP takes so many times as long as LBP on patches"),
        ("disparity", "disparity takes so many times as long as LBP"),
        ("haralick", "Haralick takes so many times as long as LBP"),
    ):
        printed = f"{PRINTED[key]:g} (tables 5.1 to 5.4; that it is times LBP is our reading)"
        claims.append(_claim(found, key, what, printed))
    claims.append(_grid_claim(found))
    return claims


def agreement_of(ratio: float, printed: float) -> ClaimAgreement:
    """Agreement of a ratio with a printed one: see `NEAR` and `TWICE`."""
    off = max(ratio / printed, printed / ratio)
    if off <= NEAR:
        return ClaimAgreement.YES
    return ClaimAgreement.PARTLY if off <= TWICE else ClaimAgreement.NO


def _claim(found: Found, key: str, what: str, printed: str) -> Claim:
    if key not in found:
        why = (
            "the thesis's disparity is for pairs of "
            f"{'x'.join(map(str, THESIS_FRAME_SIZE))}, which this mission does not have"
        )
        return Claim(what, printed, "not measured", ClaimAgreement.UNCOMPARABLE, why)
    ratio, low, high = _middle(_ratio(found, key))
    agreement = agreement_of(ratio, PRINTED[key])
    why = f"judged by the median: {_judged_words(agreement)}; {_reason(found, key, agreement)}"
    return Claim(what, printed, f"{ratio:.3g} ({low:.3g} to {high:.3g})", agreement, why)


def _judged_words(agreement: ClaimAgreement) -> str:
    return {
        ClaimAgreement.YES: "within a quarter of the printed ratio",
        ClaimAgreement.PARTLY: "within twice the printed ratio, but not within a quarter",
    }.get(agreement, "more than twice off the printed ratio")


def _reason(found: Found, key: str, agreement: ClaimAgreement) -> str:
    """What stands behind a ratio that is not the printed one, from what was measured."""
    if agreement is ClaimAgreement.YES:
        return "other libraries and another machine, the same proportion"
    one, lbp = found[key], found[REFERENCE]
    own, base = one.stage_ms, lbp.stage_ms
    largest = own.idxmax()
    return (
        f"the libraries of 2016 are not these: here the largest stage is {largest} with "
        f"{own[largest]:.1f} of {np.median(one.total_ms):.1f} ms, and LBP on patches takes "
        f"{np.median(lbp.total_ms):.1f} ms, {base['features']:.1f} of them features and "
        f"{base['predict']:.1f} its 100 predict calls"
    )


def _grid_claim(found: Found) -> Claim:
    ratio, low, high = _middle(_ratio(found, "slic_haralick", "haralick"))
    faster = (
        ClaimAgreement.YES if low > 1 else ClaimAgreement.PARTLY if ratio > 1 else ClaimAgreement.NO
    )
    return Claim(
        "10x10 patches instead of superpixels make the Haralick method faster",
        f"much faster (a remark in the author's program; the number is {NOT_KNOWN})",
        f"{ratio:.3g} times ({low:.3g} to {high:.3g})",
        faster,
        "agrees where even the 10th percentile of single runs is above 1",
    )


def _numbers(found: Found, summary: pd.DataFrame, n_frames: int) -> dict[str, Any]:
    numbers: dict[str, Any] = {"frames": n_frames, "rounds": 1}
    for key, row in summary.drop(columns=["method", "whose"]).iterrows():
        numbers |= {f"{key}_{name}": value for name, value in row.items()}
    for name in ("lbp_10_5", "lbp_24_8", "haralick"):
        theirs, ours = found[name].verdicts, found[f"tokt_{name}"].verdicts
        same = sum(
            (a.status, a.mean, a.box) == (b.status, b.mean, b.box)
            for a, b in zip(theirs, ours, strict=True)
        )
        numbers[f"tokt_{name}_same_verdicts"] = same
        numbers[f"{name}_times_tokt_kernels"] = _middle(_ratio(found, name, f"tokt_{name}"))[0]
    return numbers


def _chart(found: Found) -> Figure:
    """Stacked bars of the stages' medians."""
    figure, axes = new_figure(10, 0.5 + 0.42 * len(found))
    stages = pd.DataFrame({one.method.title: one.stage_ms for one in found.values()})
    left = np.zeros(len(found))
    for place, (stage, width) in enumerate(stages.iterrows()):
        axes.barh(stages.columns, width, left=left, label=stage, color=f"C{place}")
        left += width.to_numpy()
    for at, (total, one) in enumerate(zip(left, found.values(), strict=True)):
        axes.text(total, at, f" {np.median(one.total_ms):.1f}", va="center", fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("ms a frame, median")
    axes.margins(x=0.08)
    axes.legend(fontsize=8, ncols=4, loc="lower right")
    return figure
