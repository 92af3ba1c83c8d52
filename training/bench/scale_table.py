"""The bench of scale as a table for people."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.table import Table

from .scale_run import Growth, ScaleFound
from .scale_watch import Cost

_PLAIN_WIDTH = 170


def print_scale_table(found: ScaleFound) -> None:
    """Print what was found on standard output, as wide as the terminal or as plain text."""
    console = Console(width=None if sys.stdout.isatty() else _PLAIN_WIDTH, highlight=False)
    console.print(_table(found.growths))
    console.print(
        f"frames {found.about['extent']['width']} pixels wide, rendered and repeated with other "
        f"noise; features {found.about['extractor']}; cpu s and MB (the most in use at one moment) "
        "of all processes together; ~ worked out from a fit, not measured",
        markup=False,
    )
    computer = found.about["machine"]
    console.print(
        f"machine: {computer['cpu']}, {computer['cores']} core(s); python {computer['python']}",
        markup=False,
    )


def _cell(cost: Cost) -> str:
    about = "~" if cost.facts.get("worked_out") else ""
    return f"{about}{cost.seconds:.1f} s {about}{cost.cpu_s:6.1f} cpu s {cost.peak_mb:6.0f} MB"


def _table(growths: Sequence[Growth]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("step", no_wrap=True)
    for patches in growths[0].patches:
        table.add_column(f"{patches:,} patches", justify="right", no_wrap=True)
    table.add_column("time grows as", justify="right", no_wrap=True)
    for growth in growths:
        table.add_row(
            growth.step.replace("_", " "),
            *map(_cell, growth.costs),
            "" if growth.exponent is None else f"n^{growth.exponent:.2f}",
        )
    return table
