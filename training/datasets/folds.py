"""Splits that cannot leak: whole dives are held out, or blocks of frames with a gap on both sides.

Neighbour frames of a dive are near copies, so a random split would test a model on what it
was trained on. There is no random split here to choose. Blocks of a dive share its light, water
and camera: how a model does on another dive is only seen where whole dives are held out.
"""

import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from sklearn.model_selection import StratifiedGroupKFold, StratifiedKFold

from tokt.features.common.arrays import F64, I64, Bools
from tokt.features.common.errors import ToktError

DIVE, BLOCK = "dive", "block"
"""What is held out together."""
MAX_JUDGED = 1_000_000
"""Of more patches than these, some are cross-validated: 10,000 frames tell how good a model is."""
BLOCK_FRAMES = 20
EMBARGO_FRAMES = 5
BLOCK_SIZES = (BLOCK_FRAMES, 10, 5)
"""Frames a block: the most that the labels can bear. Frames nearer than those of the last are too
alike to be tested on each other."""
FOLDS = 5
MAX_BLOCKS_ALONE = 10
"""Blocks of one labelled frame each that are held out one by one; each is a fold."""
LEAST_FRAMES = 6
"""Labelled frames that training takes at the least."""
LEAST_BLOCKS = 3
"""Blocks that each class must be in: one to test on, one to choose by and one to learn from."""
MAX_HELD_OUT_ALONE = 16
"""More dives than these are held out several at a time: each fold is a cross-validation more."""


FULL_DIVE = 6_000
"""Labelled patches, those of 60 frames of the usual grid: a longer dive counts no more."""


@dataclass(frozen=True)
class Fold:
    """Rows of a table that was split; one within the embargo of a test frame is in neither."""

    train: I64
    test: I64


def block_of(mission: str, position: int, frames: int = BLOCK_FRAMES) -> str:
    """Return the group of a frame: `frames` that follow each other in one mission, both cameras."""
    return f"{mission}#{position // frames:05d}"


def positions_of(patches: pd.DataFrame) -> I64:
    """Return each row's position in its dive; in tables without positions it is the number."""
    return np.asarray(patches["position" if "position" in patches else "frame"])


def embargo_of(block_frames: int | None) -> int:
    """Return the frames left out on either side of a test block: a quarter of a block."""
    return EMBARGO_FRAMES * (block_frames or 0) // BLOCK_FRAMES


def blocked_folds(
    patches: pd.DataFrame,
    targets: I64,
    n_folds: int = FOLDS,
    embargo_frames: int = EMBARGO_FRAMES,
    single_pictures: Collection[str] = (),
) -> list[Fold]:
    """Split patches into folds of whole groups, each with about its share of every class.

    Parameters
    ----------
    patches : DataFrame
        Columns mission, group, and position or else frame.
    targets : array of int, shape (n_patches,)
    embargo_frames : int
        Training rows this many frames or fewer from a test frame of the same mission are
        dropped.
    single_pictures : collection of str
        Missions of which no rows are dropped: their frames are no sequence.

    Raises
    ------
    ToktError
        If there are fewer groups than folds, or a fold's training part lacks a class.
    """
    _check_groups(patches, targets, n_folds)
    classes = np.unique(targets)
    mission, position = patches.mission.to_numpy(), positions_of(patches)
    folds = []
    for train, test in _whole_groups(patches.group.to_numpy(), targets, n_folds):
        kept = train[~_near(mission, position, train, test, embargo_frames, single_pictures)]
        lacking = np.setdiff1d(classes, targets[kept])
        if len(lacking):
            raise ToktError(
                f"a fold's training part lacks {_labels(patches, np.isin(targets, lacking))} once "
                "the neighbour frames of its test part are left out. Label more of the mission, or "
                "ask for fewer folds"
            )
        folds.append(Fold(kept, test))
    return folds


def _check_groups(patches: pd.DataFrame, targets: I64, n_folds: int) -> None:
    groups = patches.group.to_numpy()
    n_groups = len(np.unique(groups))
    if n_groups < n_folds:
        raise ToktError(
            f"{n_groups} blocks of frames are too few for {n_folds} folds. Label more of the "
            "mission, or leave --folds out: there are then as many as the labels can bear"
        )
    for target in np.unique(targets):
        if len(np.unique(groups[targets == target])) < 2:
            raise ToktError(
                f"{_labels(patches, targets == target)} is in a single block of frames only, or is "
                "left in one once others are held out. Label it in more places of the mission, at "
                "best in as many blocks as there are folds"
            )
    if np.bincount(targets).max() < n_folds:
        raise ToktError(f"no class has as many patches as there are folds ({n_folds})")


def _labels(patches: pd.DataFrame, rows: Bools) -> str:
    """The labels of a class, for people."""
    return ", ".join(sorted(patches.label[rows].unique())) if "label" in patches else "one class"


def _whole_groups(
    groups: NDArray[np.object_], targets: I64, n_folds: int
) -> Iterator[tuple[I64, I64]]:
    """Training and test rows of each fold. Neither splitter shuffles."""
    splitter: StratifiedGroupKFold | StratifiedKFold = StratifiedGroupKFold(n_folds)
    if len(np.unique(groups)) == len(groups):
        # A row a group: the same promise, and quick for a folder of 100,000 patches. Rows stay
        # in their order, so that files cut one after the other mostly stay together.
        splitter = StratifiedKFold(n_folds)
    with warnings.catch_warnings():
        # scikit-learn says so when a class is too rare for every fold to test it.
        warnings.simplefilter("ignore", UserWarning)
        yield from splitter.split(groups, targets, groups)


def held_out_together(
    patches: pd.DataFrame, sites: Mapping[str, str] | None = None
) -> NDArray[np.object_]:
    """For each patch the name of its dive, or of its site; of dives that share a picture, of all.

    In `patches` groups that share a picture have one name. `sites` has the site by mission; a
    mission that has none is a site of its own.
    """
    named = {name: (sites or {}).get(name, name) for name in patches.mission.unique()}
    return joined_names(patches.mission.map(named), patches.group, "+".join)


def joined_names(
    names: pd.Series, shared: pd.Series, join: str | Callable[[Iterable[str]], str]
) -> NDArray[np.object_]:
    """For each row its name; of names that share something, directly or by others, one for all.

    `join` makes one name of several in rising order, as for pandas' `transform`.
    """
    name, known = pd.factorize(names, sort=True)
    thing, things = pd.factorize(shared)
    size = len(known) + len(things)
    edges = (np.ones(len(name)), (name, len(known) + thing))
    _, component = connected_components(coo_array(edges, shape=(size, size)), directed=False)
    joined = pd.Series(known, dtype=object).groupby(component[: len(known)]).transform(join)
    return np.asarray(joined.to_numpy()[name], object)


def dive_folds(
    patches: pd.DataFrame,
    targets: I64,
    sites: Mapping[str, str],
    n_folds: int = FOLDS,
    refuse: bool = True,
    alone: int = MAX_HELD_OUT_ALONE,
) -> list[Fold]:
    """Hold out whole sites, or whole dives where fewer than two sites can be: one a fold.

    More than `alone` of them are shared out among `n_folds` folds. There is no fold
    where there is one dive, or all share pictures. Patches and targets are as in `blocked_folds`,
    sites as in `held_out_together`. A fold whose training part lacks a class is left out; with
    `refuse` it raises ToktError.
    """
    for grouped in (sites, {}):
        units = held_out_together(patches, grouped)
        names, unit = np.unique(units, return_inverse=True)
        pairs: Iterator[tuple[I64, I64]] = (
            (np.flatnonzero(unit != one), np.flatnonzero(unit == one)) for one in range(len(names))
        )
        if len(names) > alone:
            shared = _whole_groups(units, targets, min(n_folds, len(names)))
            pairs = (pair for pair in shared if len(pair[1]))
        folds = []
        for train, test in pairs:
            lacking = np.setdiff1d(targets, targets[train])
            if not len(lacking):
                folds.append(Fold(train, test))
            elif refuse and len(names) > 1:
                labels = _labels(patches, np.isin(targets, lacking))
                raise ToktError(
                    f"without {', '.join(np.unique(units[test]))}, which is held out as a whole, "
                    f"nothing labelled {labels} is left to learn from. Label it in other dives "
                    "too, or hold out blocks of frames (--split block)"
                )
        if len(folds) > 1:
            return folds
    return []


def some_units(units: NDArray[np.object_], kinds: Sequence[I64], most: int, of_kind: int) -> I64:
    """Rows of whole units, drawn with a fixed seed, up to `most`; `of_kind` units of each kind.

    A unit is kept or left out as a whole. `kinds`, one array of int of shape (n_patches,) each, are
    such as classes and sites; below 0 is none. `of_kind` goes before `most`.
    """
    unit = pd.factorize(units)[0]
    order = np.random.default_rng(0).permutation(unit.max() + 1)
    having = (
        order[np.isin(order, unit[kind == one])]
        for kind in kinds
        for one in np.unique(kind[kind >= 0])
    )
    first = [number for numbers in having for number in numbers[:of_kind].tolist()]
    order = np.array(list(dict.fromkeys([*first, *order.tolist()])))
    kept = np.cumsum(np.bincount(unit)[order]) <= most
    kept |= np.isin(order, first)
    return np.flatnonzero(np.isin(unit, order[kept]))


@dataclass(frozen=True)
class Dives:
    """The dive of each patch, and how much each dive counts in learning."""

    number: I64  # (n_patches,)
    times: F64  # (n_dives,): how many times its usual share a dive counts
    # (n_dives,): whether it was added to a model, which keeps the scaler and map of the others
    added: Bools

    @classmethod
    def of(cls, missions: NDArray[Any], added: Mapping[str, float] | None = None) -> Self:
        """Return the dives of patches, given each one's mission, and `added` as `Split` has it."""
        number, names = pd.factorize(missions)
        times = [(added or {}).get(name, 1.0) for name in names]
        return cls(number, np.array(times), np.isin(names, list(added or {})))

    def part(self, rows: I64) -> "Dives":
        """Return the dives of some patches."""
        return replace(self, number=self.number[rows])

    def weights(self) -> F64:
        """Return a weight for each patch, by what its dive holds; 1 in the mean.

        A dive counts by the root of its patches, up to `FULL_DIVE`: three frames do not count as
        much as sixty, and hundreds no more. Chosen with whole sites held out, against dives that
        all count the same.
        """
        patches = np.maximum(np.bincount(self.number, minlength=len(self.times)), 1)
        shares = self.times * np.sqrt(np.minimum(patches, FULL_DIVE)) / patches
        weights = shares[self.number]
        return np.asarray(weights * (len(weights) / weights.sum()), np.float64)


def sites_named(texts: Sequence[str], missions: Sequence[str]) -> dict[str, str]:
    """Site by mission, from texts such as ``basin=a,b``; ToktError if they cannot be meant."""
    sites: dict[str, str] = {}
    for text in texts:
        site, _, listed = text.partition("=")
        for mission in listed.split(","):
            if not site or not mission:
                raise ToktError(f"--site is something like basin=dive_1,dive_2, not {text!r}")
            if mission not in missions:
                raise ToktError(
                    f"--site {text}: no mission {mission!r} (there are: {', '.join(missions)})"
                )
            if sites.setdefault(mission, site) != site:
                raise ToktError(f"mission {mission} is in two sites, {sites[mission]} and {site}")
    return sites


def every_nth_block(patches: pd.DataFrame, targets: I64, n: int, embargo_frames: int) -> Fold:
    """Hold back every n-th group in time order: the same rule for every mission.

    Starts at the first offset that leaves every class in both parts. Arguments are as in
    `blocked_folds`; group names sort in time order, as `block_of` makes them.

    Raises ToktError if no offset leaves every class in both parts.
    """
    names, place = np.unique(patches.group.to_numpy(), return_inverse=True)
    mission, position = patches.mission.to_numpy(), positions_of(patches)
    classes = len(np.unique(targets))
    for offset in (1, *range(n)):
        held = (place % n) == offset % n
        train, test = np.flatnonzero(~held), np.flatnonzero(held)
        if not len(test) or len(names) < n:
            continue
        train = train[~_near(mission, position, train, test, embargo_frames)]
        if len(np.unique(targets[train])) == len(np.unique(targets[test])) == classes:
            return Fold(train, test)
    raise ToktError("too few blocks of frames to hold a part of the mission back; label more of it")


def _near(
    mission: NDArray[np.object_],
    position: I64,
    train: I64,
    test: I64,
    embargo_frames: int,
    single_pictures: Collection[str] = (),
) -> Bools:
    """Which training rows lie within the embargo of a test frame."""
    near = np.zeros(len(train), bool)
    for name in set(mission[test]).difference(single_pictures):
        tested = np.unique(position[test][mission[test] == name])
        candidates = position[train]
        after = np.searchsorted(tested, candidates).clip(0, len(tested) - 1)
        before = (after - 1).clip(0)
        distance = np.minimum(
            np.abs(tested[after] - candidates), np.abs(tested[before] - candidates)
        )
        near |= (mission[train] == name) & (distance <= embargo_frames)
    return near
