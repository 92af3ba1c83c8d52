"""Sight: of each patch of a frame, whether an obstacle in it would have been seen, or why not.

Nothing is called clear that cannot be seen. The texture detector, disparity and pushbroom read the
same map, before any of them says clear; an obstacle that was found stays one.

::

    . . . . . . . . . .      .  seen
    . . . . . . . b b .      b  blurred: grease on the port
    . . . . . . b b b b
    . . . . . . b b b b      14 of 100 patches, all of them together, at the right:
    . . . . . . . b b b      the frame is not clear
    . . . . . . . . . .

What a patch shows is compared with what the emptiest water of the training frames did
(`tokt.models.sight`): a patch of water has the noise of its camera, and specks and gradients that
make it differ more from pixel to pixel the farther off these are. What cannot be told by one frame:
water too turbid to see through whose noise and light are as before, and a veil over a part of the
view that has all of the camera's noise in front of it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import U8, Bools, median
from tokt.features.extractors.frame_pictures import FramePictures, SharedPictures
from tokt.features.extractors.patch_detail import (
    MEASURES,
    PatchDetail,
    detail_grid,
    masked_patches,
    patch_detail,
)
from tokt.features.frames.grid import Grid
from tokt.features.frames.view_mask import ViewMask
from tokt.models.sight import (
    ANY_CAMERA,
    BRIGHT_PART,
    NOTHING_SEEN,
    UNMEASURED,
    SightLimits,
    hides_too_much,
    largest_group,
    limits_for,
)

from .frame import Frame
from .reason import NO_FAULT, Fault, Reason

DARK, SATURATED, FLAT = "dark", "saturated", "flat"
SMEARED, BLURRED, DAMAGED = "smeared", "blurred", "damaged"
MASKED = "masked"
CAUSES = ("", DARK, SATURATED, FLAT, SMEARED, BLURRED, DAMAGED, MASKED)
"""The causes for which a patch is not seen; a map has their places here, 0 where it is seen."""
_REASONS = {
    DARK: Reason.DARK,
    SATURATED: Reason.SATURATED,
    FLAT: Reason.BLANK,
    SMEARED: Reason.DAMAGED,
    BLURRED: Reason.BLURRED,
    DAMAGED: Reason.DAMAGED,
}

CONTRAST_FRAMES = 15
"""Frames whose contrast says how far one sees: in the sea trial that of one frame is 0.67 of the
usual one and more, the median of 15 of them 0.73 and more."""
FLAT_GREY = 0.02
"""Grey levels: a patch whose pixels differ by less from all those around is of one level. Measured:
0.24 and more on the sea trial, with its noise of less than one level."""

_MASKED = CAUSES.index(MASKED)
# For each place in `CAUSES`: whether such a patch has no picture at all, or has no light.
_NO_PICTURE = np.array([cause in (DARK, SATURATED, FLAT) for cause in CAUSES])
_UNLIT = np.array([cause in (DARK, SATURATED) for cause in CAUSES])
_BY_LIMITS = SMEARED, BLURRED, DAMAGED
_NOISE = [MEASURES.index(name) for name in ("noise_across", "noise_down")]
_COARSE = MEASURES.index("coarse")


class BlindGroup(NamedTuple):
    """The largest connected group of patches that are not seen."""

    patches: int
    cause: str
    box: tuple[int, int, int, int]  # first column, first row, columns, rows


@dataclass(frozen=True)
class SightMap:
    """A map of the patches of one picture, and why each is seen or not."""

    causes: NDArray[np.uint8]  # (rows, cols): 0 where a patch is seen, or a place in `CAUSES`
    # Contrast of the last frames over the training frames'; None where that is not known.
    visibility: float | None = None
    least_visibility: float = 0.0
    reach_m: float | None = None  # as far as stereo has matched anything in the last pairs
    unlearnt: str = ""  # words where the limits are those of frames of another size

    @property
    def seen(self) -> Bools:
        """The patches that are seen, (rows, cols)."""
        return np.asarray(self.causes == 0)

    @property
    def share(self) -> float:
        """Part of all patches that are seen, 0 to 1."""
        return float(self.seen.mean())

    @property
    def masked(self) -> Bools:
        """The patches that are no view, (rows, cols)."""
        return np.asarray(self.causes == _MASKED)

    @cached_property
    def _unseen(self) -> Bools:
        """The patches in view that are not seen."""
        return np.asarray((self.causes != 0) & ~self.masked)

    @cached_property
    def blind(self) -> BlindGroup | None:
        """The largest group in view that is not seen, and its most frequent cause; None of none."""
        if not self._unseen.any():
            return None
        largest = largest_group(self._unseen)
        causes = np.bincount(self.causes[largest.patches])
        return BlindGroup(largest.size, CAUSES[int(causes.argmax())], largest.box)

    @cached_property
    def fault(self) -> Fault:
        """The reason why the frame is not clear, or an empty string where enough is seen."""
        blind, turbidity = self.blind, self._turbidity
        if self.masked.all():
            return Fault(Reason.BLANK, "each patch is masked: nothing is left to see")
        if blind is None or not hides_too_much(self._unseen, self.masked):
            return turbidity
        # Where little contrast comes through, its share of the noise is another one, too.
        if turbidity and blind.cause == DAMAGED:
            return turbidity
        rows, cols = self.causes.shape
        count, of = int(self._unseen.sum()), int((~self.masked).sum())
        words = f"{count} of {of} patches are not seen, {blind.patches} of them together"
        words = f"{blind.cause}: {words}, {_place(blind, rows, cols)}"
        if blind.cause in _BY_LIMITS:
            words += self.unlearnt
        return Fault(_REASONS[blind.cause], words)

    @property
    def _turbidity(self) -> Fault:
        if self.visibility is None or self.visibility >= self.least_visibility:
            return NO_FAULT
        words = f"contrast is {self.visibility:.2f} of the training frames', at least "
        words += f"{self.least_visibility:.2f} is needed{self.unlearnt}"
        return Fault(Reason.VISIBILITY, words)

    def to_fields(self) -> dict[str, tuple[float, ...]]:
        """The ``sight`` of a verdict."""
        seen: dict[str, tuple[float, ...]] = {"seen": (round(self.share, 3),)}
        if self.masked.any():
            seen["masked"] = (round(float(self.masked.mean()), 3),)
        if self.visibility is not None:
            seen["visibility"] = (round(self.visibility, 2),)
        if self.reach_m is not None:
            seen["visibility_m"] = (round(self.reach_m, 1),)
        if self.blind is None:
            return seen
        rows, cols = self.causes.shape
        parts = zip(self.blind.box, (cols, rows, cols, rows), strict=True)
        return {**seen, "blind": tuple(round(part / of, 3) for part, of in parts)}

    @property
    def is_blind(self) -> bool:
        """True where no patch has any picture, so that what a detector finds is nothing."""
        return bool((_NO_PICTURE[self.causes] | self.masked).all())


def _place(blind: BlindGroup, rows: int, cols: int) -> str:
    """Say where a group is."""
    left, top, width, height = blind.box
    across = 2 * left + width - cols
    down = 2 * top + height - rows
    if width > 0.8 * cols and height > 0.8 * rows:
        return "all over"
    if abs(across) >= abs(down):
        return "at the left" if across < 0 else "at the right" if across > 0 else "in the middle"
    return "above" if down < 0 else "below"


_WHOLE = SightMap(np.zeros((10, 10), np.uint8))
"""The map of a frame that is too small for patches: nothing speaks against it."""


@dataclass(frozen=True)
class _Measured:
    """The map of the last picture of one side."""

    picture: U8
    shared: SharedPictures  # the frame's: a source may give the next picture in the same memory
    sight: SightMap


class SightMeter:
    """Say what is seen of the frames of one run.

    Parameters
    ----------
    limits : sequence of SightLimits
        Of a model, by frame size; empty where it has none.
    """

    def __init__(self, limits: Sequence[SightLimits] = (), otherwise: SightLimits = UNMEASURED):
        self.limits = limits
        self._otherwise = otherwise
        self._last: dict[str, _Measured] = {}
        self._contrasts: deque[float] = deque(maxlen=CONTRAST_FRAMES)

    def of(self, frame: Frame, side: str = "left") -> SightMap:
        """Map what is seen of a frame's picture, once for all detectors.

        Parameters
        ----------
        frame : Frame
            Which has a picture on that side.
        side : {"left", "right"}
        """
        picture, last = getattr(frame, side), self._last.get(side)
        if last is None or last.picture is not picture or last.shared is not frame.shared:
            pictures = frame.pictures(side, detail_grid(picture.shape[1]))
            sight, contrast = self._measured(picture, pictures, frame.mask(side))
            if side == "left" and contrast is not None:
                sight = self._with_visibility(sight, contrast, *picture.shape[:2])
            last = self._last[side] = _Measured(picture, frame.shared, sight)
        return last.sight

    def measure(self, picture: U8, mask: ViewMask | None = None) -> SightMap:
        """Map what is seen of a picture alone, uint8 (height, width) or (height, width, 3).

        It is covered where it has a mask.
        """
        return self._measured(picture, None, mask)[0]

    def _measured(
        self, picture: U8, pictures: FramePictures | None, mask: ViewMask | None
    ) -> tuple[SightMap, float | None]:
        """Map a picture, which is covered already where it has a mask; and give its contrast."""
        masked = masked_patches(picture, mask)
        detail = patch_detail(picture, pictures, masked)
        if detail is None:
            return _WHOLE, None
        height, width = picture.shape[:2]
        learnt = limits_for(self.limits, height, width)
        causes = _causes(detail, learnt or self._otherwise)
        unlearnt = ""
        if learnt is not None and (learnt.height, learnt.width) != (height, width):
            # Limits of another camera do not prove that there is no picture at all.
            flat = causes == CAUSES.index(FLAT)
            causes[flat & (detail.difference >= FLAT_GREY)] = CAUSES.index(DAMAGED)
            unlearnt = (
                f"; compared with {learnt.width}x{learnt.height} frames, as none of "
                f"{width}x{height} were learnt (--sharp-frames)"
            )
        if learnt is NOTHING_SEEN:
            unlearnt = "; nothing is known of this camera"
        if masked is not None:
            causes[masked] = _MASKED
        return SightMap(causes, unlearnt=unlearnt), detail.visible_contrast

    def _with_visibility(
        self, sight: SightMap, contrast: float, height: int, width: int
    ) -> SightMap:
        """Follow the contrast over the frames that have light."""
        limits = limits_for(self.limits, height, width)
        if limits is None or not limits.contrast:
            return sight
        if not (_UNLIT[sight.causes] | sight.masked).all():
            self._contrasts.append(contrast)
        if not self._contrasts:
            return sight
        visibility = float(median(self._contrasts)) / limits.contrast
        least = limits.least_contrast / limits.contrast
        return replace(sight, visibility=visibility, least_visibility=least)


def unseen_causes(
    limits: Sequence[SightLimits], picture: U8, mask: ViewMask | None, grid: Grid
) -> list[str]:
    """Say of each patch of a grid why it is not seen; empty where it is, or is masked.

    A patch has the cause of the one of `detail_grid` in which its centre lies.

    Parameters
    ----------
    limits : sequence of SightLimits
        Of a model; without any only what is dark, saturated or of one level is told.
    picture : array of uint8, shape (height, width) or (height, width, 3)
        Covered, where it has a mask.
    mask : ViewMask or None
    grid : Grid
    """
    return causes_on_grid(SightMeter(limits).measure(picture, mask), picture, grid)


def causes_on_grid(sight: SightMap, picture: U8, grid: Grid) -> list[str]:
    """Say of each patch of a grid why it is not seen, by the picture's map; as `unseen_causes`."""
    causes = sight.causes
    if not causes.any():  # among others where the frame is too small for patches
        return [""] * grid.n_patches
    height, width = picture.shape[:2]
    shown = grid.resized(height, width)
    measured = detail_grid(width)
    other = measured.resized(height, width)
    y0, y1, x0, x1 = grid.boxes(*shown).T
    middles = np.stack([(y0 + y1) / 2, (x0 + x1) / 2], axis=1) / shown * other
    places = (middles / measured.patch_size(*other)).astype(np.int64)
    rows, cols = places.clip(0, np.array(causes.shape) - 1).T
    return ["" if CAUSES[at] == MASKED else CAUSES[at] for at in causes[rows, cols]]


def stereo_meter() -> SightMeter:
    """A meter for pairs without a model."""
    return SightMeter(otherwise=ANY_CAMERA)


def _causes(detail: PatchDetail, limits: SightLimits) -> NDArray[np.uint8]:
    """Name each patch's cause; of several the one that stands last here."""
    over = detail.measures > limits.limits
    causes = np.zeros(detail.level.shape, np.uint8)
    if over.any():
        blurred = over[..., _NOISE]
        causes[over.any(axis=-1)] = CAUSES.index(DAMAGED)
        causes[over[..., _COARSE]] = CAUSES.index(FLAT)
        causes[blurred.any(axis=-1)] = CAUSES.index(SMEARED)
        causes[blurred.all(axis=-1)] = CAUSES.index(BLURRED)
    causes[detail.repeated > limits.repeated + 1e-3] = CAUSES.index(SMEARED)
    causes[detail.difference < FLAT_GREY] = CAUSES.index(FLAT)
    causes[detail.bright >= BRIGHT_PART] = CAUSES.index(SATURATED)
    causes[detail.level < limits.darkest] = CAUSES.index(DARK)
    return causes
