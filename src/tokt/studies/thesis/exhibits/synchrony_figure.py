"""Figure 6.1: whether the two cameras see at the same moment."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import LEFT, RIGHT
from tokt.studies.thesis.methods.synchrony import (
    FARTHEST_FRAMES,
    LateRight,
    Offset,
    offset_of,
    rows_of,
)
from tokt.training.rig.calibrate.frame_selection import evenly_spaced

from .exhibit import NOT_KNOWN, Claim, ClaimAgreement, Exhibit, Plot, StudyContext, Table
from .frame_drawing import new_figure, png_of

FRAMES = 14
"""Pairs whose points are followed, spread over those with something in them."""
SHIFTED = 1
"""Frames by which the right camera is made late on purpose."""
SYNCHRONOUS_FRAMES = 0.1
"""Offsets below move a point by less than a block of the matching at the mission's motion: the
largest row motion there, 70 px a frame, comes to 7 px."""
AS_IT_IS, ON_PURPOSE = "as it is", f"right camera {SHIFTED} frame later, on purpose"
_COLORS = {AS_IT_IS: "#1f4e79", ON_PURPOSE: "#d1603d"}


def synchrony_figure(context: StudyContext) -> Exhibit:
    """The exhibit of figure 6.1; needs pairs of something that moves in the picture."""
    calibration = context.calibration
    if calibration is None:
        raise ToktError(f"needs a calibration of the two cameras: {context.calibration_words}")
    frames = evenly_spaced(_with_neighbours(context), FRAMES)
    missions = {AS_IT_IS: context.mission, ON_PURPOSE: LateRight(context.mission, SHIFTED)}
    try:
        found = {
            words: offset_of(rows_of(mission, calibration, frames))
            for words, mission in missions.items()
        }
    except ToktError as error:
        raise ToktError(
            f"needs points that both cameras see in successive frames: {error}"
        ) from error
    numbers: dict[str, Any] = {}
    for name, one in zip(("own", "shifted"), found.values(), strict=True):
        numbers |= {
            f"{name}_offset_frames": one.frames,
            f"{name}_half_width_frames": one.half_width,
            f"{name}_frames": one.n_frames,
            f"{name}_points": one.n_points,
        }
    return Exhibit(
        words=_words(context),
        claims=(claim_of(found),),
        tables=(_table(found),),
        plots=(_plot(found),),
        numbers=numbers,
    )


def _with_neighbours(context: StudyContext) -> list[int]:
    """Pairs with something in them whose left frames before and after are there, and whose right
    frame after is.
    """
    left, right = (set(context.mission.frames(camera)) for camera in (LEFT, RIGHT))
    return [
        number
        for number in context.textured_pairs
        if {number - 1, number + 1} <= left and number + SHIFTED in right
    ]


def _said(offset: Offset) -> str:
    """An offset with its 95 % interval, and more than it says where it is at the end."""
    words = f"{offset.frames:+.4f} +- {offset.half_width:.4f} frames"
    return f"{words} (or more: the end of what is looked for)" if offset.at_the_end else words


def claim_of(found: dict[str, Offset]) -> Claim:
    """What the offsets `AS_IT_IS` and `ON_PURPOSE` come to."""
    own, shifted = found[AS_IT_IS], found[ON_PURPOSE]
    largest = abs(own.frames) + own.half_width
    control = abs(shifted.frames - SHIFTED - own.frames) <= SYNCHRONOUS_FRAMES
    if not control or own.half_width > SYNCHRONOUS_FRAMES:
        agreement = ClaimAgreement.UNCOMPARABLE
        why = "these frames do not tell: the control on purpose is not measured as what it is"
        if control:
            why = (
                "these frames do not tell: the vehicle hardly moves, or few points can be followed"
            )
    elif largest <= SYNCHRONOUS_FRAMES:
        agreement = ClaimAgreement.YES
        why = (
            f"the offset is below {SYNCHRONOUS_FRAMES} frames with its interval, and a right "
            "camera that is late on purpose is measured as late"
        )
    else:
        agreement = ClaimAgreement.NO
        why = f"the offset, with its interval, goes beyond {SYNCHRONOUS_FRAMES} frames"
    return Claim(
        "left and right frames of one number are of one moment",
        f"the pairs are used as synchronous; the figure and its numbers are {NOT_KNOWN}",
        f"right camera later by {_said(own)}; made late by {SHIFTED} on purpose: {_said(shifted)}",
        agreement,
        why,
    )


def _words(context: StudyContext) -> tuple[str, ...]:
    return (
        "Measured from the frames, without any clock: a point stands in one row of both rectified "
        "views unless the right camera saw it at another moment and the vehicle moved up, down or "
        "turned in between. The row in the right view is compared with the rows in the left view "
        "of the frame before, of the frame and of the one after. Points: SIFT between the cameras, "
        f"Lucas and Kanade's method from frame to frame. Rectified with "
        f"{context.calibration_words}.",
        f"The interval is of 95 %, by the jackknife over at most {FRAMES} frames spread over the "
        "mission's stretch with something in it; the frames' own order is not otherwise split, "
        "since nothing is learnt. Fitted with the offset: what the calibration leaves (a constant, "
        "and a share of column and row); a calibration fitted to the same frames cannot hide an "
        f"offset, as the motion changes from frame to frame. Looked for up to {FARTHEST_FRAMES} "
        "frames either way. In seconds it is not said: the frames carry no times.",
    )


def _table(found: dict[str, Offset]) -> Table:
    rows = [
        {
            "frames": words,
            "offset of the right camera, frames": round(one.frames, 5),
            "95 % interval, +-": round(one.half_width, 5),
            "frames used": one.n_frames,
            "points": one.n_points,
            "largest row motion, px a frame": round(float(np.abs(one.by_frame[:, 1]).max()), 2),
        }
        for words, one in found.items()
    ]
    caption = "Offset between the cameras, in frames; positive: the right one is later."
    return Table("offset", caption, pd.DataFrame(rows), "Offset between the cameras")


def _plot(found: dict[str, Offset]) -> Plot:
    figure, axes = new_figure(8.4, 4.8)
    for words, one in found.items():
        moved, difference = one.by_frame[:, 1], one.by_frame[:, 2]
        axes.plot(moved, difference, "o", color=_COLORS[words], label=f"{words}: {_said(one)}")
        ends = np.array([min(moved.min(), 0.0), max(moved.max(), 0.0)])
        axes.plot(ends, one.frames * ends, color=_COLORS[words], lw=1)
    axes.axhline(0, color="0.6", lw=0.8)
    axes.set(
        xlabel="rows a frame by which the points move in the left view over the offset, px",
        ylabel="right row less left row, px",
    )
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8)
    return Plot(
        "synchrony",
        "A dot a frame, the median of its points; a line's slope is the offset in frames. "
        "Synchronous cameras lie on the horizontal line, however fast the picture moves.",
        png_of(figure),
    )
