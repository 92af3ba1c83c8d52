"""The context that exhibits share: a study's inputs, models trained for it, and its curves."""

from __future__ import annotations

from functools import cached_property

from tokt.studies.thesis.methods.curves import Curves, measure_curves
from tokt.studies.thesis.methods.superpixel_methods import (
    SuperpixelMethods,
    train_superpixel_methods,
)
from tokt.studies.thesis.methods.texture_models import ToktModel, tokt_model

from .inputs import StudyInputs


class StudyContext(StudyInputs):
    """The inputs of a study, and what is computed from them once."""

    @cached_property
    def superpixel_methods(self) -> SuperpixelMethods:
        """SLIC and superpixel colours, trained for this mission."""
        return train_superpixel_methods(self)

    @cached_property
    def tokt_model(self) -> ToktModel:
        """A texture model of ours that learnt from all it may: nothing to be scored here."""
        return tokt_model(self)

    @cached_property
    def structure_frame(self) -> int:
        """A frame that shows the structure well.

        By labels the one with the most obstacle patches; without an obstacle labelled the one
        whose mean values, each curve's as a share of its largest, are highest together.
        """
        counts = {n: c for n, c in self.obstacle_patches.items() if n in set(self.scored) and c}
        if counts:
            return max(counts, key=lambda number: counts[number])
        return self.curves.highest()

    @cached_property
    def curves(self) -> Curves:
        """Mean value and status of every frame by every method."""
        return measure_curves(self, self.superpixel_methods)
