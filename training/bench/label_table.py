"""The labelling page's bench as tables for people."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from .effort_person import Effort
from .timing import WORST, Timing

_PLAIN_WIDTH = 170


def verdict(holds: bool | None) -> str:
    """Whether what was asked is kept, in a word."""
    return {True: "yes", False: "NO", None: ""}[holds]


def print_label_tables(
    times: Sequence[Timing], efforts: Sequence[Effort], about: Mapping[str, Any]
) -> None:
    """Print what was found on standard output, as wide as the terminal or as plain text."""
    console = Console(width=None if sys.stdout.isatty() else _PLAIN_WIDTH, highlight=False)
    if times:
        console.print(_table_of_times(times))
    if efforts:
        console.print(_table_of_efforts(efforts))
    for line in _about_lines(about):
        console.print(line, markup=False)
    for effort in efforts:
        for text in effort.wrong:
            console.print(f"{effort.way.name}: {text}", markup=False)


def _table(headings: Sequence[str]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(headings[0], no_wrap=True)
    for heading in headings[1:]:
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    return table


def _table_of_times(times: Sequence[Timing]) -> Table:
    table = _table(("ms", "p50", "p95", "worst", "asked", "kept", "n"))
    for time in times:
        of = "worst" if time.percentile == WORST else f"p{time.percentile}"
        table.add_row(
            time.name,
            *(f"{time.at(percentile):.1f}" for percentile in (50, 95, WORST)),
            "" if time.asked_ms is None else f"{of} {time.asked_ms:g}",
            verdict(time.holds),
            str(len(time.times_ms)),
            time.what,
        )
    return table


def _table_of_efforts(efforts: Sequence[Effort]) -> Table:
    table = _table(("actions", "without", "with", "ratio", "asked", "kept", "labels equal"))
    for effort in efforts:
        table.add_row(
            effort.way.name,
            " + ".join(map(str, effort.without)),
            " + ".join(map(str, effort.with_model)),
            f"{effort.ratio:.1f}x",
            "" if effort.way.asked is None else f"{effort.way.asked:g}x",
            verdict(effort.holds),
            verdict(not effort.wrong),
            effort.way.words,
        )
    return table


def _about_lines(about: Mapping[str, Any]) -> list[str]:
    """What was measured on what, in sentences."""
    lines = [
        f"effort, half {place}: {half['model']} model of frames {half['trained_on']}, "
        f"labelled {half['held_out']}; suggestions follow {half['keep']:g} (chosen where it learnt)"
        for place, half in enumerate(about["halves"], 1)
    ]
    frames = f", {about['frames']} frames of links to it" if about["frames"] else ""
    computer = about["machine"]
    lines.append(f"mission: {about['mission']}{frames}; {about['browser']}")
    lines.append(
        f"machine: {computer['cpu']}, {computer['cores']} core(s); python {computer['python']}"
    )
    return lines
