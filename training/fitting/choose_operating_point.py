"""The operating point: the frame rule that keeps false statuses on open ocean rare enough."""

import ast
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F64, Bools
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.models.operating_point import MofNRule
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.datasets.folds import BLOCK, DIVE
from tokt.training.evaluation.frame_scores import FrameScores, frame_table
from tokt.training.evaluation.metrics import BOUND_CONFIDENCE, upper_bound

from .exceedance_model import MIN_FRAMES, ExceedanceModel, fit_exceedance_model

MIN_PATCHES = (1, 2)
FRAME_RULES = ((1, 1), (2, 3), (3, 3), (3, 5))
_MAX_NAMED = 20
MIN_RATE, MAX_RATE = 1e-9, 0.5
_MARGIN_STEPS = 10_000  # a unit; margins are rounded up to them: short to read, never too small


@dataclass(frozen=True)
class FalseStatusTarget:
    """The rate of false statuses to keep, how surely, and by which frame rules.

    Raises ToktError if a number is out of its bounds.
    """

    rate: float = 1e-4  # false statuses allowed per ocean frame
    confidence: float = 0.5  # with which the rate is to be kept; 0.5 asks for the best estimate
    least_patches: int | None = None  # of the rule; None to choose between 1 and 2
    frame_rule: tuple[int, int] | None = None  # hits and window; None to choose of `FRAME_RULES`

    def __post_init__(self) -> None:
        if not MIN_RATE <= self.rate <= MAX_RATE:
            raise ToktError(
                f"a false-status rate lies between {MIN_RATE:g} and {MAX_RATE:g}, "
                f"not at {self.rate:g}"
            )
        if not 0.5 <= self.confidence < 1:
            raise ToktError(f"a confidence lies between 0.5 and 1, not at {self.confidence:g}")
        tuple(self.shapes())

    @classmethod
    def logged(cls, parameters: Mapping[str, str]) -> Self:
        """What a run's parameters say; an older tokt logged none."""
        texts = {field.name: parameters.get(f"target_{field.name}") for field in fields(cls)}
        return cls(**{name: ast.literal_eval(text) for name, text in texts.items() if text})

    def shapes(self) -> Iterator[MofNRule]:
        """The rules to choose among, still without their margins, the simpler first."""
        frames = FRAME_RULES if self.frame_rule is None else (self.frame_rule,)
        patches = MIN_PATCHES if self.least_patches is None else (self.least_patches,)
        for (hits, window), least in product(frames, patches):
            yield MofNRule(0.0, least, hits, window)


DEFAULT_TARGET = FalseStatusTarget()


@dataclass(frozen=True)
class _Candidate:
    """A rule with its margins, and what it does on the frames it was chosen on.

    The first of `tails` and `margins` is of the margin, the second, if there is one, of the margin
    at once. `blocks` are those of the ocean frames, or their dives. `shown` is false where no ocean
    frame has as many before it as the rule looks at.
    """

    rule: MofNRule
    tails: list[ExceedanceModel | None]
    margins: list[float]
    false_status: Bools
    blocks: NDArray[np.object_]
    found: Bools
    found_at_zero: Bools
    shown: bool

    def rate(self) -> float | None:
        """False statuses an ocean frame that the fitted laws expect, at most."""
        pairs = list(zip(self.tails, self.margins, strict=True))
        rates = [tail.rate(margin) for tail, margin in pairs if tail is not None]
        return sum(rates) if len(rates) == len(pairs) else None

    def confidence(self) -> float | None:
        """That each path keeps its part of the rate, were the laws right: the lower of both."""
        pairs = list(zip(self.tails, self.margins, strict=True))
        sure = [tail.confidence(margin) for tail, margin in pairs if tail is not None]
        return min(sure) if len(sure) == len(pairs) else None

    def worth(self) -> tuple[bool, bool, int, int]:
        """A law, then obstacle frames found (those an alarm is late for are not), then latency.

        Without a law the margin is only what was seen, perhaps nothing: it would win for that.
        """
        law = self.rate() is not None
        return law, self.shown, int(self.found.sum()), -self.rule.latency_frames

    def costs(self) -> dict[str, int]:
        """What it misses, and how late it is."""
        return {
            "detected": int(self.found.sum()),
            "detected_at_margin_0": int(self.found_at_zero.sum()),
            "latency_frames": self.rule.latency_frames,
        }


def choose_frame_rule(
    dataset: DatasetVersion,
    score: F64,
    tested: Bools,
    target: FalseStatusTarget,
    by_dive: bool = False,
) -> tuple[MofNRule, dict[str, Any]]:
    """Choose margin, patches and frames of an alarm for a rate of false statuses.

    Each candidate's margin is where the law of `exceedance_model`, fitted to the tested ocean
    frames, comes down to the rate; it is never so low that more of those frames than the rate
    allows would have had a false status. A rule over several frames gets a second margin, above
    which one patch of one frame is enough; the two share the rate evenly. Of the candidates that a
    law could be fitted for (of all, where there is none) the one that finds most obstacle frames is
    taken; of equals the quicker one, then the simpler one.

    Parameters
    ----------
    score : array of float64, shape (n_patches,)
        `LinearModel.obstacle_score` by models that did not learn from the patch.
    tested : array of bool, shape (n_patches,)
        Which patches have one.
    by_dive : bool
        Whether the level of the law changes from dive to dive, and not from block to block: then
        the margin is for a dive that nobody has seen. Where too few dives have ocean frames it
        changes from block to block all the same.

    Returns
    -------
    rule : MofNRule
    chosen : dict
        JSON, for the bundle and the card: what was asked for, how it was chosen (`method`), what
        the data showed and what it cannot show (`words`), and the candidates.
    """
    frames = frame_table(dataset)
    scores = FrameScores.of(frames, dataset, score, tested)
    ocean = frames.ocean & scores.tested
    said = {"target_rate": target.rate, "target_confidence": target.confidence}
    if not ocean.any() or not np.isfinite(score[tested]).all():
        why = (
            "no frame was labelled as open ocean patch by patch"
            if not ocean.any()
            else "the model's classes are all obstacles, or all clear"
        )
        words = f"Nothing was chosen: {why}. Any patch over its threshold is an alarm."
        return MofNRule(), {**said, "method": "none", "words": words, "reachable": False}
    shapes = shapes_on(dataset.grid, target)
    for unit in (DIVE, BLOCK) if by_dive else (BLOCK,):
        units = frames.keys["mission" if unit == DIVE else "group"].to_numpy()[ocean]
        candidates = [_candidate(shape, scores, ocean, target, units) for shape in shapes]
        if any(one.rate() is not None for one in candidates):
            break
    best = max(candidates, key=_Candidate.worth)
    described = _described(best, target, unit)
    if by_dive and unit == BLOCK:
        described["words"] += _ONE_DIVE
    unknown = _rate_unknown_in(scores, ocean, best.rule)
    if unknown:
        named = ", ".join(unknown) if len(unknown) <= _MAX_NAMED else f"{len(unknown)} of the dives"
        described["words"] += _UNKNOWN.format(named)
    return best.rule, {
        **said,
        **described,
        **({"rate_unknown_in": unknown} if unknown else {}),
        "candidates": [{**one.rule.to_json(), **one.costs()} for one in candidates],
    }


def shapes_on(grid: Grid, target: FalseStatusTarget) -> list[MofNRule]:
    """The target's shapes that frames of this grid can meet; ToktError where there is none."""
    shapes = [shape for shape in target.shapes() if shape.min_patches <= grid.n_patches]
    if not shapes:
        raise ToktError(
            f"frames of {grid.n_patches} patches never show {target.least_patches} of them"
        )
    return shapes


def _candidate(
    shape: MofNRule,
    scores: FrameScores,
    ocean: Bools,
    target: FalseStatusTarget,
    blocks: NDArray[np.object_],
) -> _Candidate:
    frames = scores.frames
    # Over ocean frames alone: what is left over from an obstacle is not a false status.
    quiet_scores = scores.of_some(ocean)
    paths = [(shape.min_patches, shape.m, shape.n)]
    if shape.n > 1:
        paths.append((1, 1, 1))
    rate = target.rate / len(paths)
    quiet = [quiet_scores.statistic(*path)[ocean] for path in paths]
    # Without the frames that have too few last ones.
    enough = [np.isfinite(one) for one in quiet]
    tails = [
        fit_exceedance_model(one[some], blocks[some], rate)
        for one, some in zip(quiet, enough, strict=True)
    ]
    margins = [
        _margin(one, tail, rate, target.confidence) for one, tail in zip(quiet, tails, strict=True)
    ]
    now = max(margins) if len(paths) > 1 else None
    margins = margins[:1] if now is None else [margins[0], now]
    obstacle = (frames.obstacles > 0) & scores.tested
    seen = [scores.statistic(*path)[obstacle] for path in paths]
    return _Candidate(
        replace(shape, margin=margins[0], instant_margin=now),
        tails,
        margins,
        _any_above(quiet, margins),
        blocks,
        _any_above(seen, margins),
        seen[0] > 0,
        all(some.any() for some in enough),
    )


def _margin(statistic: F64, tail: ExceedanceModel | None, rate: float, confidence: float) -> float:
    allowed = np.sort(statistic)[::-1][math.floor(rate * len(statistic))]
    margin = max(0.0, float(allowed), tail.margin(confidence) if tail else 0.0)
    return math.ceil(margin * _MARGIN_STEPS) / _MARGIN_STEPS


def _any_above(statistics: list[F64], margins: list[float]) -> Bools:
    """Where a statistic is above its margin."""
    pairs = zip(statistics, margins, strict=True)
    return np.asarray(np.any([one > margin for one, margin in pairs], axis=0), bool)


def _rate_unknown_in(scores: FrameScores, ocean: Bools, rule: MofNRule) -> list[str]:
    """The dives, of several, with too few ocean frames for a law of their own.

    Those count that have as many before them as the rule looks at.
    """
    statistic = scores.of_some(ocean).statistic(rule.min_patches, rule.m, rule.n)
    shown = ocean & np.isfinite(statistic)
    mission = scores.frames.keys["mission"].to_numpy()
    names = np.unique(mission)
    few = [str(name) for name in names if shown[mission == name].sum() < MIN_FRAMES]
    return few if len(names) > 1 else []


def _described(best: _Candidate, target: FalseStatusTarget, unit: str) -> dict[str, Any]:
    frames, false = len(best.false_status), int(best.false_status.sum())
    blocks = len(np.unique(best.blocks))
    false_blocks = len(np.unique(best.blocks[best.false_status]))
    bounds = upper_bound(false, frames), upper_bound(false_blocks, blocks)
    return {
        "method": _NO_METHOD if best.rate() is None else _METHODS[unit],
        "words": _words(best, target, bounds, unit),
        **({"unit": unit} if unit == DIVE else {}),
        "ocean_frames": frames,
        "ocean_blocks": blocks,
        "false_status": false,
        "false_status_blocks": false_blocks,
        "upper_bound": {
            "confidence": BOUND_CONFIDENCE,
            "of_frames": bounds[0],
            "of_blocks": bounds[1],
        },
        "reachable": bounds[0] <= target.rate,
        "extrapolated_rate": best.rate(),
        "confidence": best.confidence(),
        "tail": [asdict(tail) if tail else None for tail in best.tails],
        "obstacle_frames": len(best.found),
        **best.costs(),
    }


_ONE_DIVE = (
    " Too few dives have such frames to tell how the level changes from dive to dive: of another "
    "dive's water nothing was shown."
)
_UNKNOWN = (
    f" The rate is unknown in {{}}: it takes {MIN_FRAMES} held-out ocean frames there, each with "
    "the frames before it that the rule looks at."
)
_METHODS = {
    unit: (
        "A Gumbel law was fitted to the strength of the last patch that a status needs, on "
        f"held-out ocean frames. Its level changes from {unit} to {unit}. The margin is where it "
        f"comes down to the rate, at the stated confidence over {units}, and no lower than what "
        "was seen. Where a status takes several frames, half of the rate goes to a second margin, "
        "above which one patch of one frame is enough."
    )
    for unit, units in ((BLOCK, "blocks of frames"), (DIVE, "dives"))
}
_NO_METHOD = (
    "No law could be fitted: too few held-out ocean frames or blocks, or a single score in all of "
    "them. The margin is the largest obstacle score that was seen on them."
)


def _words(
    best: _Candidate, target: FalseStatusTarget, bounds: tuple[float, float], unit: str
) -> str:
    """What was asked, what was seen, and what that can and cannot show."""
    frames, false = len(best.false_status), int(best.false_status.sum())
    blocks = len(np.unique(best.blocks))
    near_copies = "dives" if unit == DIVE else "blocks of near copies"
    asked = f"Asked for: a false status in at most {_one_in(target.rate)} ocean frames."
    seen = (
        f"With it, on the frames that it was chosen on: {false} of {frames} ocean frames "
        f"({blocks} {near_copies}). That alone shows no more than {bounds[0]:.2g} of frames "
        f"({BOUND_CONFIDENCE:.0%} confidence, were they independent) or {bounds[1]:.2g} of {unit}s"
    )
    if bounds[0] <= target.rate:
        limit = "."
    else:
        needed = math.ceil(math.log(1 - BOUND_CONFIDENCE) / math.log1p(-target.rate))
        limit = f"; it would take {needed} independent ocean frames without one to show the rate."
    rate, sure = best.rate(), best.confidence()
    if rate is None or sure is None:
        return f"{asked} {seen}{limit} Nothing could be extrapolated from that."
    what = "a best estimate, not a bound" if target.confidence == 0.5 else "a bound by that law"
    return (
        f"{asked} {seen}{limit} The margin is extrapolated, {what}, and for water like this one "
        f"only. By the fitted law {_one_in(rate)} ocean frames has a false status, and the rate "
        f"asked for is kept with {sure:.0%} confidence."
    )


def _one_in(rate: float) -> str:
    if rate < 1e-9:
        return "fewer than 1 in 1,000,000,000"
    return f"1 in {1 / rate:,.0f}" if rate <= 0.01 else f"1 in {1 / rate:.3g}"
