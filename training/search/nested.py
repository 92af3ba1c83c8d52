"""The nested score of a search: measured on blocks it could not see when it chose.

The winner's own score was looked at to choose it, so it is somewhat too good. Here the whole
search is repeated inside the training part of every fold; the extractor it chooses there is then
scored on that fold's held-out blocks, and the folds are pooled. The scores on the held-out blocks
are known already: the trial of the whole dataset trained on just that part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .score import BlockConfusion, pooled
from .selection_rule import ranked, winner
from .space import Trial

HOW = (
    "the whole search repeated inside the training part of each fold, and the extractor chosen "
    "there scored on the fold's held-out blocks, pooled over the folds"
)


def honest_score(
    whole: Mapping[Trial, BlockConfusion], inside: Sequence[Mapping[Trial, BlockConfusion]]
) -> dict[str, Any]:
    """Score the procedure on blocks it did not see.

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
