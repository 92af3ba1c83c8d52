"""The rule for a new version of a model: it must not lose what the old one could do."""

from collections.abc import Collection, Mapping

import numpy as np
import pandas as pd

from tokt.features.common.arrays import Bools
from tokt.training.datasets.dataset import PATCH_KEY

from .metrics import obstacle_metrics

MAX_DIVE_FALL = 0.03
"""Of F1, of any dive that the old version learnt; two fits with other landmarks differ by 0.01."""
MAX_MEAN_FALL = 0.01
"""Of the mean F1 over these dives."""


def falls(before: Mapping[str, float | None], after: Mapping[str, float | None]) -> list[str]:
    """Return what fell by more than the rule allows, a line each; empty where nothing did.

    Parameters
    ----------
    before, after : mapping of str to float or None
        By dive, the F1 of the old and of the new version on patches that neither learnt from; None
        where a dive has obstacles alone, or water alone. Dives that are in one only are left out.
    """
    both = {
        dive: (was, now)
        for dive, was in before.items()
        if was is not None and (now := after.get(dive)) is not None
    }
    lines = [
        f"{dive} F1 {was:.3f} -> {now:.3f}"
        for dive, (was, now) in both.items()
        if was - now > MAX_DIVE_FALL
    ]
    if len(both) > 1:
        was, now = np.mean(list(both.values()), axis=0)
        if was - now > MAX_MEAN_FALL:
            lines.append(f"mean F1 of {len(both)} dives {was:.3f} -> {now:.3f}")
    return lines


def held_out_units(
    table: pd.DataFrame, missions: Collection[str]
) -> dict[str, frozenset[str]] | None:
    """Return which of `missions` were held out together with each, or None where it was by blocks.

    Parameters
    ----------
    table : DataFrame
        All patches of a version, as `Registry.held_out` gives them.
    missions : collection of str
        Dives that it shares with another version.
    """
    tested = table[table.fold >= 0]
    folds = tested.groupby("mission").fold.unique()
    if len(folds) < 2 or any(len(numbers) > 1 for numbers in folds):
        return None
    number = {str(mission): int(numbers[0]) for mission, numbers in folds.items()}
    known = [mission for mission in missions if mission in number]
    return {
        mission: frozenset(other for other in known if number[other] == number[mission])
        for mission in known
    }


def held_out_falls(before: pd.DataFrame, after: pd.DataFrame, obstacle: Bools) -> list[str] | None:
    """Return the `falls` between two versions, on the patches that each of them held out.

    Parameters
    ----------
    before, after : DataFrame
        Of the old and of the new version, as `Registry.held_out` gives them.
    obstacle : array of bool, shape (len(after),)
        Whether each patch of the new version is an obstacle.

    Returns
    -------
    list of str or None
        None where nothing can be compared: no patch is in both, or their dives were held out
        together with others, or in parts.
    """
    new = after.assign(obstacle=obstacle)[after.fold >= 0]
    both = new.merge(before[before.fold >= 0], on=[*PATCH_KEY, "label"], suffixes=("", "_before"))
    missions = set(both.mission)
    units = [held_out_units(table, missions) for table in (before, after)]
    if both.empty or units[0] != units[1]:
        return None
    f1: dict[str, dict[str, float | None]] = {"obstacle_score_before": {}, "obstacle_score": {}}
    for dive, part in both.groupby("mission"):
        for column, by_dive in f1.items():
            figures = obstacle_metrics(part.obstacle.to_numpy(), part[column].to_numpy())
            by_dive[str(dive)] = figures["f1"]
    return falls(*f1.values())
