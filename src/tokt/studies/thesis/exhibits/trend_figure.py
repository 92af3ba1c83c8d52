r"""The trend and the time to contact from expansion, against stereo depth on the same frames.

::

    mean   . . o o O   trend: growing, steady or shrinking      A ~ 1 / Z**2 for a thing wholly in
           .           (`temporal_cues.py`)                    view, so a mean that changes by s a
    depth  o o o .     slope of the same last seconds,          second goes with a depth that
           ---------   by Theil and Sen                         changes by -s / 2
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.stats import spearmanr, theilslopes

from tokt.features.common.arrays import F64, Bools
from tokt.features.common.errors import FrameError, ToktError
from tokt.inference.frame import Frame
from tokt.inference.policy.assembly import StereoSetup
from tokt.inference.policy.temporal_cues import (
    GROWING,
    HORIZON_S,
    MIN_SLOTS,
    MIN_SPAN_S,
    SHRINKING,
    STEADY,
    STEADY_PER_S,
    TrendEstimator,
    wholly_in_view,
)
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.verdict import STATUS_MEAN_THRESHOLD, UNKNOWN, verdict_from_mask
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.methods.curves import Curves
from tokt.studies.thesis.methods.mission_models import TOKT_TEXTURE

from .curve_figures import agreement_of_worst
from .exhibit import LEARNT_ELSEWHERE, Claim, ClaimAgreement, Exhibit, Plot, StudyContext, Table
from .frame_drawing import new_figure, png_of

SECONDS_A_FRAME = 0.35
"""The frames carry no times. Source: the pause of AURlabCVsimulator, which it says is the real
mission's."""
DISPARITY = "disparity"
MIN_FRAMES = 12
_SPREAD = (10, 50, 90)
_COLORS = {GROWING: "#c0392b", STEADY: "#4a8f4a", SHRINKING: "#2d6cb3", None: "0.75"}
_COLOR_WORDS = ("growing: comes nearer", "steady", "shrinking: goes away", "none")
MOVING = (GROWING, SHRINKING)
_MIN_RANKED = 5

Scores = dict[str, dict[str, Any]]
Held = dict[str, pd.DataFrame]


def trend_exhibit(context: StudyContext) -> Exhibit:
    """The exhibit of the trend; needs stereo depth of successive frames."""
    calibration, curves = context.needed_calibration(), context.curves
    measured = curves.distance_m.dropna().index
    frames = [n for n in context.pairs if len(measured) and measured.min() <= n <= measured.max()]
    if len(frames) < MIN_FRAMES:
        raise ToktError(f"needs {MIN_FRAMES} successive pairs with something that stereo sees")
    by_stereo, depth_m = means_of_stereo(context, calibration, frames)
    texture = [name for name in (TOKT_TEXTURE, *context.thesis) if name in curves.patches]
    seen = {name: means_of_patches(curves, name, frames) for name in texture}
    seen[DISPARITY] = by_stereo
    titles = {name: curves.methods[name].title for name in texture}
    titles[DISPARITY] = "tokt stereo"
    held = {name: trend_against_depth(one, depth_m) for name, one in seen.items()}
    scores = {name: score(one) for name, one in held.items()}
    return Exhibit(
        words=_words(context, frames, texture),
        claims=(_distance_claim(scores, titles), _sign_claim(scores, titles)),
        tables=(_score_table(held, titles),),
        plots=(
            Plot(
                "trend",
                "Above: median stereo depth, coloured by what it does. Below: the mean value of "
                "each method, coloured by the trend that is said of it; gray: none is said.",
                png_of(_trend_figure(held, titles)),
            ),
        ),
    )


def means_of_patches(curves: Curves, name: str, frames: Sequence[int]) -> pd.DataFrame:
    """Means of a texture method's curve by frame, and whether what it saw is wholly in view.

    A frame that it did not judge has no mean.
    """
    patches = curves.patches[name]
    mean = curves.mean[name].where(curves.status[name] != UNKNOWN).reindex(frames)
    whole = [number in patches and _whole(patches[number]) for number in frames]
    index = pd.Index(frames, name="frame")
    return pd.DataFrame({"mean": mean, "whole": np.isfinite(mean) & np.array(whole)}, index)


def _whole(patches: Bools) -> bool:
    """Whether the patches lie wholly in the picture, at any of the grid's sizes."""
    height, width = GRID.rows * 27, GRID.cols * 36
    return wholly_in_view(verdict_from_mask(GRID.paint(patches, height, width), "texture"))


def means_of_stereo(
    context: StudyContext, calibration: StereoCalibration, frames: Sequence[int]
) -> tuple[pd.DataFrame, dict[int, float]]:
    """The runtime's own disparity over frames in their order, as `trend_against_depth` takes it.

    The depth is the median of the matched ones.
    """
    detector = DisparityDetector(calibration, GRID)
    blind_m = StereoSetup(calibration).blind_m
    seen, depth_m = dict.fromkeys(frames, (np.nan, False)), dict.fromkeys(frames, np.nan)
    for number in context.progress(frames, len(frames), "trend: stereo"):
        detection, matches = detector.observe(_pair(context, number))
        if detection.mask is None:
            continue
        verdict = verdict_from_mask(detection.mask, "disparity", distance_m=detection.distance_m)
        seen[number] = float(verdict.mean or 0.0), wholly_in_view(verdict, blind_m)
        if matches is not None and matches.valid.any():
            depth_m[number] = float(np.median(detector.depth_m(matches)[matches.valid]))
    means = pd.DataFrame.from_dict(seen, orient="index", columns=["mean", "whole"])
    return means.rename_axis("frame"), depth_m


def _pair(context: StudyContext, number: int) -> Frame:
    """A pair, without the pictures that cannot be read."""
    try:
        return Frame(number, float(number), context.left(number), context.right(number))
    except FrameError:
        return Frame(number, float(number), None, None)


def trend_against_depth(
    seen: pd.DataFrame, depth_m: dict[int, float], seconds_a_frame: float = SECONDS_A_FRAME
) -> pd.DataFrame:
    """Follow a method's means, and hold each trend against the depth.

    Of each frame in order `seen` has the ``mean`` of the method's 0/255 mask, nan where it did not
    judge, and whether what it saw lies ``whole`` in the picture; a depth is nan where nothing was
    measured. Of what is found ``trend``, ``confidence``, ``contact_s`` are as a datagram would have
    them; ``unchecked_contact_s`` would be said if the picture's edge did not matter; ``by_depth``
    and ``contact_s_by_depth`` are what they would be by the depth alone. What is not known or not
    said is missing.
    """
    sent, unchecked = TrendEstimator(), TrendEstimator()
    times = seen.index.to_numpy() * seconds_a_frame
    depths = np.array([depth_m.get(number, np.nan) for number in seen.index])
    rows = []
    for place, (t_s, value, whole) in enumerate(zip(times, seen["mean"], seen.whole, strict=True)):
        mean = float(value) if np.isfinite(value) else None
        ignored = unchecked.add(float(t_s), mean, True).contact_s
        true = depth_trend(times[: place + 1], depths[: place + 1]) or (None, None)
        rows.append((*sent.add(float(t_s), mean, bool(whole)), ignored, *true))
    numbers = ("confidence", "contact_s", "unchecked_contact_s", "contact_s_by_depth")
    columns = ["trend", *numbers[:3], "by_depth", numbers[3]]
    held = pd.DataFrame(rows, seen.index, columns, dtype=object)
    return held.astype(dict.fromkeys(numbers, float)).assign(mean=seen["mean"], depth_m=depths)


def depth_trend(times_s: F64, depths_m: F64) -> tuple[str, float | None] | None:
    """How the depth changes at the last of some times, over the seconds that a trend looks at.

    What the mean would do, one of `TRENDS`, and the depth over its closing speed in seconds, where
    it falls. None where the last depth is not known, or too few before it are.
    """
    if not len(depths_m) or not np.isfinite(depths_m[-1]):
        return None
    used = np.isfinite(depths_m) & (times_s > times_s[-1] - HORIZON_S)
    t, z = times_s[used] - times_s[-1], depths_m[used]
    if len(z) < MIN_SLOTS or -t[0] < MIN_SPAN_S:
        return None
    line = theilslopes(z, t)
    slope, now = float(line.slope), float(line.intercept)
    of_the_mean = -2 * slope / now
    if of_the_mean > STEADY_PER_S:
        return GROWING, -now / slope
    return (SHRINKING if of_the_mean < -STEADY_PER_S else STEADY), None


def _asked(held: pd.DataFrame) -> pd.DataFrame:
    """Frames in which something is seen (without, no trend is asked for) and the truth is known."""
    return held[(held["mean"] > STATUS_MEAN_THRESHOLD) & held.by_depth.notna()]


def score(held: pd.DataFrame) -> dict[str, float | int | None]:
    """Sum the comparison up.

    asked, said : int
        Frames in which something is seen and the depth's change is known; those with a trend.
    same_sign, opposite_sign : int
        Of those in which depth changes and the trend is growing or shrinking.
    sign_agreement : float or None
        Share of the frames with a sign in both whose signs are the same.
    missed_approach : int
        Frames in which the thing comes nearer and *steady* or *shrinking* is said.
    rank_correlation : float or None
        Spearman's, of mean and depth: -1 would be a relative distance.
    """
    asked = _asked(held)
    signed = asked[asked.by_depth.isin(MOVING) & asked.trend.isin(MOVING)]
    same = int((signed.by_depth == signed.trend).sum())
    missed = (asked.by_depth == GROWING) & asked.trend.isin((STEADY, SHRINKING))
    return {
        "asked": len(asked),
        "said": int(asked.trend.notna().sum()),
        "same_sign": same,
        "opposite_sign": len(signed) - same,
        "sign_agreement": same / len(signed) if len(signed) else None,
        "missed_approach": int(missed.sum()),
        "rank_correlation": _ranks(held),
    }


def _ranks(held: pd.DataFrame) -> float | None:
    both = held[(held["mean"] > STATUS_MEAN_THRESHOLD) & np.isfinite(held.depth_m)]
    if len(both) < _MIN_RANKED or both["mean"].nunique() < 2:
        return None
    return float(spearmanr(both["mean"], both.depth_m).statistic)


def contact_ratios(held: pd.DataFrame, unchecked: bool = False) -> pd.Series:
    """Time to contact from expansion over that of the depth, where both are known.

    Unchecked it is as if the picture's edge did not matter.
    """
    said = held.unchecked_contact_s if unchecked else held.contact_s
    return (said / held.contact_s_by_depth).dropna()


def _words(context: StudyContext, frames: Sequence[int], texture: Sequence[str]) -> tuple[str, ...]:
    return (
        f"Frames {frames[0]} to {frames[-1]}, from the first to the last that stereo sees "
        f"something in. The trend is the runtime's ({HORIZON_S:g} s of means). The frames carry no "
        f"times: {SECONDS_A_FRAME} s are taken from frame to frame. Cameras: "
        f"{context.calibration_words}.",
        "What is right is the slope of the median stereo depth over the same seconds. A mean goes "
        "with 1 / depth squared: a depth that changes by less than "
        f"{STEADY_PER_S / 2:g} of itself a second counts as steady. At the turn, both slopes still "
        "say for some frames what was so before. That delay is in neither figure.",
        LEARNT_ELSEWHERE if texture else "No texture method judged these frames.",
        "Where it fails: the mean is an area. A thing that leaves the picture, or is too near for "
        "stereo, shrinks while it comes nearer. What a model first learns to see grows while it "
        "stands still. A time to contact is therefore only said while the whole thing is in the "
        "picture. The ratios with the edge ignored are without that check.",
    )


def _distance_claim(scores: Scores, titles: Mapping[str, str]) -> Claim:
    ranks = {name: one["rank_correlation"] for name, one in scores.items()}
    given = [value for value in ranks.values() if value is not None]
    if not given:
        agreement, why = ClaimAgreement.UNAVAILABLE, "too few frames have a mean and a depth"
    else:
        agreement = agreement_of_worst(-value for value in given)
        why = {
            ClaimAgreement.YES: "every method's mean falls with depth, nearly without fail",
            ClaimAgreement.PARTLY: "with exceptions: the picture cuts off what is near",
        }.get(agreement, "of at least one method the mean does not follow depth")
    found = "; ".join(
        f"{titles[name]} " + ("not known" if value is None else f"{value:.2f}")
        for name, value in ranks.items()
    )
    return Claim(
        "the mean value is a relative distance",
        "sections 5.2.1 and 7.2",
        f"rank correlation with stereo depth (-1: it is): {found}",
        why,
        agreement=agreement,
    )


def _sign_claim(scores: Scores, titles: Mapping[str, str]) -> Claim:
    parts, signed = [], 0
    for name, one in scores.items():
        both, share = one["same_sign"] + one["opposite_sign"], one["sign_agreement"]
        told = "not known" if share is None else f"{100 * share:.0f} % of {both}"
        parts.append(f"{titles[name]} {told}, {one['missed_approach']} missed")
        signed += both
    ours = [one for name, one in scores.items() if name in (TOKT_TEXTURE, DISPARITY)]
    if not signed:
        agreement, why = ClaimAgreement.UNAVAILABLE, "no frame has a sign in both"
    else:
        agreement = agreement_of_worst(one["sign_agreement"] or 0.0 for one in ours)
        why = {
            ClaimAgreement.YES: "the sign of the trend is that of the depth's change",
            ClaimAgreement.PARTLY: "wrong where what is near leaves the picture, or is not matched",
        }.get(agreement, "too often the sign is not that of the depth's change")
    return Claim(
        "a growing mean is a thing that comes nearer",
        "sections 5.2.1 and 7.2",
        "signs that agree with the depth's, and approaches missed: " + "; ".join(parts),
        why,
        agreement=agreement,
    )


def _score_table(held: Held, titles: Mapping[str, str]) -> Table:
    rows = []
    for name, frames in held.items():
        one = {words.replace("_", " "): figure for words, figure in score(frames).items()}
        row: dict[str, Any] = {"mean of": titles[name], **one}
        for words, unchecked in (("", False), (", edge ignored", True)):
            ratios = contact_ratios(frames, unchecked)
            row[f"contacts{words}"] = len(ratios)
            for percent in _SPREAD:
                value = None if ratios.empty else round(float(np.percentile(ratios, percent)), 3)
                row[f"contact ratio {percent} %{words}"] = value
        rows.append(row)
    caption = (
        "Trend against stereo depth. Asked: something is seen and the depth's change is known. "
        "Contact ratio: time to contact from expansion over that from depth, percentiles."
    )
    return Table("trend_against_depth", caption, pd.DataFrame(rows))


def _trend_figure(held: Held, titles: Mapping[str, str]) -> Figure:
    """Depth above, a row a method below, over the frame numbers."""
    shape = {"sharex": True, "height_ratios": [1.4, *[1.0] * len(held)]}
    figure, (depth, *axes) = new_figure(10.5, 2.6 + 1.7 * len(held), 1 + len(held), 1, **shape)
    first = next(iter(held.values()))
    _dots(depth, first.depth_m, first.by_depth)
    depth.set_ylabel("depth, m")
    for one, (name, frames) in zip(axes, held.items(), strict=True):
        _dots(one, frames["mean"], frames.trend)
        one.set_ylabel(f"{titles[name]}\nmean value", fontsize=8)
    axes[-1].set_xlabel("frame")
    handles = [
        Line2D([], [], marker="o", ls="", color=color, label=words)
        for color, words in zip(_COLORS.values(), _COLOR_WORDS, strict=True)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure


def _dots(axes: Any, values: pd.Series, trends: pd.Series) -> None:
    axes.plot(values.index, values, color="0.8", lw=0.8, zorder=1)
    colors = [_COLORS[trend] for trend in trends]
    axes.scatter(values.index, values, c=colors, s=14, linewidths=0, zorder=2)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_ylim(bottom=0)
