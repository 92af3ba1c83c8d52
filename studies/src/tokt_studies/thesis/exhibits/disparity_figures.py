"""Figures 3.8 to 3.10: the disparity map, the margin cut off it, and the point cloud.

Beside them stands the control of any stereo: exchange the right frame, or turn it upside down. What
measures distance by two pictures has nothing to say then. What says the same as before has only
looked at one.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy.stats import spearmanr

from tokt.features.common.arrays import F64, I64, U8, Bools
from tokt.features.common.errors import ToktError
from tokt.inference.frame import Frame
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.matching import Matches
from tokt.inference.verdict import CLEAR, STATUS_MEAN_THRESHOLD, STATUS_WORDS
from tokt.training.evaluation.pictures import raise_contrast
from tokt.training.rig.calibrate.frame_selection import evenly_spaced
from tokt.training.rig.calibrate.matching import FrameMatches, match_frame
from tokt.training.rig.depth.cloud import cloud_of
from tokt.training.rig.depth.pair_depths import measure_depths
from tokt.training.rig.depth.picture import DepthPicture
from tokt_studies.baselines import thesis_stereo
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.thesis.inputs import UNKNOWN, StudyInputs
from tokt_studies.thesis.patch_scores import Truth

from .exhibit import Claim, ClaimAgreement, Exhibit, Plot, StudyContext, Table
from .frame_drawing import SHOWN, new_figure, png_of

EXCHANGED_FRAMES, MATCHED_FRAMES = 8, 4
"""Pairs that the control is made on, and that points are matched in."""
COLLAPSED = 0.003
"""Part of the view that may be matched by chance with a wrong right frame. Source: the control of
the mission's own measurements, 23 % to at most 0.3 % at frame 180."""
_SAME = 0.02
_FEW_FOUND, _MAX_FOUND = 0.05, 0.5
_MIN_RANK, _IN_PLACE = -0.5, 0.8
OWN, ANOTHER, TURNED = "its own", "another frame's", "its own, upside down"
KINDS = (OWN, ANOTHER, TURNED)
_VIEW = (680, 512)
_MAX_POINTS = 20_000
"""Of a cloud, drawn: more of them hide each other."""
_MARGIN_COLOR = "#4da3ff"


class _Shown(NamedTuple):
    """The pair that is drawn: the thesis's map (uint8, 1024 x 1360), our matches and our cloud."""

    number: int
    left: U8
    stretched: U8
    matches: Matches
    points_m: F64
    rank_correlation: float


def disparity_figures(context: StudyContext) -> Exhibit:
    """The exhibit of figures 3.8 to 3.10; needs two pairs with something in them."""
    calibration = context.needed_calibration()
    frames = evenly_spaced(context.textured_pairs, EXCHANGED_FRAMES)
    if len(frames) < 2:
        raise ToktError("needs two pairs with something in them")
    rows = exchange(context, frames)
    own = rows[rows.right == OWN].set_index("frame")
    best = int(own.ours_matched.idxmax())
    points = [
        thesis_stereo.searched(left, right)
        for _, left, right in matched_points(context, evenly_spaced(frames, MATCHED_FRAMES))
    ]
    covered = np.concatenate([found for _, found in points]) if points else np.empty(0)
    shown = _shown(context, best)
    nearest, farthest = own.near_m.min(), own.far_m.max()
    nearest = 1.0 if np.isnan(nearest) else nearest
    # Colours of depth: those that are there, and at least a factor of two.
    ends = nearest, max(2 * nearest, np.nan_to_num(farthest))
    picture = DepthPicture(DisparityDetector(calibration, GRID).rectifier, *ends)
    numbers = {
        **_control(rows),
        **_cloud_numbers(shown, context.left_labelled.get(best, UNKNOWN)),
        "matched_points": len(covered),
        "points_searched": float(covered.mean()) if len(covered) else None,
    }
    figures = pd.DataFrame(numbers.items(), columns=["figure", "value"])
    maps = f"Frame {best}. Blue: the margin that the thesis cuts off. {SHOWN}"
    clouds = (
        f"Point clouds of frame {best}, as the thesis's program and as ours make them. Red is "
        "near; of each axis the middle 98 % are shown."
    )
    return Exhibit(
        words=_words(context, frames, best),
        claims=(map_claim(numbers), cloud_claim(numbers)),
        tables=(_table(rows), Table("figures", "What the claims are judged by.", figures)),
        plots=(
            Plot("disparity_and_margin", maps, png_of(_maps(shown, picture, ends))),
            Plot("point_cloud", clouds, png_of(_clouds(shown))),
        ),
    )


def exchange(inputs: StudyInputs, frames: Sequence[int]) -> pd.DataFrame:
    """Judge left frames with their own right frame, another one's, and their own upside down.

    Every kind is a run of its own, with a detector of its own, as if the right camera gave nothing
    else. A row a left frame and kind.
    """
    pairs_of = {number: pair_of(inputs, number) for number in frames}
    lefts = {number: pair[0] for number, pair in pairs_of.items()}
    own = {number: pair[1] for number, pair in pairs_of.items()}
    half = len(frames) // 2
    partners = [*frames[half:], *frames[:half]]  # half the list away
    rights = {
        OWN: own,
        ANOTHER: {n: own[other] for n, other in zip(frames, partners, strict=True)},
        TURNED: {number: np.ascontiguousarray(right[::-1]) for number, right in own.items()},
    }
    rows = []
    white: dict[int, Bools] = {}
    for kind, right in rights.items():
        pairs = (Frame(number, float(number), lefts[number], right[number]) for number in frames)
        for ours in measure_depths(DisparityDetector(inputs.needed_calibration(), GRID), pairs):
            now = thesis_stereo.cropped(thesis_map(lefts[ours.frame], right[ours.frame]))
            with_its_own = white.setdefault(ours.frame, now > 0)
            rows.append(
                {
                    "frame": ours.frame,
                    "right": kind,
                    "ours_matched": ours.valid_fraction or 0.0,  # of the rectified view
                    "status": STATUS_WORDS[ours.status],
                    "near_m": ours.distance_m,  # ends of the depths; nan where there are none
                    "far_m": ours.far_m,
                    "thesis_matched": float((now > 0).mean()),  # of the cropped map
                    "thesis_mean": float(now.mean()),
                    # Pixels, between matched and not, against the frame's own right frame.
                    "thesis_changed": float(((now > 0) != with_its_own).mean()),
                }
            )
    return pd.DataFrame(rows).astype({"near_m": float, "far_m": float})


def pair_of(inputs: StudyInputs, number: int) -> tuple[U8, U8]:
    """Both pictures of a frame. Raises ToktError where the right one cannot be read."""
    right = inputs.right(number)
    if right is None:
        raise ToktError(f"right frame {number} cannot be read")
    return inputs.left(number), right


def thesis_map(left: U8, right: U8) -> U8:
    """The thesis's map of a pair, at the size that its settings in pixels are for."""
    return thesis_stereo.disparity_map(at_thesis_size(left), at_thesis_size(right))


def at_thesis_size(picture: U8) -> U8:
    """A picture at the size that the thesis's settings in pixels are for."""
    return np.asarray(
        cv2.resize(picture, thesis_stereo.THESIS_FRAME_SIZE, interpolation=cv2.INTER_CUBIC),
        np.uint8,
    )


def patches_in_map() -> I64:
    """Which patch of the frame each pixel of the thesis's undistorted map shows; -1 for none."""
    width, height = thesis_stereo.THESIS_FRAME_SIZE
    cells = np.arange(GRID.n_patches, dtype=np.float32).reshape(GRID.rows, GRID.cols)
    patches = cv2.resize(cells, (width, height), interpolation=cv2.INTER_NEAREST)
    matrix, distortion = thesis_stereo.LEFT_CAMERA
    places = cv2.initUndistortRectifyMap(
        matrix, distortion, None, matrix, (width, height), cv2.CV_32FC1
    )
    seen = cv2.remap(patches, *places, cv2.INTER_NEAREST, None, cv2.BORDER_CONSTANT, -1)
    return np.asarray(seen, np.int64)


def in_map(patches: Truth) -> Bools:
    """Where patches (n_patches,) that are 1 lie in the thesis's map."""
    shown = patches_in_map()
    return np.asarray((shown >= 0) & (patches == 1)[shown])


def matched_points(
    context: StudyContext, frames: Sequence[int]
) -> Iterator[tuple[FrameMatches, F64, F64]]:
    """SIFT matches of frames, and where they lie in the left and right picture at thesis size."""
    size = context.needed_calibration().frame_size
    ratio = np.array(thesis_stereo.THESIS_FRAME_SIZE) / np.array(size)
    for number in frames:
        found = match_frame(context.mission, number, size)
        if found is not None:
            left, right = ((one + 0.5) * ratio - 0.5 for one in (found.left, found.right))
            yield found, left, right


def _shown(context: StudyContext, number: int) -> _Shown:
    """One pair matched in every pixel, and its cloud."""
    detector = DisparityDetector(context.needed_calibration(), GRID, step=1)
    left, right = pair_of(context, number)
    stretched, matches = thesis_map(left, right), detector.match(left, right)
    points = cloud_of(detector.rectifier, matches, left).points_m
    return _Shown(number, left, stretched, matches, points, _ranks(detector, stretched, matches))


def _ranks(detector: DisparityDetector, stretched: U8, matches: Matches) -> float:
    """Spearman's rank correlation of the thesis's values and our depths, pixel by pixel.

    -1 would be disparities: the larger, the nearer. 0 where too few pixels have both.
    """
    row, column = np.nonzero(matches.valid)
    size = np.array(detector.calibration.frame_size)
    places = detector.rectifier.to_frame(np.column_stack([column, row]))
    places = (places + 0.5) * np.array(thesis_stereo.THESIS_FRAME_SIZE) / size - 0.5
    seen = np.rint(thesis_stereo.in_thesis_view(places, thesis_stereo.LEFT_CAMERA)).astype(np.int64)
    inside = ((seen >= 0) & (seen < np.array(thesis_stereo.THESIS_FRAME_SIZE))).all(axis=1)
    said = stretched[seen[inside, 1], seen[inside, 0]]
    depth = detector.depth_m(matches)[matches.valid][inside]
    both = said > 0
    if both.sum() < 10 or len(np.unique(said[both])) < 2:
        return 0.0
    found: Any = spearmanr(said[both], depth[both])
    return float(found.statistic)


def _control(rows: pd.DataFrame) -> dict[str, Any]:
    """What exchanging the right frame does to both, over all frames."""
    own, wrong = rows[rows.right == OWN], rows[rows.right != OWN]
    before = own.set_index("frame").thesis_mean.loc[wrong.frame].to_numpy()
    kept = (wrong.thesis_mean > STATUS_MEAN_THRESHOLD) == (before > STATUS_MEAN_THRESHOLD)
    return {
        "ours_matched_own_median": own.ours_matched.median(),
        "ours_matched_wrong_most": wrong.ours_matched.max(),
        "ours_clear_wrong": int((wrong.status == STATUS_WORDS[CLEAR]).sum()),
        "wrong_pairs": len(wrong),
        "thesis_pixels_changed_most": wrong.thesis_changed.max(),
        "thesis_status_kept": int(kept.sum()),
    }


def _cloud_numbers(shown: _Shown, truth: Truth) -> dict[str, Any]:
    inside = np.s_[:, thesis_stereo.CROP_PX : -thesis_stereo.CROP_PX]
    white, there = shown.stretched[inside] > 0, in_map(truth)[inside]
    labelled = there.any() and white.any()
    return {
        "shown_frame": shown.number,
        "rank_correlation": shown.rank_correlation,
        "thesis_cloud_spread": _spread(
            -thesis_stereo.thesis_cloud(thesis_stereo.cropped(shown.stretched))[0][:, 2]
        ),
        "cloud_spread": _spread(shown.points_m[:, 2]),
        "in_place": float(there[white].mean()) if labelled else None,
    }


def _spread(depth: F64) -> float:
    """From the 5th to the 95th percentile, over the median; 0 of nothing."""
    if not len(depth):
        return 0.0
    low, middle, high = np.percentile(depth, [5, 50, 95])
    return float((high - low) / middle)


def map_claim(numbers: dict[str, Any]) -> Claim:
    """Whether the map's values are disparities of the pair."""
    last = thesis_stereo.MIN_DISPARITY_PX + thesis_stereo.N_DISPARITIES_PX - 1
    claim = Claim.about(
        "the map shows disparities of the two pictures",
        f"table 3.5 searches {thesis_stereo.MIN_DISPARITY_PX} to {last} px; figure 3.8",
    )
    share, changed = numbers["points_searched"], numbers["thesis_pixels_changed_most"]
    if share is None:
        return claim("no matched points", "true disparities are not known without")
    return claim(
        f"{share:.0%} of {numbers['matched_points']} matched points are in its search. "
        f"{numbers['thesis_status_kept']} of {numbers['wrong_pairs']} wrong right frames keep its "
        f"status; {changed:.2%} of its pixels change at most",
        "to agree: half of the points, and a map that changes with the right frame; in part: a "
        "twentieth of the points",
        agreement=ClaimAgreement.of(share > _MAX_FOUND and changed > _SAME, share > _FEW_FOUND),
    )


def cloud_claim(numbers: dict[str, Any]) -> Claim:
    """Whether the cloud's places are usable, and its distances not."""
    claim = Claim.about(
        "the point cloud's places are usable, its distances are not",
        "figure 3.10: fits from the front, is drawn out in depth",
    )
    rank, spread = numbers["rank_correlation"], numbers["thesis_cloud_spread"]
    found = (
        f"rank correlation with depth {rank:.2f}; depths spread over {spread:.1f} of "
        f"their median, ours over {numbers['cloud_spread']:.1f}"
    )
    no_distance = rank > _MIN_RANK and spread > numbers["cloud_spread"]
    if numbers["in_place"] is None:
        return claim(found, "the frame has no labels, so that places cannot be judged")
    in_place = numbers["in_place"] >= _IN_PLACE
    return claim(
        f"{numbers['in_place']:.0%} of the map's white lies on labelled patches; {found}",
        f"to agree: {_IN_PLACE:.0%} there, the correlation above {_MIN_RANK} (-1: disparities), "
        "the depths spread wider than ours; in part: one of both",
        agreement=ClaimAgreement.of(in_place and no_distance, in_place or no_distance),
    )


def _words(context: StudyContext, frames: Sequence[int], best: int) -> tuple[str, ...]:
    width, height = thesis_stereo.THESIS_FRAME_SIZE
    return (
        f"The thesis's settings are for frames of {width}x{height}; others are enlarged. Ours is "
        f"rectified with {context.calibration_words}, which may have been fitted to these frames.",
        f"The control: {len(frames)} frames with something in them, {min(frames)} to "
        f"{max(frames)}. Each is judged with its own right frame, with that of the frame half this "
        "list away, and with its own upside down. With a wrong one a stereo method must find next "
        f"to nothing (at most {100 * COLLAPSED:.1f} % of the view). Pictures are of frame {best}, "
        "where ours matches most.",
    )


def _table(rows: pd.DataFrame) -> Table:
    caption = (
        "The same left frames with three right frames. Matched: part of the rectified view (ours), "
        "of the map without its margin (thesis). Near and far: 20th and 95th percentile of the "
        "matched depths in metres. Changed: part of the thesis's pixels, between matched and not, "
        "against the frame's own right frame."
    )
    shown = rows.sort_values("frame", kind="stable").rename(columns=lambda n: n.replace("_", " "))
    return Table("exchanged_right_frame", caption, shown)


def _maps(shown: _Shown, picture: DepthPicture, ends_m: tuple[float, float]) -> Figure:
    """The frame, the thesis's map with its margin, the map it judges, and our depth."""
    figure, axes = new_figure(11, 8.6, 2, 2)
    own = shown.matches
    views = (
        (raise_contrast(shown.left, *_VIEW), "left frame, contrast raised"),
        (shown.stretched, "thesis: stretched disparities, and the margin"),
        (thesis_stereo.cropped(shown.stretched), "thesis: without the margin, as it is judged"),
        (
            picture.depth_rgb(own),
            f"ours: {own.valid.mean():.1%} matched; red {ends_m[0]:.1f} m to blue "
            f"{ends_m[1]:.1f} m, logarithmic",
        ),
    )
    for one, (view, title) in zip(axes.flat, views, strict=True):
        one.imshow(view, cmap="magma", vmin=0, vmax=255, interpolation="nearest")
        one.set_title(title, fontsize=10)
        one.set(xticks=[], yticks=[])
    width = shown.stretched.shape[1]
    for at in (0, width - thesis_stereo.CROP_PX):
        axes[0, 1].axvspan(
            at - 0.5, at + thesis_stereo.CROP_PX - 0.5, color=_MARGIN_COLOR, alpha=0.25, lw=0
        )
    words = "not matched; striped: not in the view of both cameras"
    axes[1, 1].legend(
        handles=[Patch(facecolor="#1a1c20", edgecolor="0.5", label=words)],
        loc="upper center", bbox_to_anchor=(0.5, 0.0), fontsize=9, frameon=False,
    )  # fmt: skip
    return figure


def _clouds(shown: _Shown) -> Figure:
    """Both point clouds from the front and from above, coloured by their own depth."""
    figure, axes = new_figure(11, 8.4, 2, 2)
    clouds = {
        # x right, y up, z backwards; then x right, y down, z ahead.
        ("thesis", "no unit"): thesis_stereo.thesis_cloud(shown.stretched)[0] * [1, 1, -1],
        ("ours", "m"): shown.points_m * [1, -1, 1],
    }
    for row, ((whose, unit), points) in zip(axes, clouds.items(), strict=True):
        # In a random order that is always the same.
        drawn = np.random.default_rng(0).permutation(points)[:_MAX_POINTS]
        ends = np.percentile(drawn, [1, 99], axis=0) if len(drawn) else np.zeros((2, 3))
        x, up, ahead = drawn[((drawn >= ends[0]) & (drawn <= ends[1])).all(axis=1)].T
        for one, across, what in ((row[0], up, "front"), (row[1], ahead, "above")):
            one.scatter(x, across, s=1.5, c=-ahead, cmap="turbo", linewidths=0)
            one.set_title(f"{whose}, from {'the ' * (what == 'front')}{what}", fontsize=10)
            name = "height" if what == "front" else "depth"
            one.set(xlabel=f"x, {unit}", ylabel=f"{name}, {unit}")
            one.grid(alpha=0.25)
    return figure
