"""The trend and the time to contact from expansion, against stereo depth on the same frames.

An area goes with 1 / depth squared while a thing is wholly in view: a mean that changes by s a
second goes with a depth that changes by -s / 2. The depth's slope is that of the same last seconds,
by Theil and Sen.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.stats import theilslopes

from tokt.features.common.arrays import F64, Bools
from tokt.features.common.errors import FrameError, ToktError
from tokt.inference.frame import Frame
from tokt.inference.policy import temporal_cues as cues
from tokt.inference.policy.assembly import StereoSetup
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.verdict import STATUS_MEAN_THRESHOLD, UNKNOWN, verdict_from_mask
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.thesis.methods.curves import OURS, Curves
from tokt_studies.thesis.methods.mission_models import TOKT_TEXTURE

from .curve_figures import WORST_RULE, agreement_of_worst
from .exhibit import LEARNT_ELSEWHERE, Claim, Exhibit, Plot, StudyContext, Table
from .frame_drawing import new_figure, png_of

SECONDS_A_FRAME = 0.35
"""The frames carry no times. Source: the pause of AURlabCVsimulator, which it says is the real
mission's."""
STEREO = "tokt stereo"
MIN_FRAMES = 12
_SPREAD = (10, 50, 90)
_COLORS = {cues.GROWING: "#c0392b", cues.STEADY: "#4a8f4a", cues.SHRINKING: "#2d6cb3", None: "0.75"}
_COLOR_WORDS = ("growing: comes nearer", "steady", "shrinking: goes away", "none")
MOVING = (cues.GROWING, cues.SHRINKING)
_MIN_RANKED = 5

Held = Mapping[str, pd.DataFrame]
"""By a method's title, its means against the depth."""


def trend_exhibit(context: StudyContext) -> Exhibit:
    """The exhibit of the trend; needs stereo depth of successive frames."""
    calibration, curves = context.needed_calibration(), context.curves
    measured = curves.distance_m.dropna().index
    frames = [n for n in context.pairs if len(measured) and measured.min() <= n <= measured.max()]
    if len(frames) < MIN_FRAMES:
        raise ToktError(f"needs {MIN_FRAMES} successive pairs with something that stereo sees")
    by_stereo, depth_m = means_of_stereo(context, calibration, frames)
    texture = [name for name in (TOKT_TEXTURE, *context.thesis) if name in curves.patches]
    whose = {curves.methods[name].title: curves.methods[name].kind for name in texture}
    whose[STEREO] = OURS
    means = [*(means_of_patches(curves, name, frames) for name in texture), by_stereo]
    held = {
        title: trend_against_depth(mean, depth_m) for title, mean in zip(whose, means, strict=True)
    }
    scores = pd.DataFrame({title: {"whose": whose[title], **score(held[title])} for title in held})
    scores = scores.T.rename_axis("mean of")
    table = scores.rename(columns=lambda name: name.replace("_", " ")).reset_index()
    asked = (
        "Asked: something is seen, and the change of the stereo depth is known. Contact ratios: "
        "time to contact from expansion over that from depth, percentiles."
    )
    caption = (
        "Above: median stereo depth, coloured by what it does. Below: the mean value of each "
        "method, coloured by the trend that is said of it; gray: none is said."
    )
    return Exhibit(
        words=_words(context, frames, texture),
        claims=(_distance_claim(scores), _sign_claim(scores)),
        tables=(Table("trend_against_depth", asked, table),),
        plots=(Plot("trend", caption, png_of(_trend_figure(held))),),
    )


def means_of_patches(curves: Curves, name: str, frames: Sequence[int]) -> pd.DataFrame:
    """Means of a texture method's curve by frame, and whether what it saw is wholly in view.

    A frame that it did not judge has no mean.
    """
    patches = curves.patches[name]
    mean = curves.mean[name].where(curves.status[name] != UNKNOWN).reindex(frames)
    whole = [number in patches and _whole(patches[number]) for number in frames]
    return pd.DataFrame({"mean": mean, "whole": np.isfinite(mean) & np.array(whole)})


def _whole(patches: Bools) -> bool:
    """Whether the patches lie wholly in the picture, at any of the grid's sizes."""
    height, width = GRID.rows * 27, GRID.cols * 36
    return cues.wholly_in_view(verdict_from_mask(GRID.paint(patches, height, width), "texture"))


def means_of_stereo(
    context: StudyContext, calibration: StereoCalibration, frames: Sequence[int]
) -> tuple[pd.DataFrame, pd.Series]:
    """The runtime's own disparity over frames in their order, as `trend_against_depth` takes it.

    Depths are medians of the matched ones.
    """
    detector, blind_m = DisparityDetector(calibration, GRID), StereoSetup(calibration).blind_m
    depth_m = pd.Series(np.nan, pd.Index(frames, name="frame"))
    means = pd.DataFrame({"mean": depth_m, "whole": False})
    for number in context.progress(frames, len(frames), "trend: stereo"):
        detection, matches = detector.observe(_pair(context, number))
        if detection.mask is None:
            continue
        verdict = verdict_from_mask(detection.mask, "disparity", distance_m=detection.distance_m)
        means.loc[number] = verdict.mean or 0.0, cues.wholly_in_view(verdict, blind_m)
        if matches is not None and matches.valid.any():
            depth_m[number] = np.median(detector.depth_m(matches)[matches.valid])
    return means, depth_m


def _pair(context: StudyContext, number: int) -> Frame:
    """A pair, without the pictures that cannot be read."""
    try:
        return Frame(number, float(number), context.left(number), context.right(number))
    except FrameError:
        return Frame(number, float(number), None, None)


def trend_against_depth(seen: pd.DataFrame, depth_m: pd.Series) -> pd.DataFrame:
    """Follow a method's means, and hold each trend against the depth.

    By frame `seen` has the ``mean`` of the method's 0/255 mask, nan where it did not judge, and
    whether what it saw lies ``whole`` in the picture; a depth is nan where nothing was measured.
    ``trend`` and ``contact_s`` are as a datagram would have them, ``by_depth`` and
    ``contact_s_by_depth`` what they would be by the depth alone. What is not known is missing.
    """
    held = seen.assign(depth_m=depth_m.reindex(seen.index))
    times, depths = held.index.to_numpy() * SECONDS_A_FRAME, held.depth_m.to_numpy()
    estimator, rows = cues.TrendEstimator(), []
    for place, (t_s, one) in enumerate(zip(times, seen.itertuples(), strict=True), 1):
        mean = float(one.mean) if np.isfinite(one.mean) else None
        said = estimator.add(float(t_s), mean, bool(one.whole))
        rows.append((said.trend, said.contact_s, *depth_trend(times[:place], depths[:place])))
    columns = ["trend", "contact_s", "by_depth", "contact_s_by_depth"]
    return held.join(pd.DataFrame(rows, held.index, columns, dtype=object))


def depth_trend(times_s: F64, depths_m: F64) -> tuple[str | None, float | None]:
    """What the mean should do at the last of some times, by the seconds that a trend looks at.

    One of `TRENDS`, None where the last depth is not known, or too few before it are; and the depth
    over its closing speed in seconds, None where it does not fall.
    """
    if not len(depths_m) or not np.isfinite(depths_m[-1]):
        return None, None
    used = np.isfinite(depths_m) & (times_s > times_s[-1] - cues.HORIZON_S)
    t, z = times_s[used] - times_s[-1], depths_m[used]
    if len(z) < cues.MIN_SLOTS or -t[0] < cues.MIN_SPAN_S:
        return None, None
    line = theilslopes(z, t)
    of_the_mean = -2 * line.slope / line.intercept
    if of_the_mean > cues.STEADY_PER_S:
        return cues.GROWING, -line.intercept / line.slope
    return cues.SHRINKING if of_the_mean < -cues.STEADY_PER_S else cues.STEADY, None


def score(held: pd.DataFrame) -> dict[str, float | int | None]:
    """Sum the comparison up: numbers of frames, and figures that may be None or nan."""
    seen = held[held["mean"] > STATUS_MEAN_THRESHOLD]
    asked = seen[seen.by_depth.notna()]
    signed = asked[asked.by_depth.isin(MOVING) & asked.trend.isin(MOVING)]
    same = int((signed.by_depth == signed.trend).sum())
    missed = (asked.by_depth == cues.GROWING) & asked.trend.isin((cues.STEADY, cues.SHRINKING))
    ratios = (held.contact_s / held.contact_s_by_depth).dropna().astype(float)
    return {
        "asked": len(asked),  # something is seen, and the depth's change is known
        "said": int(asked.trend.notna().sum()),
        "same_sign": same,  # of those in which both are growing or shrinking
        "opposite_sign": len(signed) - same,
        "sign_agreement": same / len(signed) if len(signed) else None,
        "missed_approach": int(missed.sum()),  # it comes nearer; steady or shrinking is said
        # Spearman's, of mean and depth: -1 would be a relative distance.
        "rank_correlation": _ranks(seen.dropna(subset="depth_m")),
        "contacts": len(ratios),  # with a time to contact by the mean, and by the depth
        # Percentiles of the one by the mean over the one by the depth.
        **{f"contact_ratio_{percent}": ratios.quantile(percent / 100) for percent in _SPREAD},
    }


def _ranks(seen: pd.DataFrame) -> float | None:
    if len(seen) < _MIN_RANKED or seen["mean"].nunique() < 2:
        return None
    return float(seen["mean"].corr(seen.depth_m, method="spearman"))


def _words(context: StudyContext, frames: Sequence[int], texture: Sequence[str]) -> tuple[str, ...]:
    return (
        f"Frames {frames[0]} to {frames[-1]}, from the first to the last that stereo sees "
        f"something in. They carry no times: {SECONDS_A_FRAME} s are taken from frame to frame. "
        f"Cameras: {context.calibration_words}.",
        f"The trend is the runtime's, over {cues.HORIZON_S:g} s. What is right is the slope of the "
        "median stereo depth over the same seconds; less than "
        f"{cues.STEADY_PER_S / 2:g} of the depth a second is steady.",
        LEARNT_ELSEWHERE if texture else "No texture method judged these frames.",
        "Where it fails: what leaves the picture, or is too near for stereo, shrinks while it "
        "comes nearer. A time to contact is said only while the whole thing is in the picture.",
    )


def _distance_claim(scores: pd.DataFrame) -> Claim:
    """Whether every method's mean falls as the depth grows."""
    claim = Claim.about(
        "the mean value is a relative distance", "it serves as one (sections 5.2.1 and 7.2)"
    )
    ranks = scores.rank_correlation.dropna()
    if ranks.empty:
        return claim("not known", "too few frames have a mean and a depth")
    return claim(
        "rank correlation with stereo depth (-1: it is): "
        + "; ".join(f"{title} {rank:.2f}" for title, rank in ranks.items()),
        f"by the worst, its sign turned: {WORST_RULE}. The picture cuts off what is near",
        agreement=agreement_of_worst(-ranks),
    )


def _sign_claim(scores: pd.DataFrame) -> Claim:
    """Whether the sign of the trend of tokt's methods is that of the depth's change."""
    claim = Claim.about(
        "a growing mean is a thing that comes nearer",
        "its rise or fall tells of the distance's (sections 5.2.1 and 7.2)",
    )
    signed = scores.same_sign + scores.opposite_sign
    if not signed.any():
        return claim("not known", "no frame has a sign in both")
    ours = scores[scores.whose == OURS].sign_agreement.astype(float)
    return claim(
        "signs that agree with the depth's, and approaches missed: "
        + "; ".join(
            f"{title} {one.same_sign} of {signed[title]}, {one.missed_approach} missed"
            for title, one in scores.iterrows()
        ),
        f"by the worst share of tokt's: {WORST_RULE}",
        agreement=agreement_of_worst(ours.fillna(0.0)),
    )


def _trend_figure(held: Held) -> Figure:
    """Depth above, a row a method below, over the frame numbers."""
    shape: dict[str, Any] = {"sharex": True, "height_ratios": [1.4, *[1.0] * len(held)]}
    figure, (depth, *axes) = new_figure(10.5, 2.6 + 1.7 * len(held), 1 + len(held), 1, **shape)
    first = next(iter(held.values()))
    _dots(depth, first.depth_m, first.by_depth)
    depth.set_ylabel("depth, m")
    for one, (title, frames) in zip(axes, held.items(), strict=True):
        _dots(one, frames["mean"], frames.trend)
        one.set_ylabel(f"{title}\nmean value", fontsize=8)
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
