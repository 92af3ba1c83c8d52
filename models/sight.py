"""The numbers of sight: what a camera's own pictures show at least, whatever is in front of it.

A model holds them for each size of its training frames. They are limits of the measures of
`tokt.features.extractors.patch_detail`, each of which is higher the less of a picture there is: a
patch above one of them shows less than the training frames' emptiest water did.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import cv2
import numpy as np

from tokt.features.common.arrays import U8, Bools
from tokt.features.common.errors import ToktError
from tokt.features.extractors.patch_detail import (
    MEASURES,
    PatchDetail,
    masked_patches,
    patch_detail,
)
from tokt.features.frames.view_mask import ViewMask

FORMAT_VERSION = 2

_QUANTILE = 0.999
_SLACK = (0.2, 0.06, 0.06, 0.1) * 2 + (0.12,)
"""A limit is this quantile of the training frames' patches and so much more, by `MEASURES`. Chosen
on the left frames of the sea trial of 20 April 2016, cut into four stretches. With limits of three
of them no frame of the fourth has more than one patch above; with those of ten frames four, three
of them together. The right camera's 246 frames have one at most with the left one's limits."""
DARK_LEVEL = 4.0
"""Grey level, mean of a patch, below which nothing is seen; half of the darkest training patch
where that is lower. Measured: 8.2 and more, in the corner that the lamps reach least."""

MAX_UNSEEN = 0.1
MAX_TOGETHER = 0.05
MAX_MIDDLE = 3 / 16
"""Parts that may be unseen in a frame that is clear: of all patches, of all that are in one
connected group, and of the middle 4x4. The frames that `_SLACK` was chosen on have at most 0.04,
0.03 and 0 with limits of other stretches of their dive."""

LEAST_VISIBLE = 0.85
_LOW_QUANTILE = 0.05
_FEWEST_FRAMES = 20
"""The contrast that a frame has at least is this part of this quantile of a dive's frames, of the
most turbid dive, if there are so many frames: where a model learnt it may judge. On the left
frames of the sea trial of 20 April 2016 it comes to 0.62 of their median. The median of 15 of its
frames is 0.73 and more; with limits of three quarters of the dive that of the fourth is at least
0.88 of the quantile, of the right camera's 0.87. With half of the contrast it is 0.56 of the median
and less. A model of one dive takes another water for turbid where specks are fainter."""

_BLURRED_BY = (1 / 68, 1 / 227)
"""Of the width: standard deviations of blurs that limits are tried on, 20 and 6 pixels of 1360."""
_LEAST_BLUR_PX = 2.0  # the same at least: small frames show what is blurred by less
_TOLD = 0.9
"""Part of the blurred training frames in which enough has to be told as not seen."""


@dataclass(frozen=True)
class SightLimits:
    """Limits for frames of one size.

    Raises ToktError if a value is not as said here.
    """

    height: int  # of the frames, in pixels
    width: int
    darkest: float  # mean level of a patch, 0 to 255, below which nothing is seen
    repeated: float  # part of a patch's rows that may be the same as the next one, 0 to 1
    limits: tuple[float, ...]  # of each of `MEASURES`; infinite where nothing is known
    blurred: float  # part of the blurred training frames that are not clear, 0 to 1
    # Of a frame: the median of its patches' (`PatchDetail.contrast`). 0 where it is not known.
    contrast: float = 0.0  # of the training frames, their median
    least_contrast: float = 0.0  # below which too little is seen

    def __post_init__(self) -> None:
        numbers = (self.darkest, self.repeated, self.blurred, *self.limits)
        numbers += (self.contrast, self.least_contrast)
        if any(type(value) not in (int, float) or math.isnan(value) for value in numbers):
            raise ToktError("limits of sight are numbers")
        if any(type(value) is not int or value < 1 for value in (self.height, self.width)):
            raise ToktError("limits of sight are for frames of a size in pixels")
        if len(self.limits) != len(MEASURES):
            raise ToktError(f"limits of sight are {len(MEASURES)} numbers")
        parts = self.darkest / 255, self.repeated, self.blurred
        if not all(0 <= part <= 1 for part in parts):
            raise ToktError("a level is 0 to 255, a part 0 to 1")
        if not 0 <= self.least_contrast <= self.contrast < math.inf:
            raise ToktError("a contrast is at least 0, and the least of them at most their median")

    @property
    def blind(self) -> bool:
        """True where a blurred picture would pass, as training frames show no more fine detail."""
        return self.blurred < _TOLD

    @classmethod
    def of(
        cls, height: int, width: int, sharp: Sequence[PatchDetail], blurred: Sequence[PatchDetail]
    ) -> SightLimits:
        """The limits that training frames of one size give, from some of them blurred as well.

        Both have one frame at least.
        """
        lit = np.concatenate([one.measures[one.bright < BRIGHT_PART] for one in sharp])
        if not len(lit):
            lit = np.zeros((1, len(MEASURES)))
        limits = np.quantile(lit, _QUANTILE, axis=0, method="higher") + _SLACK
        darkest = min(DARK_LEVEL, 0.5 * min(float(one.level.min()) for one in sharp))
        told = np.mean([hides_too_much((one.measures > limits).any(axis=-1)) for one in blurred])
        repeated = max(
            float(one.repeated[one.bright < BRIGHT_PART].max(initial=0)) for one in sharp
        )
        rounded = tuple(round(float(limit), 3) for limit in limits)
        numbers = round(darkest, 3), round(repeated, 3), rounded, round(float(told), 3)
        contrast = float(np.median([one.visible_contrast for one in sharp]))
        return cls(height, width, *numbers, round(contrast, 5))

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return {**values, "limits": dict(zip(MEASURES, self.limits, strict=True))}

    @classmethod
    def from_json(cls, value: Any) -> SightLimits:
        """Read back what `to_json` gave. Raises ToktError if it is none."""
        known = {each.name for each in fields(cls)}
        limits = value.get("limits") if isinstance(value, Mapping) and set(value) == known else None
        if not isinstance(limits, Mapping) or set(limits) != set(MEASURES):
            raise ToktError("limits of sight have other entries")
        return cls(**{**value, "limits": tuple(limits[name] for name in MEASURES)})


BRIGHT_PART = 0.5
"""Part of a patch's pixels at 250 or more from which on it is saturated."""
_BLURRED_EVERY = 6  # training frames, one is blurred


def measure_sight(
    frames: Iterable[U8],
    masks: Iterable[ViewMask | None] = itertools.repeat(None),
    dives: Iterable[object] = itertools.repeat(None),
) -> tuple[SightLimits, ...]:
    """Measure limits for each size of some frames.

    Parameters
    ----------
    frames : iterable of array of uint8, shape (height, width) or (height, width, 3)
        As the camera gave them, or covered. Those that are too small for patches are passed over.
    masks : iterable of ViewMask or None, optional
        What is no view of each.
    dives : iterable, optional
        Which dive each is of.
    """
    contrasts: dict[object, list[float]] = {}
    sizes: dict[tuple[int, int], tuple[list[PatchDetail], list[PatchDetail]]] = {}
    for frame, mask, dive in zip(frames, masks, dives, strict=False):
        masked = masked_patches(frame, mask)
        detail = patch_detail(frame, masked=masked)
        if detail is None:
            continue
        sharp, blurred = sizes.setdefault((frame.shape[0], frame.shape[1]), ([], []))
        if len(sharp) % _BLURRED_EVERY == 0:
            tried = (patch_detail(_blurred(frame, by), masked=masked) for by in _BLURRED_BY)
            blurred += [one for one in tried if one is not None]
        sharp.append(detail)
        contrasts.setdefault(dive, []).append(detail.visible_contrast)
    found = [SightLimits.of(*size, *details) for size, details in sorted(sizes.items())]
    least = _least_contrast(list(contrasts.values()), found)
    return tuple(replace(one, least_contrast=least) for one in found)


def joined_sight(
    known: Sequence[SightLimits], measured: Sequence[SightLimits]
) -> tuple[SightLimits, ...]:
    """Join the limits of a model with those that were measured since.

    These replace limits of the same size, which are another camera's: pictures may pass the higher
    limits of both that pass neither's own. Where they are of too few frames to tell the least
    contrast, it is that of the model, as far as their own frames have it.
    """
    sizes = {(one.height, one.width) for one in measured}
    others = [one for one in known if (one.height, one.width) not in sizes]
    least = min((one.least_contrast for one in known if one.least_contrast), default=0.0)
    told = [
        one
        if one.least_contrast
        else replace(one, least_contrast=min(least, round(LEAST_VISIBLE * one.contrast, 5)))
        for one in measured
    ]
    return tuple(sorted([*others, *told], key=lambda one: (one.height, one.width)))


def _least_contrast(dives: Sequence[Sequence[float]], sizes: Sequence[SightLimits]) -> float:
    """The contrast below which too little is seen; 0 of too few frames to tell."""
    if sum(map(len, dives)) < _FEWEST_FRAMES:
        return 0.0
    lows = [float(np.quantile(frames, _LOW_QUANTILE)) for frames in dives]
    return round(LEAST_VISIBLE * min(*lows, *(one.contrast for one in sizes)), 5)


def _blurred(frame: U8, by: float) -> U8:
    sigma_px = max(by * frame.shape[1], _LEAST_BLUR_PX)
    return np.asarray(cv2.GaussianBlur(frame, (0, 0), sigma_px), np.uint8)


class PatchGroup(NamedTuple):
    """A connected group of patches."""

    patches: Bools  # (rows, cols)
    size: int  # number of patches
    box: tuple[int, int, int, int]  # first column, first row, columns, rows


def largest_group(patches: Bools) -> PatchGroup:
    """The largest group of patches that share sides; there is one at least."""
    _, labels, groups, _ = cv2.connectedComponentsWithStats(
        patches.astype(np.uint8), connectivity=4
    )
    largest = 1 + int(groups[1:, cv2.CC_STAT_AREA].argmax())
    left, top, width, height, size = map(int, groups[largest])
    return PatchGroup(labels == largest, size, (left, top, width, height))


def hides_too_much(unseen: Bools, masked: Bools | None = None) -> bool:
    """Tell whether a frame is not clear with these patches unseen, shape (rows, cols).

    Masked patches are left out on purpose: they are no part of the view.
    """
    view = np.ones_like(unseen) if masked is None else ~masked
    unseen = unseen & view
    if not unseen.any():
        return False
    rows, cols = unseen.shape
    middle = np.s_[rows // 2 - 2 : rows // 2 + 2, cols // 2 - 2 : cols // 2 + 2]
    part = unseen.sum() / view.sum()
    together = largest_group(unseen).size / view.sum()
    ahead = unseen[middle].sum() / max(view[middle].sum(), 1)
    return bool(part > MAX_UNSEEN or together > MAX_TOGETHER or ahead > MAX_MIDDLE)


def sight_words(limits: Sequence[SightLimits]) -> str:
    """Say what is known of a model's sight."""
    if not limits:
        return "Sight was not measured: a picture that shows nothing may look like open water."
    told = [
        f"{100 * each.blurred:.0f} % of {each.width}x{each.height}"
        + (" (blind: as compressed video)" if each.blind else "")
        for each in limits
    ]
    return (
        "The runtime compares the fine detail of each patch with that of the training frames, and "
        "says clear only where an obstacle would be seen. When the training frames were blurred on "
        f"purpose, it refused to call them clear: {', '.join(told)}."
    )


def sight_to_json(limits: Iterable[SightLimits]) -> dict[str, Any]:
    """The ``sight`` of a bundle's manifest."""
    return {"format": FORMAT_VERSION, "sizes": [each.to_json() for each in limits]}


def sight_from_json(value: Any) -> tuple[SightLimits, ...]:
    """Read back what `sight_to_json` gave. Raises ToktError if it is none."""
    if not isinstance(value, Mapping) or set(value) != {"format", "sizes"}:
        raise ToktError("the numbers of sight have other entries")
    if value["format"] not in (1, FORMAT_VERSION) or not isinstance(value["sizes"], list):
        raise ToktError(f"the numbers of sight are of format {value['format']!r}, not 1 or 2")
    # Those of the first format have no contrast.
    added = {"contrast": 0.0, "least_contrast": 0.0} if value["format"] == 1 else {}
    sizes = ({**each, **added} if isinstance(each, Mapping) else each for each in value["sizes"])
    return tuple(SightLimits.from_json(each) for each in sizes)


def limits_for(limits: Sequence[SightLimits], height: int, width: int) -> SightLimits | None:
    """Choose the limits of a frame's size, or else of the nearest width; None of no limits."""

    def distance(one: SightLimits) -> tuple[bool, int]:
        return (one.height, one.width) != (height, width), abs(one.width - width)

    return min(limits, key=distance, default=None)


def blindness(limits: Sequence[SightLimits], height: int, width: int) -> str:
    """Say why a blurred frame of this size may look like open water, or an empty string."""
    nearest = limits_for(limits, height, width)
    if nearest is None:
        return "sight was not measured on the model's training frames"
    if nearest.blind:
        return (
            "the training frames of this size show no finer detail than blurred ones, as in video"
        )
    return ""


_UNTESTED = math.inf
ANY_CAMERA = SightLimits(
    height=1,
    width=1,
    darkest=DARK_LEVEL,
    repeated=0.7,
    limits=(6.6, -0.3, -0.1, _UNTESTED, 6.6, -0.1, -0.05, _UNTESTED, -0.3),
    blurred=1.0,
)
"""For stereo without a model: wide enough for both cameras of the sea trial, their frames resized
to width 360 and rendered ones, whose highest are 5.0, -0.36, -0.10, -0.12, 5.0, -0.23, -0.07, 0.1
and -0.29; of the last up to 0.6 of the rows are the same as the next. A camera whose noise is not
alike from pixel to pixel, a monochrome one without compression, is outside."""
NOTHING_SEEN = SightLimits(
    height=1,
    width=1,
    darkest=DARK_LEVEL,
    repeated=1.0,
    limits=(-math.inf,) * len(MEASURES),
    blurred=1.0,
)
"""For a camera of which nothing is known: no view is clear, and an obstacle stays one. No file has
it."""
UNMEASURED = SightLimits(
    height=1,
    width=1,
    darkest=DARK_LEVEL,
    repeated=1.0,
    limits=(_UNTESTED,) * len(MEASURES),
    blurred=0.0,
)
"""For models without numbers: only what is dark, saturated or of one level is told."""
