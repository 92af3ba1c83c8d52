"""Days at sea in a quarter of an hour: `tokt run` on a million small frames.

::

    feed.py                           tokt run --source stream:...
    frames after a plan    ── TCP ──> runtime, and all around it
    is it so? v1 as v2?    <── UDP ── v1, v2
    attend.py
    store: another model   ─────────> hot reload
    memory                 <── HTTP ─ metrics
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError
from tokt.features.common.machine import machine

from .chart import chart_png
from .live import LiveRuns
from .run import SoakSize, bare_run, whole_run
from .synthetic_frames import bundles
from .verdict import Soak

_MODELS = 3

Progress = Callable[..., Any]
Say = Callable[[str], None]


def run_soak(out: Path, extent: SoakSize, progress: Progress, say: Say) -> Soak:
    """Soak, and write ``soak.json`` and ``soak.png`` into `out`.

    Parameters
    ----------
    out : Path
    extent : SoakSize
    progress, say : callable
        Where progress and remarks go.

    Raises
    ------
    ToktError
        If the folder cannot be had, or a program of the soak fails.
    """
    if sys.platform == "win32":
        raise ToktError("the soak kills processes as only POSIX systems can")
    if out.exists() and not out.is_dir():
        raise ToktError(f"{out} is not a folder; choose another with --out")
    with tempfile.TemporaryDirectory(prefix="tokt-soak-") as name:
        folder = Path(name)
        models = bundles(_MODELS)
        say(f"-- {extent.frames} frames with everything around the loop")
        whole = whole_run(folder / "whole", extent, models, say)
        say(f"-- {extent.bare_frames} frames with nothing around it")
        quiet = replace(extent, frames=extent.bare_frames)
        bare = bare_run(folder / "bare", quiet, models[0])
        say(f"-- {extent.pauses} pauses; the runtime is killed {extent.kills} times")
        live = LiveRuns(folder / "live", models[0])
        pauses = live.pauses(extent.pauses, extent.pause_s)
        restart = live.restarts(extent.kills, progress) if extent.kills else None
    about = {"extent": asdict(extent), "machine": machine()}
    found = Soak(whole, bare, pauses, restart, about)
    text = json.dumps(found.to_json(), indent=2, ensure_ascii=False, allow_nan=False)
    atomic.write_text(out / "soak.json", text + "\n")
    atomic.write_bytes(out / "soak.png", chart_png(found))
    return found


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
        "a frame's arrival until its report is sent",
        f"machine: {computer['cpu']}, {computer['cores']} core(s); python {computer['python']}",
    ]
    for line in lines:
        console.print(line, markup=False)
