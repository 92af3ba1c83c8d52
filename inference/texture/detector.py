"""The texture detector: a model's obstacle patches, by its frame rule, become the mask."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tokt.features.common.arrays import F64, I64, Bools
from tokt.features.frames.grid import Grid
from tokt.inference.frame import Frame, shape_fault
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.sight import CONTRAST_FRAMES, SightMap, SightMeter
from tokt.inference.verdict import (
    OBSTACLE,
    STATUS_MEAN_THRESHOLD,
    TEXTURE,
    UNKNOWN,
    ClassPatches,
    Detection,
    Detector,
)
from tokt.models.distribution import bin_counts
from tokt.models.frame_sizes import size_fault
from tokt.models.linear import moved
from tokt.models.operating_point import MofNState
from tokt.models.sight import blindness
from tokt.models.water import WaterState

if TYPE_CHECKING:
    from tokt.models.bundle.bundle import Bundle

OUT_OF_RANGE = 0.5
"""Part of the features that one frame may have out of range for a clear that is believed. Measured
with models of half of the sea trial's blocks on the other half: at most 0.03 where the frame is
clear; 0.62 and more of haze, glow, an offset and an inverted picture."""


def min_mask_patches(grid: Grid, height: int, width: int) -> int:
    """Patches it takes to bring a mask's mean over the thesis's limit.

    1, but in grids of more than 700 patches, where a single one is too little for a status. Height
    and width are those of the resized frame, in pixels.
    """
    mean_of_one = 255.0 * math.prod(grid.patch_size(height, width)) / (height * width)
    return int(STATUS_MEAN_THRESHOLD // mean_of_one) + 1


@dataclass(frozen=True)
class MofNResult:
    """The rule's answer on one frame.

    The patches are white in the mask: nothing where the frame is clear; None where the frames
    before are not known well enough to say. The note says which frames the rule waits for or holds
    on to; empty where this frame alone decides.
    """

    patches: Bools | None
    note: str = ""


class MofNRun(MofNState):
    """The operating point's frame rule over one run's frames, in their order."""

    def result(self, scores: F64, patches: Bools, min_mask_patches: int) -> MofNResult:
        """What the frame that was begun comes to; of its patches, shape (n_patches,).

        `scores` are their obstacle scores, `patches` says which are obstacles; see `add`.
        """
        status = self.judge(scores, min_mask_patches)
        over = int(np.count_nonzero(scores > self.rule.margin))
        confirmed = self.confirmed
        if status == OBSTACLE:
            # What stayed for some frames is where it was, even if this frame does not show it.
            seen = bool(over) or not confirmed.any()
            return MofNResult(patches | confirmed, "" if seen else self._words("holds", over))
        if status == UNKNOWN:
            return MofNResult(None, self._words("waits, frames before are not known", over))
        nothing = np.zeros_like(patches)
        return MofNResult(nothing, self._words("waits", over) if over else "")

    def _words(self, does: str, over: int) -> str:
        rule = self.rule
        return (
            f"frame rule {does}: {over} patches over the margin in this frame, "
            f"{int(self.confirmed.sum())} in {rule.m} of the last {rule.n}, "
            f"{rule.min_patches} needed"
        )


def _in_view(patches: ClassPatches, view: Bools | None) -> ClassPatches:
    """The patches of each class that are in view, and the classes that have any."""
    if view is None:
        return patches
    inside = {name: tuple(at for at in cells if view[at]) for name, cells in patches.items()}
    return {name: cells for name, cells in inside.items() if cells}


class TextureDetector:
    """Texture: where the frame rule says obstacle, the model's obstacle patches are the mask.

    Elsewhere the mask is empty. It judges the frames of one run in their order: what it says of a
    frame can depend on those before.

    Parameters
    ----------
    scorer : Bundle
        Or anything that has as much of a bundle as this class asks for.
    threads : int
        That share one frame's rows of patches; the verdict does not depend on how many.
    sight : SightMeter, optional
        What else looks at the same frames reads its maps too; it takes this scorer's limits.
    """

    method = TEXTURE

    def __init__(self, scorer: Bundle, threads: int = 1, sight: SightMeter | None = None) -> None:
        self.scorer = scorer
        self.threads = threads
        self._sight = SightMeter() if sight is None else sight
        self._sight.limits = scorer.sight
        self._rule = MofNRun(scorer.operating_point.rule)
        self._water = WaterState(scorer.operating_point.water)

    @property
    def window_frames(self) -> int:
        """How many of the last frames decide about one, itself among them."""
        frames = self._water.prior.frames if self._water.prior else 1
        if any(each.contrast for each in self.scorer.sight):
            frames = max(frames, CONTRAST_FRAMES)
        # Each of the rule's frames has its own boundary, and its own visibility.
        return self._rule.rule.n + frames - 1

    def detect(self, frame: Frame) -> Detection:
        """Judge the left picture."""
        self._rule.begin(frame.missed)
        self._water.begin(frame.missed)
        if frame.left is None:
            return self._unjudged(
                frame.left_fault or Fault(Reason.MISSING, "there is no left frame")
            )
        # First what needs no look at the pixels: a picture of another shape may have no resize.
        fault = shape_fault(frame.left)
        if fault:
            return self._unjudged(fault)
        height, width = frame.left.shape[:2]
        if words := size_fault(height, width, self.scorer.frame_sizes):
            return self._unjudged(Fault(Reason.WRONG_SIZE, words))
        grid = self.scorer.grid
        pictures = frame.pictures("left", grid, self.threads)
        pictures.prepare(self.scorer.images)
        sight = self._sight.of(frame)
        mask, size = frame.mask("left"), grid.resized(*frame.left.shape[:2])
        view = None if mask is None else ~mask.patches(grid, *size).ravel()
        if sight.is_blind or (view is not None and not view.any()):
            fault = sight.fault or Fault(Reason.BLANK, "each patch of the model's grid is masked")
            return replace(self._unjudged(fault), sight=sight)
        if self.scorer.needs_colour and not pictures.has_colour:
            fault = Fault(Reason.NO_COLOUR, "the model looks at colours, and the frame is gray")
            return replace(self._unjudged(fault), sight=sight)
        features = self.scorer.features(frame.left, pictures, self.threads)
        values = self.scorer.values_of(features)
        if not np.isfinite(values).all():
            words = "the model gave a decision value that is not finite"
            return self._unjudged(Fault(Reason.NOT_FINITE, words))
        model, boundary = self.scorer.model, None
        if self._water.prior is not None:
            gray = self.scorer.is_gray(features)
            boundary = self._water.judge(model.obstacle_score(values), gray=gray)
            values = moved(values, boundary, model.obstacle)
        found = self._ruled(values, *size, view)
        clear = ~model.obstacle_patches(values)
        if view is not None:
            features, clear = features[view], clear[view]
        known = self.scorer.distribution
        counts = None if known is None else bin_counts(features, known.edges)
        found = self._believed(found, sight, counts, features[clear])
        # Of a model without sight the run says it once, so that older logs are judged as they were.
        blind = blindness(self.scorer.sight, height, width) if self.scorer.sight else ""
        blind = blind and f"a blurred view may look like open water: {blind}"
        note = "; ".join(filter(None, (found.note, blind)))
        behind = replace(found, features=features, counts=counts, boundary=boundary)
        return replace(behind, note=note, sight=sight)

    def _believed(
        self, found: Detection, sight: SightMap, counts: I64 | None, clear: F64
    ) -> Detection:
        """Take clear back where nothing proves it, of the patches in view.

        `counts` are those of all their features, `clear` the features of those without an obstacle.
        """
        fault = sight.fault or self._unlike_training(counts) or self._never_learnt(clear)
        if not fault:
            return found
        self._rule.doubt()
        if found.mask is not None and not found.mask.any():
            return replace(found, mask=None, fault=fault, vetoes_clear=True)
        if found.mask is not None and sight.fault:
            return replace(found, fault=sight.fault)
        return found

    def _unlike_training(self, counts: I64 | None) -> Fault:
        """Why the model says nothing where it sees nothing in such a frame, or an empty string."""
        distribution = self.scorer.distribution
        if distribution is None or counts is None:
            return NO_FAULT
        out = distribution.out_of_range(counts)
        if out > OUT_OF_RANGE:
            words = f"{100 * out:.0f} % of the features are unlike the training frames'"
            return Fault(Reason.DRIFT, words)
        return NO_FAULT

    def _never_learnt(self, clear: F64) -> Fault:
        """Whether one of these clear patches is unlike all that the model learnt from."""
        limit = self.scorer.operating_point.unlike
        if limit is None or self.scorer.model.map is None or not len(clear):
            return NO_FAULT
        farthest = float(self.scorer.model.map.distance(clear).max())
        if farthest <= limit:
            return NO_FAULT
        words = (
            f"a patch is unlike all that was learnt (distance {farthest:.2f}, limit {limit:.2f})"
        )
        return Fault(Reason.NOVEL, words)

    def _ruled(self, values: F64, height: int, width: int, view: Bools | None) -> Detection:
        """What the decision values of a frame resized to `height` x `width` come to.

        Of patches that are not in `view`, (n_patches,), nothing is said.
        """
        grid, model = self.scorer.grid, self.scorer.model
        scores, patches = model.obstacle_score(values), model.obstacle_patches(values)
        if view is not None:
            scores, patches = np.where(view, scores, -np.inf), patches & view
        ruled = self._rule.result(scores, patches, min_mask_patches(grid, height, width))
        classes = _in_view(model.class_patches(values), view) if model.named_classes else None
        if view is not None:
            values = np.where(view[:, None], values, np.nan)
        if ruled.patches is None:
            unjudged = self._unjudged(Fault(Reason.FRAME_RULE, ruled.note))
            return replace(unjudged, decision_values=values, vetoes_clear=True)
        mask, label = grid.paint(ruled.patches, height, width), self.scorer.label
        return Detection(
            mask,
            TEXTURE,
            label,
            decision_values=values,
            grid=grid,
            class_patches=classes,
            note=ruled.note,
        )

    def _unjudged(self, fault: Fault) -> Detection:
        return Detection(None, TEXTURE, self.scorer.label, fault=fault)


class ReloadableTextureDetector:
    """A texture detector whose model can be exchanged between two frames.

    It passes each frame to the detector it holds; that is exchanged by the thread that calls
    `detect`, never within a frame. `note` is what is not as it should be with the model there is,
    for every detection's note; `why_none` is why there is no detector, where there is none.
    """

    method = TEXTURE
    lacks, reason = "no model", Reason.NO_MODEL

    def __init__(self, detector: Detector | None, why_none: str = "") -> None:
        self.detector = detector
        self.note = ""
        self._why_none = why_none

    def put(self, detector: Detector, note: str = "") -> None:
        """Hold another detector, with another note."""
        self.detector, self.note = detector, note

    def detect(self, frame: Frame) -> Detection:
        """The held detector's answer; without one, that there is no model."""
        if self.detector is None:
            fault = Fault(self.reason, f"{self.lacks}: {self._why_none}")
            return Detection(None, self.method, fault=fault)
        found = self.detector.detect(frame)
        if not self.note:
            return found
        return replace(found, note="; ".join(filter(None, (self.note, found.note))))
