"""Split: what a cross-validation holds out together, chosen by the labels that there are."""

import ast
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Self

import numpy as np
import pandas as pd

from tokt.features.common.arrays import I64
from tokt.features.common.errors import ToktError, counted, naming

from .dataset import DatasetVersion
from .folds import (
    BLOCK,
    BLOCK_FRAMES,
    BLOCK_SIZES,
    DIVE,
    FOLDS,
    LEAST_BLOCKS,
    LEAST_FRAMES,
    MAX_BLOCKS_ALONE,
    MAX_HELD_OUT_ALONE,
    MAX_JUDGED,
    Dives,
    Fold,
    block_of,
    blocked_folds,
    dive_folds,
    embargo_of,
    held_out_together,
    positions_of,
    sites_named,
    some_units,
)

PATCH, SINGLE = "patch", "single_pictures"
MAX_CHOSEN_ALONE = 6
"""Held out together inside a training part: choices need fewer folds than figures do."""
SITES, DIVES, BLOCKS = "sites", "dives", "blocks of frames"


@dataclass(frozen=True)
class Split:
    """What a cross-validation holds out together, and what counts the same in learning."""

    folds: int  # of blocks, or of more dives than can be held out one by one
    embargo_frames: int  # between blocks of one dive
    by: str = BLOCK  # or DIVE
    weight: str = PATCH  # or DIVE: whether each patch counts the same, or each dive
    # By mission: where it is by dive, all dives of a site are held out together.
    sites: Mapping[str, str] = field(default_factory=dict)
    # By mission: how many times its usual share a dive counts that was added to a model, where
    # each dive counts the same. Scaler and map are those of the other dives.
    added: Mapping[str, float] = field(default_factory=dict)
    single_pictures: tuple[str, ...] = ()  # missions whose frames are no sequence: no embargo

    def __post_init__(self) -> None:
        if self.folds < 2 or not 0 <= self.embargo_frames < 1 << 31:
            raise ValueError(f"{self.folds} folds, {self.embargo_frames} frames apart")
        if self.by not in (DIVE, BLOCK) or self.weight not in (DIVE, PATCH):
            raise ValueError(f"split by {self.by}, weight by {self.weight}")
        if not all(0 < times < math.inf for times in self.added.values()):
            raise ValueError(f"added dives count {self.added} times their share")

    @classmethod
    def of(
        cls,
        dataset: DatasetVersion,
        folds: int | None = None,
        embargo_frames: int | None = None,
        by: str | None = None,
        weight: str | None = None,
        sites: Sequence[str] = (),
        with_choices: bool = True,
    ) -> Self:
        """The split that is asked for; for what is left open, by dive where there are several.

        Folds that are left open are as many as the labels can bear, see `borne_by`, which also
        takes `with_choices`; the embargo is then that of the dataset's blocks. `sites` are as for
        `sites_named`; none for those that the dataset was built with. Raises ToktError if dives are
        to be held out and there is one only, something is misspelt, or too little is labelled.
        """
        missions = sorted(dataset.patches.mission.unique())
        usual = DIVE if len(missions) > 1 else None
        for option, value, known in (
            ("split", by, (DIVE, BLOCK)),
            ("weight", weight, (DIVE, PATCH)),
        ):
            if value is not None and value not in known:
                raise ToktError(f"--{option} is {' or '.join(known)}, not {value!r}")
        named = sites_named(sites, missions) if sites else _texts(dataset.sites)
        if embargo_frames is None:
            embargo_frames = embargo_of(dataset.block_frames)
        split = cls(
            folds=folds or FOLDS,
            embargo_frames=embargo_frames,
            by=by or usual or BLOCK,
            weight=weight or usual or PATCH,
            sites=named,
            single_pictures=dataset.single_pictures,
        )
        targets = dataset.targets()
        if by == DIVE and not dive_folds(dataset.patches, targets, named, split.folds, False):
            raise ToktError(
                f"dataset {dataset.label} cannot be split by dive: it takes two dives with every "
                "class, without a common picture; --split block holds out blocks of frames"
            )
        if folds is None:
            with naming(f"dataset {dataset.label}"):
                blocks = dataset.block_frames
                split = split.borne_by(dataset.patches, targets, blocks, with_choices, by is None)
        return split

    @classmethod
    def logged(cls, parameters: Mapping[str, str]) -> Self:
        """What a run's parameters say; an older tokt's are by block, each patch the same."""
        return cls(
            int(parameters["split_folds"]),
            int(parameters["split_embargo_frames"]),
            parameters.get("split_by", BLOCK),
            parameters.get("split_weight", PATCH),
            _texts(ast.literal_eval(parameters.get("split_sites", "{}"))),
            {
                str(mission): float(times)
                for mission, times in ast.literal_eval(parameters.get("split_added", "{}")).items()
            },
            tuple(map(str, ast.literal_eval(parameters.get("split_single_pictures", "()")))),
        )

    def parameters(self) -> dict[str, Any]:
        """Return what is logged of it; what an older tokt did not have only where it says more."""
        return {name: value for name, value in asdict(self).items() if name != SINGLE or value}

    @property
    def inner(self) -> Self:
        """Of the cross-validation inside a training part: one fold less."""
        return replace(self, folds=max(2, self.folds - 1))

    def cut(self, patches: pd.DataFrame, targets: I64, to_choose: bool = False) -> list[Fold]:
        """Folds of whole dives or sites where it is by dive and there are several; else of blocks.

        Of the patches that are `judged`; to choose, of all. For a choice inside a training part
        (`to_choose`) a dive without which a class is lost stays in training, and so is in no fold's
        test part; where fewer than two can be held out, the folds are of blocks.

        Raises ToktError as `dive_folds` and `blocked_folds`.
        """
        folds: list[Fold] = []
        rows = np.arange(len(patches)) if to_choose else self.judged(patches, targets)
        patches, targets = patches.iloc[rows], targets[rows]
        if self.by == DIVE:
            alone = MAX_CHOSEN_ALONE if to_choose else MAX_HELD_OUT_ALONE
            folds = dive_folds(patches, targets, self.sites, self.folds, not to_choose, alone)
        if not folds:
            single = self.single_pictures
            folds = blocked_folds(patches, targets, self.folds, self.embargo_frames, single)
        return [Fold(rows[fold.train], rows[fold.test]) for fold in folds]

    def check(self, patches: pd.DataFrame, targets: I64, with_choices: bool = True) -> None:
        """Raise ToktError unless patches can be cross-validated, choices inside each fold too."""
        for fold in self.cut(patches, targets):
            if with_choices:
                self.inner.cut(patches.iloc[fold.train], targets[fold.train], to_choose=True)

    def borne_by(
        self,
        patches: pd.DataFrame,
        targets: I64,
        block_frames: int | None,
        with_choices: bool = True,
        or_blocks: bool = False,
    ) -> Self:
        """Return this split with as many folds as the labelled frames can bear, five at the most.

        Where each block has one labelled frame and there are few, each is held out alone. Patches
        and targets are as in `blocked_folds`, cut into blocks of `block_frames`. `with_choices`
        says whether something is chosen inside each training part, as for `check`. With `or_blocks`
        blocks are held out where a dive alone has too few to choose by.

        Raises ToktError where two folds are too many: it says how many more frames are needed.
        """
        words = with_choices and block_frames and too_few_frames(patches, targets, block_frames)
        if words:
            raise ToktError(words)
        blocks = patches.groupby("group").frame.nunique(dropna=False)
        of_class = patches.groupby(["mission", targets]).group.nunique()
        if of_class.min() >= FOLDS * LEAST_BLOCKS:
            return self  # each dive has plenty, and of a million patches `check` takes a minute
        few = len(blocks) <= MAX_BLOCKS_ALONE and blocks.max() == 1
        numbers = [*([len(blocks)] if few else []), *range(FOLDS, 1, -1)]
        for folds in numbers:
            split = replace(self, folds=folds)
            try:
                split.check(patches, targets, with_choices)
            except ToktError as error:
                why = error
            else:
                return split
        if self.by == DIVE and or_blocks:
            self.cut(patches, targets)  # a class that one dive alone has is no matter of choices
            return replace(self, by=BLOCK).borne_by(patches, targets, block_frames, with_choices)
        raise why

    def judged_words(self, dataset: DatasetVersion) -> str:
        """How many patches are judged, where it is not all of them."""
        total = len(dataset.patches)
        judged = len(self.judged(dataset.patches, dataset.targets()))
        what = "whole blocks of frames" if dataset.block_frames else "single ones"
        if judged == total:
            return ""
        return f" Judged are {judged:,} of {total:,} patches: {what}, drawn by lot."

    def unit(self, patches: pd.DataFrame) -> str:
        """What `cut` holds out as a whole, for people."""
        for what, grouped in ((SITES, self.sites), (DIVES, {})):
            several = len(pd.unique(held_out_together(patches, grouped))) > 1
            if self.by == DIVE and several and (grouped or what == DIVES):
                return what
        return BLOCKS

    def dives(self, patches: pd.DataFrame) -> Dives | None:
        """The dive of each patch where there are several that count the same, for `fit_rows`."""
        several = self.weight == DIVE and patches.mission.nunique() > 1
        return Dives.of(patches.mission.to_numpy(), self.added) if several else None

    def judged(self, patches: pd.DataFrame, targets: I64) -> I64:
        """Rows to cross-validate: all, or of more than `MAX_JUDGED` some blocks of every site."""
        if len(patches) <= MAX_JUDGED:
            return np.arange(len(patches))
        site = pd.factorize(patches.mission.map(self.sites))[0]
        blocks = patches.group.to_numpy(object)
        return some_units(blocks, (targets, site), MAX_JUDGED, 2 * self.folds)


def _texts(sites: Mapping[Any, Any]) -> dict[str, str]:
    """Sites out of a file or a database, whatever somebody wrote there."""
    return {str(mission): str(site) for mission, site in sites.items()}


def too_few_frames(patches: pd.DataFrame, targets: I64, block_frames: int) -> str:
    """How many more frames must be labelled, and with what; empty where there are enough.

    Patches and targets are as in `blocked_folds`, cut into blocks of `block_frames`.
    """
    frames = len(patches[["mission", "frame"]].drop_duplicates())
    lacking = {
        ", ".join(sorted(patches.label[targets == target].unique())): LEAST_BLOCKS - blocks
        for target, blocks in patches.groupby(targets).group.nunique().items()
        if blocks < LEAST_BLOCKS
    }
    more = max(LEAST_FRAMES - frames, *lacking.values(), 0)
    if not more:
        return ""
    with_what = " and ".join(f"{number} with {labels}" for labels, number in lacking.items())
    unit = "of them" if block_frames == 1 else "blocks of them"
    words = (
        f"training takes {LEAST_FRAMES} labelled frames or more, and each class in {LEAST_BLOCKS} "
        f"{unit}; there are {counted(frames, 'labelled frame')}. Label {more} more"
    )
    words += f", {with_what}" if with_what else ""
    if block_frames == 1:
        return words
    return (
        f"{words}. A block is {block_frames} frames that follow each other: near copies, which "
        "count as one. If they are single photographs, give tokt dataset build --block 1"
    )


def bearable_block(
    patches: pd.DataFrame,
    targets: I64,
    sites: Mapping[str, str],
    single_pictures: Mapping[str, str],
    scene_frames: int = 0,
) -> int:
    """Return the frames of a block: the most of some sizes with which there can be three folds.

    The sizes are `BLOCK_SIZES`, and before these the frames for which a scene stays the same where
    it does so for longer. It is the least of them where there can be none.

    Parameters
    ----------
    patches : DataFrame
        Columns mission, position, label.
    targets : array of int, shape (n_patches,)
    sites : mapping of str to str
        Site by mission.
    single_pictures : mapping
        Missions whose frames are no sequence: each frame is a block of its own.
    scene_frames : int
        Frames for which a scene stays the same.
    """
    by = DIVE if patches.mission.nunique() > 1 else BLOCK
    for block in (*([scene_frames] if scene_frames > BLOCK_FRAMES else []), *BLOCK_SIZES):
        single = tuple(single_pictures)
        split = Split(FOLDS, embargo_of(block), by, sites=sites, single_pictures=single)
        group = blocks_of(patches, block, single_pictures)
        try:
            split = split.borne_by(patches.assign(group=group), targets, block)
        except ToktError:
            continue
        if split.folds >= LEAST_BLOCKS:
            break
    return block


def blocks_of(
    frames: pd.DataFrame, block_frames: int, single_pictures: Collection[str]
) -> list[str]:
    """Return the block of each row of a table with mission and position, see `block_of`."""
    return [
        block_of(mission, int(position), 1 if mission in single_pictures else block_frames)
        for mission, position in zip(frames.mission, positions_of(frames), strict=True)
    ]
