"""The rule that selects the winner, fixed before any trial is run, and its honest score."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .score import SCORE, BlockConfusion, pooled, spread
from .space import Trial

MAX_GIVEN_UP = 0.01
"""The score that simplicity may cost at most, however large the standard error: with a dozen
blocks of one dive it is several hundredths, and a vehicle is worth more than a shorter spec."""
RULE = (
    "The winner is the simplest extractor within one standard error of the best, and within "
    f"{MAX_GIVEN_UP:g}: of those whose score falls short of the highest one by no more than one "
    "standard error of that shortfall (both on the same bootstrap samples of blocks) and no more "
    f"than {MAX_GIVEN_UP:g}, the one with the fewest features, then the fewest pictures, then "
    f"the first name. Score: {SCORE}."
)
HOW = (
    "the whole search repeated inside the training part of each fold, and the extractor chosen "
    "there scored on the fold's held-out blocks, pooled over the folds"
)


@dataclass(frozen=True)
class Rank:
    """Scores of one trial, as the rule compares them.

    Parameters
    ----------
    trial : Trial
    score, standard_error : float
    shortfall, shortfall_error : float
        By how much it is below the best, and the standard error of that.
    within : bool
        Whether the shortfall is at most one standard error and `MAX_GIVEN_UP`.
    """

    trial: Trial
    score: float
    standard_error: float
    shortfall: float
    shortfall_error: float

    @property
    def within(self) -> bool:
        """Whether the shortfall is at most one standard error and `MAX_GIVEN_UP`."""
        return self.shortfall <= min(self.shortfall_error, MAX_GIVEN_UP)


def ranked(tallies: Mapping[Trial, BlockConfusion]) -> tuple[Rank, ...]:
    """Every trial as the rule sees it, simple ones first; of equal ones the simpler is best."""
    trials = sorted(tallies, key=lambda trial: trial.cost)
    samples = {trial: tallies[trial].replicates() for trial in trials}
    scores = {trial: tallies[trial].score for trial in trials}
    best = max(trials, key=lambda trial: scores[trial])
    return tuple(
        Rank(
            trial,
            scores[trial],
            spread(samples[trial]),
            scores[best] - scores[trial],
            spread(samples[best] - samples[trial]),
        )
        for trial in trials
    )


def winner(ranks: tuple[Rank, ...]) -> Rank:
    """The trial that `RULE` names."""
    return next(rank for rank in ranks if rank.within)


def honest_score(
    whole: Mapping[Trial, BlockConfusion], inside: Sequence[Mapping[Trial, BlockConfusion]]
) -> dict[str, Any]:
    """Score the procedure on blocks it did not see when it chose.

    The winner's own score was looked at to choose it, so it is somewhat too good. Here the whole
    search is repeated inside the training part of every fold; the extractor it chooses there is
    then scored on that fold's held-out blocks, and the folds are pooled. The scores on the
    held-out blocks are known already: the trial of the whole dataset trained on just that part.

    Parameters
    ----------
    whole : mapping
        Each trial on the whole dataset.
    inside : sequence of mapping
        The same inside the training part of each fold.

    Returns
    -------
    dict
        score; chosen: the winner's name inside each fold; how, in words.
    """
    chosen = [winner(ranked(tallies)).trial for tallies in inside]
    matrices = [whole[trial].of_fold(fold) for fold, trial in enumerate(chosen)]
    return {"score": pooled(matrices), "chosen": [trial.name for trial in chosen], "how": HOW}
