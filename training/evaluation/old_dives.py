"""The rule for a new version of a model: it must not lose what the old one could do."""

from collections.abc import Mapping

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


def held_out_by_dive(table: pd.DataFrame) -> bool:
    """Return whether a table of held-out patches has several dives, each held out as a whole."""
    tested = table[table.fold >= 0]
    several = tested.mission.nunique() > 1
    return bool(several and tested.groupby("mission").fold.nunique().max() == 1)


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
        None where nothing can be compared: one held out whole dives and the other parts of them, or
        no patch is in both.
    """
    new = after.assign(obstacle=obstacle)[after.fold >= 0]
    both = new.merge(before[before.fold >= 0], on=[*PATCH_KEY, "label"], suffixes=("", "_before"))
    if both.empty or held_out_by_dive(before) != held_out_by_dive(after):
        return None
    f1: dict[str, dict[str, float | None]] = {"obstacle_score_before": {}, "obstacle_score": {}}
    for dive, part in both.groupby("mission"):
        for column, by_dive in f1.items():
            figures = obstacle_metrics(part.obstacle.to_numpy(), part[column].to_numpy())
            by_dive[str(dive)] = figures["f1"]
    return falls(*f1.values())
