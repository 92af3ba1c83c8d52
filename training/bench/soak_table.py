"""A soak as a table for people."""

from __future__ import annotations

import sys

from rich import box
from rich.console import Console
from rich.table import Table

from .soak_verdict import Soak

_PLAIN_WIDTH = 170


def print_soak_table(found: Soak) -> None:
    """Print what was asked and found on standard output."""
    console = Console(width=None if sys.stdout.isatty() else _PLAIN_WIDTH, highlight=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("", no_wrap=True)
    table.add_column("asked", overflow="fold")
    table.add_column("found", overflow="fold")
    table.add_column("holds", no_wrap=True)
    for check in found.checks:
        table.add_row(check.name, check.asked, check.found, "yes" if check.holds else "NO")
    console.print(table)
    extent, computer = found.whole.extent, found.about["machine"]
    lines = [
        f"{extent.frames} frames of 180x135 pixels in {found.whole.seconds:.0f} s; latency: from "
        "a frame's arrival until its datagrams are out",
        f"machine: {computer['cpu']}, {computer['cores']} core(s); python {computer['python']}",
    ]
    for line in lines:
        console.print(line, markup=False)
