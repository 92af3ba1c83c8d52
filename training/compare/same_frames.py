"""Registered models of any names on the very same frames, which each of them held out."""

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np
import pandas as pd

from tokt.features.common.errors import ToktError
from tokt.models.registry.registration import RegisteredVersion
from tokt.models.registry.registry import Registry, fitting
from tokt.training.datasets.dataset import (
    CLEAR,
    FRAME_KEY,
    OBSTACLE,
    PATCH_KEY,
    DatasetVersion,
    list_datasets,
)
from tokt.training.evaluation.metrics import metrics_by, over_dives
from tokt.training.evaluation.old_dives import held_out_units

MIN_SHARE = 0.2
"""Of the patches that a listed model held out: so many at least are measured."""
_KEY = [*PATCH_KEY, "label", "obstacle", "picture"]
_FIGURES = {"f1": "F1", "average_precision": "AP"}
_NO_F1 = "F1 -: "
_ALONE = "no other model held out"


def figures_of_listed(
    registry: Registry, versions: Sequence[RegisteredVersion]
) -> dict[str, dict[str, Any]]:
    """Measure registered versions, each with those that held out the same frames.

    Parameters
    ----------
    registry : Registry
    versions : sequence of RegisteredVersion

    Returns
    -------
    dict
        By label: f1 and average_precision (means over the dives), frames, dives, those that it was
        measured `with`, and `words`. Figures are None where `words` say why there are none.
    """
    tables, why = _tables(registry, versions)
    found = {}
    for group in _groups(tables):
        for label, one in _on_same_frames(group).items():
            others = [other for other in group if other != label]
            words = f"{_scores(one)} on its own {_frames(one)}, which {_ALONE}"
            if others:
                words = f"{_scores(one)} on the same {_frames(one)}{_roughly(group)}"
            found[label] = {**one, "with": others, "words": words}
    none: dict[str, Any] = {**dict.fromkeys(_FIGURES), "frames": 0, "dives": {}, "with": []}
    return {
        item.label: found.get(
            item.label, {**none, "words": _NO_F1 + why.get(item.label, "no patch was held out")}
        )
        for item in versions
    }


def beside_champions(
    registry: Registry, candidate: RegisteredVersion, alias: str
) -> list[dict[str, Any]]:
    """Measure a candidate beside each other name's version with an alias, on the same frames.

    Parameters
    ----------
    registry : Registry
    candidate : RegisteredVersion
    alias : str
        Such as champion.

    Returns
    -------
    list of dict
        A row a champion: model, figures (`model` and `candidate`; None where no frame is in both)
        and words (a list of lines).
    """
    return [
        _beside(registry, candidate, one, alias)
        for one in registry.versions()
        if alias in one.aliases and one.name != candidate.name
    ]


def _beside(
    registry: Registry, candidate: RegisteredVersion, other: RegisteredVersion, alias: str
) -> dict[str, Any]:
    said = f"{other.label} is the {alias} of {other.name}"
    both = figures_of_listed(registry, [candidate, other])
    one, this = both[other.label], both[candidate.label]
    if not one["with"]:
        faults = [each["words"].removeprefix(_NO_F1) for each in (this, one) if not each["frames"]]
        lines = [
            f"{said}; not compared: {(faults or ['they held out too few of the same frames'])[0]}"
        ]
        return {"model": other.label, "figures": None, "words": lines}
    lines = [f"{said}: {one['words']}; this one {_scores(this)}"]
    if len(one["dives"]) > 1:
        dives = zip(one["dives"].items(), this["dives"].values(), strict=True)
        lines += [
            f"  {dive}: {_scores(was)}; this one {_scores(now)} on {was['frames']} frames"
            for (dive, was), now in dives
        ]
    return {"model": other.label, "figures": {"model": one, "candidate": this}, "words": lines}


def _tables(
    registry: Registry, versions: Sequence[RegisteredVersion]
) -> tuple[dict[str, pd.DataFrame], dict[str, str]]:
    """The held-out patches of each version by its label, or why they cannot be had."""
    try:
        datasets = {item.hash: item for item in list_datasets(registry.workspace / "datasets")}
    except ToktError as error:
        return {}, {version.label: str(error) for version in versions}
    tables, why = {}, {}
    for version in versions:
        try:
            tables[version.label] = _held_out(registry, version, datasets)
        except ToktError as error:
            why[version.label] = str(error)
    return tables, why


def _held_out(
    registry: Registry, version: RegisteredVersion, datasets: Mapping[str, DatasetVersion]
) -> pd.DataFrame:
    """The patches that a version held out, with what they are and which picture they are of."""
    recipe, table = registry.recipe(version), registry.held_out(version)
    if "target" not in table:
        raise ToktError(f"model {version.label} was trained by an older tokt")
    with fitting(version):
        flags = np.array([bool(one["obstacle"]) for one in recipe["classes"]])
        learnt = str(recipe["provenance"]["dataset_hash"])
        table = table.assign(obstacle=flags[table.target.to_numpy(np.int64)], digest=learnt)
        if learnt in datasets:
            pictures = datasets[learnt].frames[[*FRAME_KEY, "digest"]]
            table = table.drop(columns="digest").merge(pictures, on=FRAME_KEY)
        table["picture"] = table.digest + str(recipe["grid"])
    return table.loc[table.fold >= 0, [*_KEY, "fold", "obstacle_score"]]


def _groups(tables: Mapping[str, pd.DataFrame]) -> list[dict[str, pd.DataFrame]]:
    """Put each model with those that held out enough of the same patches."""
    groups: list[tuple[pd.DataFrame, dict[str, pd.DataFrame]]] = []
    for label, table in tables.items():
        for at, (common, group) in enumerate(groups):
            both = common.merge(table[_KEY])
            if len(both) and len(both) >= MIN_SHARE * max(len(common), len(table)):
                groups[at] = both, {**group, label: table}
                break
        else:
            groups.append((table[_KEY], {label: table}))
    return [group for _, group in groups]


def _on_same_frames(tables: Mapping[str, pd.DataFrame]) -> dict[str, dict[str, Any]]:
    """The figures of each model on the patches that are in all tables; empty where none is."""
    common = reduce(lambda one, other: one.merge(other), (table[_KEY] for table in tables.values()))
    if common.empty:
        return {}
    return {label: _figures(table.merge(common)) for label, table in tables.items()}


def _figures(table: pd.DataFrame) -> dict[str, Any]:
    """Of each dive, and their means; None where there are obstacles alone, or none."""
    truth, score = table.obstacle.to_numpy(bool), table.obstacle_score.to_numpy(np.float64)
    sides = truth.astype(np.int64), (score > 0).astype(np.int64), (CLEAR, OBSTACLE)
    of_dive = metrics_by(table.mission.to_numpy(object), truth, score, *sides)
    frames = table[FRAME_KEY].drop_duplicates().mission.value_counts()
    dives = {
        dive: {"frames": int(frames[dive]), **{key: one[key] for key in _FIGURES}}
        for dive, one in of_dive.items()
    }
    means = over_dives(of_dive)
    return {**{key: means[key] for key in _FIGURES}, "frames": int(frames.sum()), "dives": dives}


def _frames(one: Mapping[str, Any]) -> str:
    names = list(one["dives"])
    of = f" of {names[0]}" if len(names) == 1 else f", mean of {len(names)} dives"
    return f"{one['frames']} frames{of}"


def _roughly(tables: Mapping[str, pd.DataFrame]) -> str:
    """A warning where some learnt from other frames of these dives than the others did."""
    missions = set.intersection(*({*map(str, table.mission)} for table in tables.values()))
    first, *others = (held_out_units(table, missions) for table in tables.values())
    alike = all(other == first for other in others)
    return "" if alike else " (roughly: they were cross-validated in other parts)"


def _scores(one: Mapping[str, Any]) -> str:
    return ", ".join(f"{title} {_shown(one[key])}" for key, title in _FIGURES.items())


def _shown(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
