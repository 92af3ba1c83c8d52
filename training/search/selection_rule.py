"""The rule that selects the winner, fixed before any trial is run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .score import SCORE, BlockConfusion, spread
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
