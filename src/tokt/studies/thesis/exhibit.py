"""Exhibits: the words, claims, tables and plots that make one figure or table of the report."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import pandas as pd

Numbers = dict[str, float | int | str | bool]

NOT_KNOWN = "not known here"
"""What stands for a printed number that the sources at hand do not give."""


class ClaimAgreement(StrEnum):
    """Whether what came out is what the thesis printed."""

    YES = "agrees"
    PARTLY = "agrees in part"
    NO = "does not agree"
    UNCOMPARABLE = "cannot be compared"


@dataclass(frozen=True)
class Claim:
    """One thing the thesis printed, beside what came out.

    Parameters
    ----------
    what : str
        What it is about, in words.
    printed : str
        As the thesis has it, with its place; `NOT_KNOWN` where that is not at hand.
    found : str
        What this run computed.
    agreement : ClaimAgreement
    why : str
        One sentence: what the agreement was judged by, or why there is none.
    """

    what: str
    printed: str
    found: str
    agreement: ClaimAgreement
    why: str


@dataclass(frozen=True)
class Table:
    """A table, written as ``NAME.csv`` and shown in the report.

    Parameters
    ----------
    name : str
        Of its file.
    caption : str
        With units, and how its figures were split.
    frame : pandas.DataFrame
        Its rows; the index is not written.
    title : str
        For people; by default `name` in words.
    """

    name: str
    caption: str
    frame: pd.DataFrame
    title: str = ""

    @property
    def heading(self) -> str:
        """What stands above it in the report."""
        words = self.name.replace("_", " ").replace("-", " ")
        return self.title or words[:1].upper() + words[1:]


@dataclass(frozen=True)
class Plot:
    """A picture, written as ``NAME.png`` and shown in the report.

    Parameters
    ----------
    name : str
        Of its file.
    caption : str
    png : bytes
    """

    name: str
    caption: str
    png: bytes


@dataclass(frozen=True)
class Exhibit:
    """One table or figure of the thesis, or several that belong together.

    Parameters
    ----------
    key : str
        Name of its folder and its anchor, such as ``table-5.1-to-5.4``.
    title : str
    section : str
        Where the thesis has it.
    words : tuple of str
        Paragraphs: what was done, and how figures were split.
    claims : tuple of Claim
    tables : tuple of Table
    plots : tuple of Plot
    numbers : dict
        What other pages quote, by name: finite floats, ints, strings and booleans.
    missing : str
        Why there is nothing to show, where there is not: what it needs that this mission lacks.
    """

    key: str
    title: str
    section: str
    words: tuple[str, ...] = ()
    claims: tuple[Claim, ...] = ()
    tables: tuple[Table, ...] = ()
    plots: tuple[Plot, ...] = ()
    numbers: Numbers = field(default_factory=dict)
    missing: str = ""


def known(numbers: dict[str, float | int | str | bool | None]) -> Numbers:
    """Numbers without those that are None: a page that quotes one asks first if it is there."""
    return {name: value for name, value in numbers.items() if value is not None}
