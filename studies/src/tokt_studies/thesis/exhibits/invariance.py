"""Sections 2.13 and 7.1: verdicts of LBP and Haralick under grey changes, rotation and noise."""

from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tokt.features.common.arrays import U8, Bools
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.training.rig.calibrate.frame_selection import evenly_spaced
from tokt_studies.baselines.thesis_models import TITLES
from tokt_studies.baselines.thesis_texture import GRID, resized_gray

from .exhibit import Claim, ClaimAgreement, Exhibit, StudyContext, Table
from .training_image_figures import LBP_KEYS, described

FRAMES = 24
UNCHANGED = 0.05
"""Share of changed verdicts up to which they count as unchanged."""
_NOISE_SEED = 16
GAMMA, GAIN, NOISE = "gamma 0.5", "gain 2", "noise of 1 grey level"
QUARTER, SMALL = "turned by 90 degrees", ("turned by 5 degrees", "turned by 10 degrees")
GREY, ROTATED = (GAMMA, GAIN), (QUARTER, *SMALL)


def invariance(context: StudyContext) -> Exhibit:
    """Share of patches whose verdict changes with the picture; needs labelled obstacles."""
    shown = [n for n in context.scored if context.obstacle_patches.get(n)]
    if not shown:
        raise ToktError("needs frames with labelled obstacles")
    frames = evenly_spaced(shown, FRAMES)
    shares = changed_shares(context, frames)
    caption = (
        f"Share of patches whose verdict changes with the picture, in {len(frames)} labelled "
        "frames that the models did not learn from. Obstacles and clear water weigh the same. "
        "Rotation is of each patch about its middle."
    )
    table = shares.rename(columns=TITLES).rename_axis("change").reset_index()
    return Exhibit(
        claims=(lbp_claim(shares), haralick_claim(shares)),
        tables=(Table("changed", caption, table),),
    )


def changed_shares(context: StudyContext, frames: Sequence[int]) -> pd.DataFrame:
    """Shares of changed verdicts: a row a change, a column an extractor's key."""
    noise = np.random.default_rng(_NOISE_SEED)
    changes: dict[str, Callable[[U8], U8]] = {
        GAMMA: lambda gray: _rounded(255 * np.sqrt(gray / 255.0)),
        GAIN: lambda gray: _rounded(2.0 * gray),
        NOISE: lambda gray: _rounded(gray + noise.normal(0, 1, gray.shape)),
        **{name: turned(degrees) for name, degrees in zip(SMALL, (5, 10), strict=True)},
    }
    rows = []
    for number, frame in context.decoded(frames):
        gray = resized_gray(frame)
        # Without the rows beyond the grid, which a turned frame would have as columns within it.
        gray = gray[: GRID.rows * GRID.patch_size(*gray.shape)[0]]
        before = _verdicts(context, gray)
        after = {name: _verdicts(context, change(gray)) for name, change in changes.items()}
        after[QUARTER] = _verdicts_turned(context, gray)
        truth = context.truth(number)
        for name, verdicts in after.items():
            for key, said in verdicts.items():
                changed = pd.DataFrame({"truth": truth, "changed": said != before[key]})
                rows.append(changed[truth >= 0].assign(change=name, key=key))
    if not rows:
        raise ToktError("no frame with labelled obstacles can be read")
    by_class = pd.concat(rows).groupby(["change", "key", "truth"])["changed"].mean()
    shares = by_class.groupby(["change", "key"]).mean().unstack("key")
    return shares.loc[[*GREY, *ROTATED, NOISE], list(TITLES)]


def _rounded(gray: NDArray[Any]) -> U8:
    return np.asarray(np.clip(np.rint(gray), 0, 255), np.uint8)


def turned(degrees: float) -> Callable[[U8], U8]:
    """A change that turns each patch about its middle; what comes in is from beside it."""

    def change(gray: U8) -> U8:
        found = gray.copy()
        for y0, y1, x0, x1 in GRID.boxes(*gray.shape):
            turn = cv2.getRotationMatrix2D(((x0 + x1 - 1) / 2, (y0 + y1 - 1) / 2), degrees, 1.0)
            turn[:, 2] -= x0, y0
            found[y0:y1, x0:x1] = cv2.warpAffine(
                gray, turn, (x1 - x0, y1 - y0), borderMode=cv2.BORDER_REFLECT
            )
        return found

    return change


def _verdicts(context: StudyContext, gray: U8, grid: Grid = GRID) -> dict[str, Bools]:
    """The patches that are other, by model."""
    return {
        key: context.thesis[key].classifier.predict(rows) == 1
        for key, rows in described(gray, grid).items()
    }


def _verdicts_turned(context: StudyContext, gray: U8) -> dict[str, Bools]:
    """The same of the frame turned by a quarter, patch by patch in the frame's own order."""
    quarter = np.ascontiguousarray(np.rot90(gray))
    grid = Grid(GRID.cols, GRID.rows, quarter.shape[1])
    said = _verdicts(context, quarter, grid)
    return {
        key: np.rot90(one.reshape(grid.rows, grid.cols), -1).ravel() for key, one in said.items()
    }


def lbp_claim(shares: pd.DataFrame) -> Claim:
    """Whether LBP's verdicts stay under monotone grey changes and rotation."""
    most = shares.loc[[*GREY, *ROTATED], list(LBP_KEYS)].max()
    unchanged = most <= UNCHANGED
    return Claim(
        "LBP is unchanged by monotone grey changes and by rotation",
        "sections 2.13 and 7.1",
        "; ".join(
            f"{TITLES[key]}: at most {share:.1%} of verdicts change, "
            f"{shares[key][[*GREY, *ROTATED]].idxmax()}"
            for key, share in most.items()
        ),
        f"to agree: both {UNCHANGED:.0%} at most; in part: one",
        agreement=ClaimAgreement.of(unchanged.all(), unchanged.any()),
    )


def haralick_claim(shares: pd.DataFrame) -> Claim:
    """Whether Haralick's verdicts change more under rotation, and under small noise."""
    rotated = shares.loc[list(ROTATED)].mean()
    noisy = shares.loc[NOISE]
    turns = rotated["haralick"] > rotated[list(LBP_KEYS)].max()
    noise = noisy["haralick"] > UNCHANGED
    return Claim(
        "Haralick changes more under rotation, and is sensitive to small noise",
        "sections 2.13 and 7.1",
        ", ".join(
            f"{title}: {rotated[key]:.1%} turned, {noisy[key]:.1%} with noise"
            for key, title in TITLES.items()
        ),
        f"to agree: rotation changes more verdicts than LBP's, noise of one grey level over "
        f"{UNCHANGED:.0%}; in part: one of both",
        agreement=ClaimAgreement.of(turns and noise, turns or noise),
    )
