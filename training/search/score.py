"""The score of a trial, from held-out patches by block of frames or dive; the rule that selects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64, I64
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.fitting.cross_validation import HeldOutPredictions

from .space import Trial

REPLICATES = 2000
SEED = 42
_MAX_BLOCKS = 400
SCORE = (
    "F1 of obstacle patches, or macro-F1 over the classes where there are more than two. It is "
    "pooled over all held-out patches of the blocked cross-validation, decision threshold 0. Its "
    f"standard error is that of {REPLICATES} bootstrap samples of whole blocks of frames. Where "
    "whole dives are held out it is the mean of the dives' scores, with samples of whole dives"
)
MAX_GIVEN_UP = 0.01
"""The score that simplicity may cost at most, however large the standard error: with a dozen
blocks of one dive it is several hundredths, and a vehicle is worth more than a shorter spec."""
RULE = (
    "The winner is the simplest extractor within one standard error of the best, and within "
    f"{MAX_GIVEN_UP:g}. Of those within, it has the fewest features, then the fewest pictures, "
    "then the first name. A score is within if its shortfall from the highest one is no more than "
    f"{MAX_GIVEN_UP:g}, and no more than the shortfall's own standard error. Both are taken on "
    f"the same bootstrap samples of blocks. Score: {SCORE}."
)
HOW = (
    "the whole search is repeated inside the training part of each fold, and what the fold holds "
    "out scores the extractor chosen there"
)


@dataclass(frozen=True)
class BlockConfusion:
    """Confusion matrices of held-out patches, one for each block of frames, or for each dive."""

    blocks: I64  # (n,): the block of frames, or the dive, of each row of `counts`
    folds: I64  # (n,): its fold
    counts: I64  # (n, classes, classes): true class by said class
    n_blocks: int
    by_dive: bool = False  # whether they are dives, of which each counts the same

    def to_json(self) -> dict[str, Any]:
        """As it is kept."""
        return {
            "n_blocks": self.n_blocks,
            "by_dive": self.by_dive,
            "blocks": self.blocks.tolist(),
            "folds": self.folds.tolist(),
            "counts": self.counts.tolist(),
        }

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> BlockConfusion:
        """What `to_json` gave. Raises KeyError, TypeError or ValueError if it is anything else."""
        blocks, folds = (np.array(value[name], np.int64) for name in ("blocks", "folds"))
        counts = np.array(value["counts"], np.int64)
        if not (blocks.ndim == 1 and blocks.shape == folds.shape == counts.shape[:1]):
            raise ValueError("blocks, folds and counts differ in length")
        if counts.ndim != 3 or counts.shape[1] != counts.shape[2] or (counts < 0).any():
            raise ValueError("counts are no confusion matrices")
        n_blocks = int(value["n_blocks"])
        if len(blocks) and not (blocks.min() >= 0 and blocks.max() < n_blocks):
            raise ValueError("a block is out of range")
        return cls(blocks, folds, counts, n_blocks, bool(value.get("by_dive", False)))

    @property
    def score(self) -> float:
        """Pooled over all blocks, or the mean of the dives'."""
        return float(np.nan_to_num(self._scores(np.ones((1, self.n_blocks), np.int64))[0]))

    def _scores(self, drawn: I64) -> F64:
        """Of samples, in each of which a block or dive is drawn so many times."""
        n_classes = self.counts.shape[1]
        by_block = np.zeros((self.n_blocks, n_classes, n_classes), np.int64)
        np.add.at(by_block, self.blocks, self.counts)
        # A dive with one side only has no score of its own.
        mixed = (by_block.sum(axis=2) > 0).sum(axis=1) > 1
        if self.by_dive and mixed.any():
            with np.errstate(invalid="ignore"):
                scores = drawn[:, mixed] @ f1_of_counts(by_block[mixed])
                return np.asarray(scores / drawn[:, mixed].sum(axis=1))
        # Whole numbers: the sums are exact on every machine.
        return f1_of_counts(np.einsum("rb,bij->rij", drawn, by_block))

    def replicates(self) -> F64:
        """Scores of bootstrap samples: the same blocks in the same samples for every tally."""
        rng, blocks = np.random.default_rng(SEED), self.n_blocks
        return self._scores(rng.multinomial(blocks, np.full(blocks, 1 / blocks), REPLICATES))

    @property
    def standard_error(self) -> float:
        """Of the score."""
        return spread(self.replicates())


def f1_of_counts(counts: I64) -> F64:
    """F1 of class 1 of two, macro-F1 over the classes present of more; NaN where undefined.

    From confusion matrices (..., classes, classes), true class by said class.
    """
    hits = np.diagonal(counts, axis1=-2, axis2=-1)
    present = counts.sum(axis=-1)
    either = present + counts.sum(axis=-2)
    with np.errstate(invalid="ignore", divide="ignore"):
        each = np.where(either > 0, 2.0 * hits / either, np.nan)
        if counts.shape[-1] == 2:
            return np.asarray(each[..., 1])
        here = present > 0
        return np.asarray(np.where(here, each, 0.0).sum(axis=-1) / here.sum(axis=-1))


def spread(replicates: F64) -> float:
    """Standard deviation of the defined ones; 0 where fewer than two are."""
    defined = replicates[np.isfinite(replicates)]
    return float(defined.std(ddof=1)) if len(defined) > 1 else 0.0


def tally(dataset: DatasetVersion, held_out: HeldOutPredictions, by_dive: bool) -> BlockConfusion:
    """Count what a cross-validation said of each block, or dive.

    A dataset of thousands of blocks is counted by some hundred runs of neighbour blocks.
    """
    tested = held_out.fold >= 0
    values, truth = held_out.values[tested], dataset.targets()[tested]
    two = values.shape[1] == 1
    said = (values[:, 0] > 0).astype(np.int64) if two else values.argmax(axis=1)
    unit = dataset.patches.mission if by_dive else dataset.patches.group
    names, block = np.unique(unit.to_numpy(), return_inverse=True)
    if len(names) > _MAX_BLOCKS and not by_dive:
        block = block * _MAX_BLOCKS // len(names)
    n_blocks, n_classes = int(block.max()) + 1, 2 if two else values.shape[1]
    pairs = np.column_stack([block[tested], held_out.fold[tested]])
    cells, place = np.unique(pairs, axis=0, return_inverse=True)
    counts = np.zeros((len(cells), n_classes, n_classes), np.int64)
    np.add.at(counts, (place.reshape(-1), truth, said), 1)
    return BlockConfusion(cells[:, 0], cells[:, 1], counts, n_blocks, by_dive)


@dataclass(frozen=True)
class Rank:
    """Scores of one trial, as the rule compares them."""

    trial: Trial
    score: float
    standard_error: float
    shortfall: float  # by how much it is below the best
    shortfall_error: float  # the standard error of that

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
    then scored on that fold's held-out blocks, and the folds are put together. The scores on the
    held-out blocks are known already: the trial of the whole dataset trained on just that part.

    Of each trial on the `whole` dataset, and `inside` the training part of each fold: score; chosen
    (the winner's name inside each fold); how, in words.
    """
    chosen = [winner(ranked(tallies)).trial for tallies in inside]
    parts = [(whole[trial], whole[trial].folds == fold) for fold, trial in enumerate(chosen)]
    together = replace(
        parts[0][0],
        blocks=np.concatenate([one.blocks[at] for one, at in parts]),
        folds=np.concatenate([one.folds[at] for one, at in parts]),
        counts=np.concatenate([one.counts[at] for one, at in parts]),
    )
    return {"score": together.score, "chosen": [trial.name for trial in chosen], "how": HOW}
