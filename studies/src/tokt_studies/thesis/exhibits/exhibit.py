"""Exhibits of the report, claims, tables and plots, and the context that they are made of."""

from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property, partial
from typing import Self

import pandas as pd

from tokt.models.bundle.bundle import Bundle
from tokt_studies.thesis.inputs import StudyInputs
from tokt_studies.thesis.methods import mission_models
from tokt_studies.thesis.methods.curves import Curves, measure_curves

LEARNT_ELSEWHERE = "What the methods learnt from is said at figures 5.3 to 5.5."


class ClaimAgreement(StrEnum):
    """Whether what came out is what the thesis printed."""

    YES = "agrees"
    PARTLY = "agrees in part"
    NO = "does not agree"
    UNAVAILABLE = "cannot be had from these frames"

    @classmethod
    def of(cls, whole: bool, part: bool) -> Self:
        """What holds as a whole, holds in part, or does not."""
        return cls.YES if whole else cls.PARTLY if part else cls.NO


@dataclass(frozen=True)
class Claim:
    """One thing the thesis printed, with its place, beside what this run found.

    `why` is short: what the agreement was judged by, or why there is none.
    """

    what: str
    printed: str
    found: str
    agreement: ClaimAgreement = field(default=ClaimAgreement.UNAVAILABLE, kw_only=True)
    why: str

    @classmethod
    def about(cls, what: str, printed: str) -> partial[Self]:
        """What makes the claim of the rest: what was found, why, and the agreement."""
        return partial(cls, what, printed)


@dataclass(frozen=True)
class Table:
    """A table, written as ``NAME.csv`` without its index, and shown in the report.

    The caption has the units, and how figures were split; the title is the name in words.
    """

    name: str
    caption: str
    frame: pd.DataFrame


@dataclass(frozen=True)
class Plot:
    """A picture, written as ``NAME.png`` and shown in the report."""

    name: str
    caption: str
    png: bytes


@dataclass(frozen=True)
class Exhibit:
    """One table or figure of the thesis, or several that belong together.

    What follows the plots is given by the run.
    """

    words: tuple[str, ...] = ()  # paragraphs: what was done, and how figures were split
    claims: tuple[Claim, ...] = ()
    tables: tuple[Table, ...] = ()
    plots: tuple[Plot, ...] = ()
    key: str = ""  # name of its folder and its anchor, such as ``table-5.1-to-5.4``
    title: str = ""
    section: str = ""  # where the thesis has it
    missing: str = ""  # why there is nothing to show: what it needs that this mission lacks


class StudyContext(StudyInputs):
    """The inputs of a study, and what is computed from them once."""

    @cached_property
    def superpixel_methods(self) -> mission_models.SuperpixelMethods:
        """SLIC and superpixel colours, trained for this mission."""
        return mission_models.train_superpixel_methods(self)

    @cached_property
    def tokt_model(self) -> tuple[Bundle, str]:
        """A texture model of ours, nothing to be scored here, and what it learnt from."""
        return mission_models.tokt_model(self)

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
