"""Figures 3.8 to 3.10: the disparity map, the margin cut off it, and the point cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import spearmanr

from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.verdict import STATUS_MEAN_THRESHOLD
from tokt.studies.baselines.thesis_disparity import (
    Margin,
    in_thesis_view,
    margin_of,
    searched,
    thesis_cloud,
)
from tokt.studies.baselines.thesis_stereo import (
    CROP_PX,
    LEFT_CAMERA,
    MIN_DISPARITY_PX,
    N_DISPARITIES_PX,
    THESIS_FRAME_SIZE,
    disparity_map,
)
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.context import StudyContext
from tokt.studies.thesis.exhibit import NOT_KNOWN, Claim, ClaimAgreement, Exhibit, Plot, Table
from tokt.studies.thesis.frame_drawing import SHOWN
from tokt.studies.thesis.methods.exchanged_right import (
    ANOTHER,
    KINDS,
    OWN,
    TURNED,
    Exchanged,
    at_thesis_size,
    exchange,
    right_of,
)
from tokt.studies.thesis.methods.textured_pairs import survey
from tokt.training.rig.calibrate.frame_selection import evenly_spaced
from tokt.training.rig.calibrate.matching import match_frame
from tokt.training.rig.depth.cloud import PointCloud, cloud_of
from tokt.training.rig.depth.picture import DepthPicture

from .disparity_plots import Panel, clouds_png, exchanged_png, maps_png

KEY = "figure-3.8-to-3.10"
TITLE = "Disparity map, margin and point cloud"
SECTION = "figures 3.8 to 3.10"
EXCHANGED_FRAMES, MATCHED_FRAMES, OPEN_FRAMES = 8, 4, 3
"""Pairs that the control is made on, that points are matched in, and that the margin is looked at
in open water."""
COLLAPSED = 0.003
"""Part of the view that may be matched by chance with a wrong right frame. Source: the control of
the mission's own measurements, 23 % to at most 0.3 % at frame 180."""
_SAME = 0.02
_FEW_FOUND, _MAX_FOUND = 0.05, 0.5


@dataclass(frozen=True)
class _Shown:
    """The pair that is drawn."""

    number: int
    left: NDArray[np.uint8]
    panels: list[Panel]
    cloud: PointCloud
    rank_correlation: float


def disparity_figures(context: StudyContext) -> Exhibit:
    """The exhibit of figures 3.8 to 3.10; needs two pairs with something in them."""
    calibration = context.calibration
    if calibration is None:
        return _missing(f"a calibration of the two cameras: {context.calibration_words}")
    known = survey(context)
    frames = evenly_spaced(known.textured, EXCHANGED_FRAMES)
    if len(frames) < 2:
        return _missing("two pairs with something in them")
    rows = exchange(context, calibration, frames)
    own = [row for row in rows if row.right == OWN]
    best = max(own, key=lambda row: row.ours_matched)
    margins = [_margin(context, n) for n in evenly_spaced(known.open_water, OPEN_FRAMES)]
    disparity, covered = _searched(context, calibration, evenly_spaced(frames, MATCHED_FRAMES))
    shown = _shown(context, calibration, best.frame, _partner(frames, best.frame))
    ends = _ends(own)
    picture = DepthPicture(DisparityDetector(calibration, GRID).rectifier, *ends)
    numbers = {**_control(rows), **_margins(margins), **_cloud_numbers(shown)}
    numbers |= {"matched_points": len(disparity), "points_searched": _mean(covered)}
    return Exhibit(
        KEY,
        TITLE,
        SECTION,
        words=_words(context, frames, best.frame),
        claims=(
            _search_claim(disparity, covered),
            _exchange_claim(numbers),
            _margin_claim(numbers, len(margins)),
            _cloud_claim(numbers),
        ),
        tables=(_table(rows), _cloud_table(shown)),
        plots=_plots(shown, picture, ends),
        numbers=numbers,
    )


def _missing(what: str) -> Exhibit:
    return Exhibit(KEY, TITLE, SECTION, missing=f"needs {what}")


def _mean(values: NDArray[np.bool_]) -> float:
    return float(values.mean()) if len(values) else 0.0


def _partner(frames: Sequence[int], number: int) -> int:
    """The frame whose right frame stands in for a frame's own: as `exchange` has it."""
    half = len(frames) // 2
    return [*frames[half:], *frames[:half]][list(frames).index(number)]


def _ends(own: Sequence[Exchanged]) -> tuple[float, float]:
    """Colours of depth: those that are there, and at least a factor of two."""
    near = [row.ours.distance_m for row in own if row.ours.distance_m]
    far = [row.ours.far_m for row in own if row.ours.far_m]
    nearest = min(near, default=1.0)
    return nearest, max([*far, 2 * nearest])


def _margin(context: StudyContext, number: int) -> Margin:
    left, right = context.left(number), right_of(context, number)
    return margin_of(disparity_map(at_thesis_size(left), at_thesis_size(right)))


def _searched(
    context: StudyContext, calibration: StereoCalibration, frames: Sequence[int]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Disparities of SIFT matches in the thesis's pictures, and which its search can find."""
    found = [match_frame(context.mission, n, calibration.frame_size) for n in frames]
    matched = [one for one in found if one is not None]
    if not matched:
        return np.empty(0), np.empty(0, bool)
    ratio = np.array(THESIS_FRAME_SIZE) / np.array(calibration.frame_size)
    left, right = (
        (np.concatenate([getattr(one, side) for one in matched]) + 0.5) * ratio - 0.5
        for side in ("left", "right")
    )
    return searched(left, right)


def _shown(
    context: StudyContext, calibration: StereoCalibration, number: int, other: int
) -> _Shown:
    """One pair matched in every pixel, with the three right frames, and its cloud."""
    detector = DisparityDetector(calibration, GRID, step=1)
    left, right = context.left(number), right_of(context, number)
    rights = (right, right_of(context, other), np.ascontiguousarray(right[::-1]))
    words = (OWN, f"that of frame {other}", TURNED)
    small = at_thesis_size(left)
    panels = [
        Panel(f"right frame: {what}", disparity_map(small, at_thesis_size(one)),
              detector.match(left, one))
        for what, one in zip(words, rights, strict=True)
    ]  # fmt: skip
    cloud = cloud_of(detector.rectifier, panels[0].matches, left)
    return _Shown(number, left, panels, cloud, _ranks(detector, panels[0]))


def _ranks(detector: DisparityDetector, panel: Panel) -> float:
    """Spearman's rank correlation of the thesis's values and our depths, pixel by pixel.

    -1 would be disparities: the larger, the nearer. 0 where too few pixels have both.
    """
    matches = panel.matches
    row, column = np.nonzero(matches.valid)
    size = np.array(detector.calibration.frame_size)
    places = detector.rectifier.to_frame(np.column_stack([column, row]))
    places = (places + 0.5) * np.array(THESIS_FRAME_SIZE) / size - 0.5
    seen = np.rint(in_thesis_view(places, LEFT_CAMERA)).astype(np.int64)
    inside = ((seen >= 0) & (seen < np.array(THESIS_FRAME_SIZE))).all(axis=1)
    said = panel.stretched[seen[inside, 1], seen[inside, 0]]
    depth = detector.depth_m(matches)[matches.valid][inside]
    both = said > 0
    if both.sum() < 10 or len(np.unique(said[both])) < 2:
        return 0.0
    found: Any = spearmanr(said[both], depth[both])
    return float(found.statistic)


def _control(rows: Sequence[Exchanged]) -> dict[str, Any]:
    """What exchanging the right frame does to both, over all frames."""
    by_kind = {kind: [row for row in rows if row.right == kind] for kind in KINDS}
    wrong = [row for kind in (ANOTHER, TURNED) for row in by_kind[kind]]
    own = {row.frame: row for row in by_kind[OWN]}
    mean_change = [
        abs(row.thesis_mean / own[row.frame].thesis_mean - 1)
        for row in wrong
        if own[row.frame].thesis_mean > 0
    ]
    kept = [
        (row.thesis_mean > STATUS_MEAN_THRESHOLD)
        == (own[row.frame].thesis_mean > STATUS_MEAN_THRESHOLD)
        for row in wrong
    ]
    return {
        "frames": len(own),
        "ours_matched_own_median": float(np.median([row.ours_matched for row in own.values()])),
        "ours_matched_own_least": min(row.ours_matched for row in own.values()),
        "ours_matched_wrong_median": float(np.median([row.ours_matched for row in wrong])),
        "ours_matched_wrong_most": max(row.ours_matched for row in wrong),
        "ours_obstacle_own": sum(row.ours.status == 1 for row in own.values()),
        "ours_obstacle_wrong": sum(row.ours.status == 1 for row in wrong),
        "ours_clear_wrong": sum(row.ours.status == 0 for row in wrong),
        "wrong_pairs": len(wrong),
        "thesis_pixels_changed_most": max(row.thesis_changed for row in wrong),
        "thesis_mean_change_median": float(np.median(mean_change)) if mean_change else 0.0,
        "thesis_status_kept": sum(kept),
    }


def _margins(margins: Sequence[Margin]) -> dict[str, Any]:
    if not margins:
        return {}
    return {
        "open_water_matched_margin": float(np.mean([one.matched_margin for one in margins])),
        "open_water_matched_inside": float(np.mean([one.matched_inside for one in margins])),
        "open_water_mean_whole": float(np.mean([one.mean_whole for one in margins])),
        "open_water_mean_inside": float(np.mean([one.mean_inside for one in margins])),
    }


def _cloud_numbers(shown: _Shown) -> dict[str, Any]:
    depth = shown.cloud.points_m[:, 2]
    said = shown.panels[0].stretched
    found = {
        "shown_frame": shown.number,
        "cloud_points": len(depth),
        "thesis_cloud_points": int((said > 0).sum()),
        "thesis_cloud_depths": len(np.unique(said[said > 0])),
        "rank_correlation": shown.rank_correlation,
    }
    if len(depth):
        found["cloud_median_m"] = float(np.median(depth))
    return found


def _search_claim(disparity: NDArray[np.float64], covered: NDArray[np.bool_]) -> Claim:
    last = MIN_DISPARITY_PX + N_DISPARITIES_PX - 1
    what = "the values of the map are disparities"
    printed = (
        f"block matching searches disparities {MIN_DISPARITY_PX} to {last} px along rows (its "
        f"program's settings; the figure's text is {NOT_KNOWN})"
    )
    if not len(disparity):
        why = "no points of the frames were matched, so that the true disparities are not known"
        return Claim(what, printed, "no matched points", ClaimAgreement.UNCOMPARABLE, why)
    share = _mean(covered)
    if share > _MAX_FOUND:
        agreement = ClaimAgreement.YES
    else:
        agreement = ClaimAgreement.PARTLY if share > _FEW_FOUND else ClaimAgreement.NO
    found = (
        f"{100 * share:.0f} % of {len(disparity)} points matched in both pictures have a "
        f"disparity and a row that it can find; they are at {np.min(disparity):.0f} to "
        f"{np.max(disparity):.0f} px"
    )
    why = (
        "judged by points matched without any calibration (SIFT, one geometry a frame) and moved "
        "to where the thesis's own undistortion puts them; the pair is not rectified"
    )
    return Claim(what, printed, found, agreement, why)


def _exchange_claim(numbers: dict[str, Any]) -> Claim:
    same = numbers["thesis_pixels_changed_most"] <= _SAME
    found = (
        f"with a wrong right frame at most {100 * numbers['thesis_pixels_changed_most']:.2f} % of "
        f"the thesis's pixels change between matched and not, its mean value changes by "
        f"{100 * numbers['thesis_mean_change_median']:.0f} % (median), and its status is the same "
        f"in {numbers['thesis_status_kept']} of {numbers['wrong_pairs']}; ours matches "
        f"{100 * numbers['ours_matched_own_median']:.1f} % of the view with the right frame "
        f"(median), at most {100 * numbers['ours_matched_wrong_most']:.2f} % with a wrong one, and "
        f"then says obstacle in {numbers['ours_obstacle_wrong']} and clear in "
        f"{numbers['ours_clear_wrong']} pairs, unknown in the others"
    )
    why = (
        "where the map is white is decided by the left picture's texture alone: as an obstacle "
        "detector it works, as stereo it does not"
        if same
        else "where the map is white changes with the right frame on these frames"
    )
    return Claim(
        "the map needs both pictures",
        f"a disparity map of a stereo pair; a control is {NOT_KNOWN}",
        found,
        ClaimAgreement.NO if same else ClaimAgreement.PARTLY,
        why,
    )


def _margin_claim(numbers: dict[str, Any], frames: int) -> Claim:
    what = "the margin that is cut off holds errors"
    printed = (
        f"{CROP_PX} px are cut off at the left and at the right, against errors that its "
        "documentation puts down to the calibration"
    )
    if not frames:
        why = "the mission has no pair of open water to look at"
        return Claim(what, printed, "not measured", ClaimAgreement.UNCOMPARABLE, why)
    margin, inside = numbers["open_water_matched_margin"], numbers["open_water_matched_inside"]
    found = (
        f"in open water ({frames} pairs) {100 * margin:.2f} % of the margin and "
        f"{100 * inside:.2f} % of the rest are white; mean value "
        f"{numbers['open_water_mean_whole']:.2f} with the margin, "
        f"{numbers['open_water_mean_inside']:.2f} without (threshold {STATUS_MEAN_THRESHOLD})"
    )
    if margin > inside:
        why = (
            "what is white there is the picture's edge, bent inwards by an undistortion about a "
            "corner instead of the middle; cutting it off is right, and hides the cause"
        )
        return Claim(what, printed, found, ClaimAgreement.YES, why)
    why = "on these frames the margin is no whiter than the rest"
    return Claim(what, printed, found, ClaimAgreement.NO, why)


def _cloud_claim(numbers: dict[str, Any]) -> Claim:
    found = (
        f"frame {numbers['shown_frame']}: the thesis's cloud has no unit and "
        f"{numbers['thesis_cloud_depths']} depths; the rank correlation of its values with our "
        f"depths is {numbers['rank_correlation']:.2f} (-1: disparities, 0: nothing to do with it). "
        f"Ours: {numbers['cloud_points']} points"
    )
    if "cloud_median_m" in numbers:
        found += f", median {numbers['cloud_median_m']:.2f} m away"
    why = (
        "the figure is not at hand; our depths are of a rectified pair, and are checked against "
        "true ones on rendered missions"
    )
    printed = f"figure 3.10, a point cloud from the disparity; its numbers are {NOT_KNOWN}"
    return Claim("point cloud", printed, found, ClaimAgreement.UNCOMPARABLE, why)


def _words(context: StudyContext, frames: Sequence[int], best: int) -> tuple[str, ...]:
    width, height = THESIS_FRAME_SIZE
    first = (
        "The thesis's map: both pictures gray, undistorted one by one, block matching, disparities "
        "stretched to 0..255. Ours: rectified with "
        f"{context.calibration_words}, matched at half resolution, checked from right to left. "
        "The frames' calibration may have been fitted to frames of this mission."
    )
    second = (
        f"The control: {len(frames)} frames with something in them ({min(frames)} to "
        f"{max(frames)}, spread over the mission) are judged with their own right frame, with that "
        "of the frame half this list away, and with their own upside down (rows reversed). A "
        f"stereo method must then find next to nothing (at most {100 * COLLAPSED:.1f} % of the "
        f"view). Pictures are of frame {best}, where ours matches most."
    )
    size = context.left(best).shape[1::-1]
    if size == THESIS_FRAME_SIZE:
        return first, second
    return first, second, (
        f"The thesis's settings in pixels are for frames of {width}x{height}: those of this "
        f"mission, {size[0]}x{size[1]}, are enlarged for it."
    )  # fmt: skip


def _table(rows: Sequence[Exchanged]) -> Table:
    caption = (
        "The same left frames with three right frames. Matched: of the rectified view (ours), of "
        "the map without its margin (thesis). Near end: 20th percentile of the matched depths. "
        "Pixels changed: of the thesis's map, between matched and not, against the frame's own "
        "right frame."
    )
    ordered = sorted(rows, key=lambda row: (row.frame, KINDS.index(row.right)))
    table = pd.DataFrame([row.to_row() for row in ordered])
    return Table("exchanged_right_frame", caption, table, "Three right frames for each left one")


def _cloud_table(shown: _Shown) -> Table:
    points = shown.cloud.points_m
    rows = []
    for axis, name in enumerate(("x right", "y down", "z ahead")):
        values = points[:, axis] if len(points) else np.array([np.nan])
        low, middle, high = np.percentile(values, [5, 50, 95])
        rows.append({"axis": name, "5 % m": low, "median m": middle, "95 % m": high})
    caption = (
        f"Our point cloud of frame {shown.number}: {len(points)} points of "
        f"{shown.cloud.matched} matched ({shown.cloud.out_of_range} out of range, "
        f"{shown.cloud.outliers} standing alone), in metres from the left camera."
    )
    return Table("point_cloud", caption, pd.DataFrame(rows).round(3))


def _plots(shown: _Shown, picture: DepthPicture, ends: tuple[float, float]) -> tuple[Plot, ...]:
    own = shown.panels[0]
    cloud, matched = thesis_cloud(own.stretched)
    said = own.stretched[matched].astype(np.float64)
    return (
        Plot(
            "disparity_and_margin",
            f"Frame {shown.number}. Blue: the margin that the thesis cuts off. {SHOWN}",
            maps_png(shown.left, own, picture, ends),
        ),
        Plot(
            "exchanged_right_frame",
            f"Left frame {shown.number} with three right frames: the thesis's map keeps its "
            "white pixels, ours loses its matches. Colours as above.",
            exchanged_png(shown.panels, picture),
        ),
        Plot(
            "point_cloud",
            f"Point clouds of frame {shown.number}, as the thesis's program and as ours make "
            "them. Red is near in each; the thesis's axes show the middle 98 % of its points.",
            clouds_png(cloud, said, shown.cloud.points_m),
        ),
    )
