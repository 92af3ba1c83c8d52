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

import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rich.table import Table

from tests.load.report import FOLD, LEFT, check_folder, machine_words, table, write_json, yes_or_no
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
    check_folder(out)
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
    write_json(out / "soak.json", found.to_json())
    atomic.write_bytes(out / "soak.png", chart_png(found))
    return found


def soak_report(found: Soak) -> list[Table | str]:
    """What was asked and found, to be printed."""
    extent, columns = found.whole.extent, {"": LEFT, "asked": FOLD, "found": FOLD, "holds": LEFT}
    rows = [
        (check.name, check.asked, check.found, yes_or_no(check.holds)) for check in found.checks
    ]
    return [
        table(columns, rows),
        f"{extent.frames} frames of 180x135 pixels in {found.whole.seconds:.0f} s; latency: from "
        "a frame's arrival until its report is sent",
        machine_words(found.about),
    ]
