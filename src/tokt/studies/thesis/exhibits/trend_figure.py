"""The trend and the time to contact from expansion, against stereo depth on the same frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from tokt.inference.policy.temporal_cues import HORIZON_S, STEADY_PER_S, TRENDS
from tokt.studies.thesis.context import StudyContext
from tokt.studies.thesis.exhibit import Claim, ClaimAgreement, Exhibit, Plot, Table
from tokt.studies.thesis.methods.held_out_texture import TOKT_TEXTURE
from tokt.studies.thesis.methods.trend_scores import (
    TrendAgainstDepth,
    TrendScore,
    confusion,
    score,
    trend_against_depth,
)

from .curve_scores import agreement_with_distance
from .trend_inputs import means_of_patches, means_of_stereo
from .trend_plots import confusion_png, contact_png, trend_png

KEY = "trend"
TITLE = "Mean value over time: relative distance, trend and time to contact"
SECTION = "sections 5.2.1 and 7.2"
SECONDS_A_FRAME = 0.35
"""The frames carry no times. Source: the pause of AURlabCVsimulator, which it says is the real
mission's."""
OTHER_RATES_S = (0.25, 0.5)
"""Tried beside it, as a trend looks at seconds and not at frames."""
DISPARITY = "disparity"
MIN_FRAMES = 12
_AGREES, _PARTLY = 0.95, 0.7
_FAR_OFF = 1.5
_SPREAD = (10, 50, 90)


def trend_exhibit(context: StudyContext) -> Exhibit:
    """The exhibit of the trend; needs stereo depth of successive frames."""
    calibration = context.calibration
    if calibration is None:
        return _missing(f"a calibration of the two cameras: {context.calibration_words}")
    curves = context.curves
    known = curves.distance_m.dropna().index
    frames = [n for n in context.pairs if len(known) and known.min() <= n <= known.max()]
    if len(frames) < MIN_FRAMES:
        return _missing(f"{MIN_FRAMES} successive pairs with something that stereo sees")
    by_stereo, depth_m = means_of_stereo(context, calibration, frames)
    texture = [name for name in (TOKT_TEXTURE, *context.thesis) if name in curves.patches]
    seen = {name: means_of_patches(curves, name, frames) for name in texture}
    seen[DISPARITY] = by_stereo
    titles = {name: curves.methods[name].title for name in texture}
    titles[DISPARITY] = "tokt stereo"
    held = {name: trend_against_depth(one, depth_m, SECONDS_A_FRAME) for name, one in seen.items()}
    scores = {name: score(one) for name, one in held.items()}
    rates = {
        (name, rate): score(trend_against_depth(one, depth_m, rate))
        for name, one in seen.items()
        for rate in OTHER_RATES_S
    }
    rates |= {(name, SECONDS_A_FRAME): one for name, one in scores.items()}
    ours = [name for name in (TOKT_TEXTURE, DISPARITY) if name in scores] or [DISPARITY]
    return Exhibit(
        KEY,
        TITLE,
        SECTION,
        words=_words(context, frames, texture),
        claims=(_distance_claim(scores, titles), _sign_claim(scores, titles, ours),
                _contact_claim(scores, titles)),
        tables=(_score_table(rates, titles), _confusion_table(held, titles), _frame_table(held)),
        plots=_plots(held, titles),
        numbers=_numbers(scores, len(frames)),
    )  # fmt: skip


def _missing(what: str) -> Exhibit:
    return Exhibit(KEY, TITLE, SECTION, missing=f"needs {what}")


def _words(context: StudyContext, frames: Sequence[int], texture: Sequence[str]) -> tuple[str, ...]:
    curves = context.curves
    learnt = "; ".join(
        f"{curves.methods[name].title}: {curves.words[name].rstrip('.')}" for name in texture
    )
    return (
        f"Frames {frames[0]} to {frames[-1]}, from the first to the last that stereo sees "
        f"something in. The trend is the runtime's ({HORIZON_S:g} s of means), with "
        f"{SECONDS_A_FRAME} s from frame to frame; the frames carry no times, so that other "
        "steps are in the table. What is right is the slope of the median stereo depth over the "
        f"same seconds: a mean goes with 1 / depth squared, so that a depth that changes by less "
        f"than {STEADY_PER_S / 2:g} of itself a second counts as steady. Cameras: "
        f"{context.calibration_words}. The depth has no part in the texture's trend; the "
        "disparity's trend is of the area that is matched, not of how far it is.",
        "Both slopes are of the last seconds: at the turn, both still say for some frames what was "
        "so before. That delay is in neither figure.",
        f"How the methods learnt: {learnt or 'no texture method judged these frames'}.",
        "Where it fails: the mean is an area. What leaves the picture at its edge, or comes so "
        "near that stereo no longer matches it, shrinks while it comes nearer; what a model first "
        "learns to see grows while it stands still. A time to contact is therefore only said "
        "while the whole thing is in the picture; the second figure of ratios is what would have "
        "been said otherwise.",
    )


def _spread_words(ratios: Sequence[float]) -> str:
    if not ratios:
        return "never said"
    low, middle, high = np.percentile(ratios, _SPREAD)
    return f"{middle:.2f} (10 to 90 %: {low:.2f} to {high:.2f}; {len(ratios)} frames)"


def _per_cent(value: float | None) -> str:
    return "not known" if value is None else f"{100 * value:.0f} %"


def _distance_claim(scores: dict[str, TrendScore], titles: dict[str, str]) -> Claim:
    ranks = {name: one.rank_correlation for name, one in scores.items()}
    known = [value for value in ranks.values() if value is not None]
    if not known:
        agreement, why = ClaimAgreement.UNCOMPARABLE, "too few frames have a mean and a depth"
    else:
        agreement = agreement_with_distance(-value for value in known)
        why = {
            ClaimAgreement.YES: "every method's mean falls with depth, nearly without fail",
            ClaimAgreement.PARTLY: "the nearer, the larger, with exceptions: what is near is cut "
            "off by the picture",
        }.get(agreement, "of at least one method the mean does not follow depth")
    found = "; ".join(
        f"{titles[name]} " + ("not known" if value is None else f"{value:.2f}")
        for name, value in ranks.items()
    )
    return Claim(
        "the mean value is a relative distance",
        "the mean value over time serves as a relative distance (sections 5.2.1 and 7.2)",
        f"rank correlation of mean and stereo depth, frame by frame (-1: it is): {found}",
        agreement,
        why,
    )


def _sign_claim(
    scores: dict[str, TrendScore], titles: dict[str, str], ours: Sequence[str]
) -> Claim:
    found = "; ".join(
        f"{titles[name]} {_per_cent(one.agreement)} of {one.same + one.opposite} frames, "
        f"{one.missed_approach} of an approach called steady or shrinking"
        for name, one in scores.items()
    )
    worst = min((scores[name].agreement or 0.0 for name in ours), default=0.0)
    if not any(one.same + one.opposite for one in scores.values()):
        agreement, why = ClaimAgreement.UNCOMPARABLE, "no frame has a sign in both"
    elif worst >= _AGREES:
        agreement, why = ClaimAgreement.YES, "the sign of the trend is that of the depth's change"
    elif worst >= _PARTLY:
        agreement = ClaimAgreement.PARTLY
        why = "mostly; where it is wrong, what is near leaves the picture or is no longer matched"
    else:
        agreement, why = ClaimAgreement.NO, "too often the sign is not that of the depth's change"
    return Claim(
        "a growing mean is a thing that comes nearer",
        "the mean value tells whether the distance grows or shrinks (sections 5.2.1 and 7.2)",
        f"sign of the trend against the sign of the depth's change, where both have one: {found}",
        agreement,
        why,
    )


def _contact_claim(scores: dict[str, TrendScore], titles: dict[str, str]) -> Claim:
    found = "; ".join(
        f"{titles[name]}: {_spread_words(one.ratios)}, with the edge ignored "
        f"{_spread_words(one.unchecked_ratios)}"
        for name, one in scores.items()
    )
    return Claim(
        "time to contact",
        "the thesis has none",
        f"from expansion over from depth, median: {found}",
        ClaimAgreement.UNCOMPARABLE,
        _contact_why(scores),
    )


def _contact_why(scores: dict[str, TrendScore]) -> str:
    said = [ratio for one in scores.values() for ratio in one.ratios]
    if not said:
        return "tokt's own; on these frames nothing is wholly in the picture for long enough"
    middle = float(np.median(said))
    if middle < 1 / _FAR_OFF:
        return (
            f"tokt's own, and {1 / middle:.1f} times too short (median of all that are said): a "
            "thing that comes out of dark water grows in the mask because more of it is seen, not "
            "only because it is nearer; it errs to the early side, and is no measure of time here"
        )
    if middle > _FAR_OFF:
        return f"tokt's own, and {middle:.1f} times too long (median of all that are said)"
    return "tokt's own; the median is within a half of the same time"


def _figures(one: TrendScore) -> dict[str, Any]:
    row: dict[str, Any] = {
        "frames asked": one.asked,
        "trend said": one.said,
        "same sign": one.same,
        "opposite sign": one.opposite,
        "sign agreement": None if one.agreement is None else round(one.agreement, 3),
        "approach called steady or shrinking": one.missed_approach,
    }
    for words, ratios in (("", one.ratios), (", edge ignored", one.unchecked_ratios)):
        row[f"contacts{words}"] = len(ratios)
        for percent in _SPREAD:
            value = round(float(np.percentile(ratios, percent)), 3) if ratios else None
            row[f"contact ratio {percent} %{words}"] = value
    return row


def _score_table(rates: dict[tuple[str, float], TrendScore], titles: dict[str, str]) -> Table:
    rows = [
        {"mean of": titles[name], "s a frame": rate, **_figures(one)}
        for (name, rate), one in sorted(
            rates.items(), key=lambda item: (list(titles).index(item[0][0]), item[0][1])
        )
    ]
    caption = (
        "Trend against stereo depth. Asked: something is seen and the depth's change is known. "
        "Contact ratio: time to contact from expansion over that from depth, percentiles."
    )
    return Table("trend_against_depth", caption, pd.DataFrame(rows))


def _confusion_table(held: dict[str, list[TrendAgainstDepth]], titles: dict[str, str]) -> Table:
    parts = []
    for name, one in held.items():
        counts = confusion(one)
        counts.insert(0, "by depth", list(TRENDS))
        counts.insert(0, "mean of", titles[name])
        parts.append(counts)
    caption = (
        f"Frames by what the depth does (rows) and what was said (columns), {SECONDS_A_FRAME} s "
        "from frame to frame."
    )
    title = "Trend: what the depth does, and what was said"
    return Table("trend_confusion", caption, pd.concat(parts, ignore_index=True), title)


def _frame_table(held: dict[str, list[TrendAgainstDepth]]) -> Table:
    rows: dict[int, dict[str, Any]] = {}
    for name, frames in held.items():
        for one in frames:
            row = rows.setdefault(
                one.frame,
                {
                    "frame": one.frame,
                    "depth_m": _rounded(one.depth_m),
                    "by_depth": one.true,
                    "contact_s_by_depth": _rounded(one.true_contact_s),
                },
            )
            row[f"{name}_mean"] = _rounded(one.mean)
            row[f"{name}_trend"] = one.said.trend
            row[f"{name}_confidence"] = one.said.confidence
            row[f"{name}_contact_s"] = one.said.contact_s
    caption = "Frame by frame; empty where it is not known or not said."
    return Table("trend_frames", caption, pd.DataFrame(list(rows.values())), "Trend by frame")


def _rounded(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(value, 3)


def _numbers(scores: dict[str, TrendScore], frames: int) -> dict[str, float | int | str | bool]:
    numbers: dict[str, float | int | str | bool] = {
        "frames": frames,
        "seconds_a_frame": SECONDS_A_FRAME,
    }
    for name, one in scores.items():
        found = {
            "asked": one.asked,
            "said": one.said,
            "same_sign": one.same,
            "opposite_sign": one.opposite,
            "sign_agreement": one.agreement,
            "missed_approach": one.missed_approach,
            "rank_correlation": one.rank_correlation,
            "contacts": len(one.ratios),
            "contact_ratio_median": float(np.median(one.ratios)) if one.ratios else None,
            "contacts_edge_ignored": len(one.unchecked_ratios),
            "contact_ratio_median_edge_ignored": (
                float(np.median(one.unchecked_ratios)) if one.unchecked_ratios else None
            ),
        }
        numbers |= {f"{name}_{key}": value for key, value in found.items() if value is not None}
    return numbers


def _plots(held: dict[str, list[TrendAgainstDepth]], titles: dict[str, str]) -> tuple[Plot, ...]:
    return (
        Plot(
            "trend",
            "Above: median stereo depth, coloured by what it does. Below: the mean value of each "
            "method, coloured by the trend that is said of it; gray: none is said.",
            trend_png(held, titles),
        ),
        Plot(
            "trend_confusion",
            "Frames by what the depth does and what is said.",
            confusion_png({titles[name]: confusion(one) for name, one in held.items()}),
        ),
        Plot(
            "time_to_contact",
            "Time to contact from expansion against that from stereo depth. Filled: as it is "
            "said. Hollow: what would be said if the picture's edge did not matter.",
            contact_png(held, titles),
        ),
    )
