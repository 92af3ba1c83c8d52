"""Figures 3.8 and 3.9: the false line, the number of disparities, and what the cut margin costs."""

from collections.abc import Sequence

import cv2
import numpy as np
import pandas as pd

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.training.rig.calibrate.frame_selection import evenly_spaced
from tokt_studies.baselines import thesis_stereo
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.thesis.patch_scores import Truth

from .disparity_figures import at_thesis_size, in_map, pair_of, thesis_map
from .exhibit import Claim, ClaimAgreement, Exhibit, StudyContext, Table

OPEN_FRAMES, SWEPT_FRAMES, MIRRORED_FRAMES = 6, 4, 8
"""Pairs of open water, pairs that the number of disparities is swept in, and pairs mirrored."""
SWEEP = (16, 48, 80, thesis_stereo.N_DISPARITIES_PX, 144, 176, 208, 240)
"""Numbers of disparities in pixels, multiples of 16 as block matching wants them."""
_SAME_PLACE = 0.5
"""Of what is white in any map, white in all of them: a line that stays where it is."""
_LOST, _MOSTLY = 0.1, 0.5
"""By how much less must be seen at the right edge than at the left, and in which part of pairs."""
_MIN_PATCHES = 10
_EDGES = {"left": 1, "right": -1}


def margin_figures(context: StudyContext) -> Exhibit:
    """The exhibit of the margin; needs stereo pairs."""
    if not context.pairs:
        raise ToktError("the mission has no stereo pairs")
    empty = [
        thesis_map(*pair_of(context, number))
        for number in evenly_spaced(context.open_water_pairs, OPEN_FRAMES)
    ]
    sweep = matched_by_number(
        [pair_of(context, n) for n in evenly_spaced(context.textured_pairs, SWEPT_FRAMES)]
    )
    seen = seen_at_the_edges(context)
    edges = (
        "Part of the labelled obstacle that is white in the thesis's map without its right "
        f"{thesis_stereo.CROP_PX} px, and part in these. The pair is moved until the obstacle "
        "touches the left edge; its mirror image has it at the right one."
    )
    return Exhibit(
        claims=(line_claim(empty), sweep_claim(sweep), edge_claim(seen)),
        tables=(
            Table("sweep", "Matched part of the whole map, in per cent; a row a pair.", sweep),
            Table("edges", edges, seen),
        ),
    )


def line_claim(maps: Sequence[U8]) -> Claim:
    """Whether a line that is nothing stands at the right of every map of open water."""
    claim = Claim.about(
        "a false vertical line at the right, the same in all pictures",
        "figures 3.8 and 3.9; put down to the calibration or the housing",
    )
    if not maps:
        return claim("not measured", "no pair shows open water alone")
    white = np.stack(maps) > 0
    cut = thesis_stereo.CROP_PX
    parts = white[..., :cut], white[..., -cut:], white[..., cut:-cut]
    left, right, between = (float(part.mean()) for part in parts)
    alike = float(white.all(axis=0).sum() / max(white.any(axis=0).sum(), 1))
    whitest = right > max(left, between)
    return claim(
        f"white in {len(maps)} pairs of open water: left margin {left:.2%}, right {right:.2%}, "
        f"between {between:.2%}; {alike:.0%} of it in all of them",
        "to agree: the right is whitest, and half of it stays in place; in part: the first. It is "
        "the picture's edge, bent inwards by undistorting about a corner",
        agreement=ClaimAgreement.of(whitest and alike >= _SAME_PLACE, whitest),
    )


def matched_by_number(pairs: Sequence[tuple[U8, U8]]) -> pd.DataFrame:
    """Matched part of the map in per cent: a row a pair, a column a number of `SWEEP`."""
    rows = []
    for left, right in pairs:
        views = thesis_stereo.undistorted_pair(at_thesis_size(left), at_thesis_size(right))
        maps = {number: thesis_stereo.block_matching(number).compute(*views) for number in SWEEP}
        unmatched = 16 * (thesis_stereo.MIN_DISPARITY_PX - 1)
        rows.append({n: 100 * float((found > unmatched).mean()) for n, found in maps.items()})
    return pd.DataFrame(rows, columns=list(SWEEP))


def sweep_claim(sweep: pd.DataFrame) -> Claim:
    """Whether matches fall as the number of disparities grows."""
    claim = Claim.about("the larger numberOfDisparities, the fewer matches", "section 3.1.6")
    if sweep.empty:
        return claim("not measured", "no pair shows anything")
    median = sweep.median()
    falls = median.diff().dropna() < 0
    return claim(
        f"matched part of the map: {median.iloc[0]:.2f} % with {SWEEP[0]}, "
        f"{median[thesis_stereo.N_DISPARITIES_PX]:.2f} % with {thesis_stereo.N_DISPARITIES_PX}, "
        f"{median.iloc[-1]:.2f} % with {SWEEP[-1]}",
        "to agree: falls at each step; in part: from first to last. At uniqueness ratio 0 each "
        "textured pixel gets some disparity",
        agreement=ClaimAgreement.of(falls.all(), median.iloc[-1] < median.iloc[0]),
    )


def seen_at_the_edges(context: StudyContext) -> pd.DataFrame:
    """Seen parts of labelled obstacles that touch either edge: a row a pair, nan without any."""
    truths = {n: truth for n, truth in context.left_labelled.items() if n in context.pairs}
    enough = [number for number, truth in truths.items() if (truth == 1).sum() >= _MIN_PATCHES]
    rows = []
    for number in evenly_spaced(enough, MIRRORED_FRAMES):
        pair, truth = pair_of(context, number), truths[number]
        first = int(np.flatnonzero((truth.reshape(GRID.rows, GRID.cols) == 1).any(axis=0))[0])
        moved = [_moved_left(one, first * one.shape[1] // GRID.cols) for one in pair]
        there = np.zeros((GRID.rows, GRID.cols), np.int8)
        there[:, : GRID.cols - first] = truth.reshape(there.shape)[:, first:] == 1
        row: dict[str, float] = {"frame": number}
        for edge, step in _EDGES.items():
            left, right = (np.ascontiguousarray(one[:, ::step]) for one in moved)
            row |= _seen(thesis_map(left, right), there[:, ::step].ravel(), edge)
        rows.append(row)
    columns = ["frame", *(f"{e}{part}" for e in _EDGES for part in ("", ", in the margin"))]
    return pd.DataFrame(rows, columns=columns)


def _moved_left(picture: U8, columns: int) -> U8:
    """A picture without its first columns; its last one stands where none is left."""
    kept = picture[:, columns:]
    return np.asarray(cv2.copyMakeBorder(kept, 0, 0, 0, columns, cv2.BORDER_REPLICATE), np.uint8)


def _seen(stretched: U8, there: Truth, edge: str) -> dict[str, float]:
    """Part of an obstacle that is white in a map without its right margin, and part in that."""
    obstacle = in_map(there)
    all_of_it = max(int(obstacle.sum()), 1)
    white = (obstacle & (stretched > 0))[:, : -thesis_stereo.CROP_PX]
    return {
        edge: float(white.sum() / all_of_it),
        f"{edge}, in the margin": float(obstacle[:, -thesis_stereo.CROP_PX :].sum() / all_of_it),
    }


def edge_claim(seen: pd.DataFrame) -> Claim:
    """Whether an obstacle at the right is seen worse as the right margin is cut off."""
    claim = Claim.about(
        "with the right margin cut off, obstacles at the right are seen worse", "section 6.1.1"
    )
    if seen.empty:
        return claim("not measured", "no pair has an obstacle labelled")
    worse = float((seen["right"] < (1 - _LOST) * seen["left"]).mean())
    cut = seen["right, in the margin"].median()
    return claim(
        f"in {len(seen)} mirrored pairs {seen['left'].median():.0%} of the obstacle is white at "
        f"the left edge, {seen['right'].median():.0%} at the right. {worse:.0%} of pairs are worse "
        f"there; {cut:.0%} lies in the margin",
        f"to agree: half of the pairs worse by {_LOST:.0%}; in part: that much in the margin. "
        "Undistorting moves the right edge inwards, and empties it",
        agreement=ClaimAgreement.of(worse >= _MOSTLY, cut >= _LOST),
    )
