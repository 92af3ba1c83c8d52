"""Figures 3.1 to 3.7: whether the printed calibration straightens lines and makes rows agree."""

from collections.abc import Sequence

import cv2
import numpy as np
import pandas as pd

from tokt.features.common.arrays import F32, F64, U8, Bools
from tokt.features.common.errors import FrameError, ToktError
from tokt.features.frames.mission import LEFT
from tokt.training.rig.calibrate.frame_selection import evenly_spaced
from tokt.training.rig.calibrate.matching import even_contrast_gaussian, gray_view
from tokt.training.rig.calibrate.vertical_error import vertical_error
from tokt_studies.baselines import thesis_stereo
from tokt_studies.thesis.inputs import StudyInputs

from .disparity_figures import matched_points
from .exhibit import Claim, ClaimAgreement, Exhibit, StudyContext, Table

MATCHED_FRAMES, LINED_FRAMES = 8, 24
"""Pairs that points are matched in, and frames that straight edges are looked for in."""
LONG_EDGE, FEW_EDGES = 0.2, 20
"""Of the frame's width: the printed lens bends a shorter edge by less than it can be measured.
From fewer edges nothing is said."""
_REACH_PX, _STEP_PX, _EVEN_PX = 6, 2.0, 9
_FOUND, _ROUGH_PX = 0.8, 0.7
"""An edge is traced at most so far from its chord, at every second pixel of the view, its profiles
smoothed along it. It counts where it is found at that share of places, and is that smooth."""
# As tables 3.3 and 3.4 print them, in Bouguet's order: k1, k2, then the tangential pair.
_PRINTED = (
    np.array([[2222.72426, 0, 681.42537], [0, 2190.48031, -22.08306], [0, 0, 1]]),
    np.array([0.27724, 0.28163, -0.06867, 0.00358, 0]),
)
_WAYS = {"as printed": _PRINTED, "as its program reads it": thesis_stereo.LEFT_CAMERA}


def calibration_figures(context: StudyContext) -> Exhibit:
    """The exhibit of figures 3.1 to 3.7; needs pairs with something in them."""
    if not context.textured_pairs:
        raise ToktError("needs pairs with something in them")
    rows = row_differences(context)
    bends = edge_bends(context, evenly_spaced(context.textured_pairs, LINED_FRAMES))
    caption = (
        "Median row differences in pixels of matched points (SIFT, one geometry a frame). Raw is "
        "before the thesis's step, thesis after it. Ours is rectified with "
        f"{context.calibration_words}, which may have been fitted to these frames."
    )
    return Exhibit(
        words=(
            "Of the printed calibration k4, the rotation and the parts of T enter no step that the "
            "thesis prints. Its step named rectify undistorts each picture by itself.",
        ),
        claims=(bend_claim(bends), row_claim(rows)),
        tables=(Table("rows", caption, rows),),
    )


def row_differences(context: StudyContext) -> pd.DataFrame:
    """Median row differences by frame, in pixels of frames of the thesis's size."""
    calibration, rows = context.needed_calibration(), []
    scale = thesis_stereo.THESIS_FRAME_SIZE[1] / calibration.frame_size[1]
    frames = evenly_spaced(context.textured_pairs, MATCHED_FRAMES)
    for found, left, right in matched_points(context, frames):
        step = thesis_stereo.in_thesis_view(
            left, thesis_stereo.LEFT_CAMERA
        ) - thesis_stereo.in_thesis_view(right, thesis_stereo.RIGHT_CAMERA)
        raw, thesis = (float(np.median(np.abs(one[:, 1]))) for one in (left - right, step))
        ours = scale * vertical_error(calibration, [found]).median_px
        rows.append((found.frame, len(found), raw, thesis, ours))
    return pd.DataFrame(rows, columns=["frame", "matches", "raw", "thesis", "tokt"])


def row_claim(rows: pd.DataFrame) -> Claim:
    """Whether rows agree after the thesis's step."""
    claim = Claim.about(
        "rows of the pair agree after the step named rectify",
        "figures 3.4 to 3.7: the pair, gray, and after it",
    )
    if rows.empty:
        return claim("no point was matched", "rows need points of both pictures")
    raw, thesis, ours = rows[["raw", "thesis", "tokt"]].median()
    return claim(
        f"median row difference: {raw:.1f} px before, {thesis:.1f} px after; tokt's {ours:.1f} px",
        f"to agree: half a block, {thesis_stereo.BLOCK_PX / 2:g} px, or less; in part: halved",
        agreement=ClaimAgreement.of(thesis <= thesis_stereo.BLOCK_PX / 2, thesis <= raw / 2),
    )


def edge_bends(inputs: StudyInputs, frames: Sequence[int]) -> F64:
    """Bends of long edges of left frames: a row an edge, as it is and by each of the ways.

    A bend is the edge's rise over its chord, over the chord's length. (n, 3).
    """
    bends = []
    for number in frames:
        try:
            view = gray_view(inputs.mission, number, LEFT)[0]
        except FrameError:
            continue
        even = cv2.GaussianBlur(even_contrast_gaussian(view), (0, 0), 1.0)
        scale = np.array(thesis_stereo.THESIS_FRAME_SIZE) / view.shape[::-1]
        for edge in _long_edges(np.asarray(even, np.uint8)):
            traced, found = _traced(np.asarray(even, np.float32), edge)
            if found.mean() < _FOUND or _bend(traced[found])[1] > _ROUGH_PX:
                continue
            points = (traced[found] + 0.5) * scale - 0.5
            ways = (
                points,
                *(thesis_stereo.in_thesis_view(points, camera) for camera in _WAYS.values()),
            )
            bends.append([_bend(way)[0] for way in ways])
    return np.array(bends).reshape(-1, 1 + len(_WAYS))


def _long_edges(view: U8) -> F64:
    """Chords of edges (n, 4): x and y of their two ends."""
    found = cv2.createLineSegmentDetector().detect(view)[0]
    edges = np.asarray(np.empty(0) if found is None else found, np.float64).reshape(-1, 4)
    length = np.hypot(edges[:, 2] - edges[:, 0], edges[:, 3] - edges[:, 1])
    # However small the view, there is something to trace.
    return np.asarray(edges[length >= max(LONG_EDGE * view.shape[1], 5 * _REACH_PX)])


def _traced(view: F32, edge: F64) -> tuple[F64, Bools]:
    """Places (n, 2) along an edge, each moved across it to its steepest point, and where one is."""
    start, end = edge[:2], edge[2:]
    length = np.hypot(*(end - start))
    along = (end - start) / length
    across = np.array([-along[1], along[0]])
    places = start + np.arange(_REACH_PX, length - _REACH_PX, _STEP_PX)[:, None] * along
    offsets = np.arange(-_REACH_PX, _REACH_PX + 1)
    at = (places[:, None] + offsets[:, None] * across).astype(np.float32)
    profiles = cv2.remap(view, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    slope = np.gradient(cv2.GaussianBlur(profiles, (1, _EVEN_PX), 0), axis=1)
    slope *= np.sign(np.median(slope[:, _REACH_PX]))
    steepest = slope[:, 1:-1].argmax(axis=1) + 1
    row = np.arange(len(places))
    before, here, after = (slope[row, steepest + step] for step in (-1, 0, 1))
    bow = np.minimum(before - 2 * here + after, -1e-9)
    moved = steepest - _REACH_PX + 0.5 * (before - after) / bow
    found = (here > 0) & (steepest > 1) & (steepest < 2 * _REACH_PX - 1)
    return places + moved[:, None] * across, np.asarray(found)


def _bend(points: F64) -> tuple[float, float]:
    """Rise over the chord of a parabola through points (n, 2), as a part of it; and what is left.

    That is the median distance of the points from it, in their unit.
    """
    middle = points - points.mean(axis=0)
    x, y = (middle @ np.linalg.svd(middle, full_matrices=False)[2].T).T
    parabola = np.polyfit(x, y, 2)
    chord = float(np.ptp(x))
    return abs(parabola[0]) * chord / 4, float(np.median(np.abs(y - np.polyval(parabola, x))))


def bend_claim(bends: F64) -> Claim:
    """Whether the printed calibration straightens edges that are straight."""
    claim = Claim.about(
        "Bouguet's calibration straightens lines",
        "figures 3.1 to 3.3: the board's lines are straight with Bouguet's, not Agisoft's",
    )
    found = f"{len(bends)} straight edges a fifth of the frame long"
    if len(bends) < FEW_EDGES:
        return claim(found, f"no board is in them, and {FEW_EDGES} such edges are needed")
    before, *after = 100 * np.median(bends, axis=0)
    ways = ", ".join(f"{way} {value:.2f} %" for way, value in zip(_WAYS, after, strict=True))
    return claim(
        f"{found}: median bend {before:.2f} % of the chord before; after, {ways}",
        "to agree: a reading of the numbers halves the bend; in part: lessens it",
        agreement=ClaimAgreement.of(min(after) <= before / 2, min(after) < before),
    )
