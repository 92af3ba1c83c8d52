"""Days at sea in an hour: `tokt run` on a million small frames, and a fault each 10,000.

::

    feed.py                            tokt run --watchdog --source stream:...
    frames after a plan     ── TCP ──> runtime, and all around it
    is it so? v1 as v2?     <── UDP ── v1, v2
    silence                            ^
    injector.py, faults.py             │
    files, ports, signals   ───────────┘
    attend.py
    memory                  <── HTTP ─ metrics
"""

import sys
import tempfile
from dataclasses import asdict, replace
from pathlib import Path

from rich.table import Table

from tests.load.report import Found, machine_words, table, yes_or_no
from tokt.features.common.errors import ToktError
from tokt.features.common.machine import machine
from tokt.features.common.terminal import say

from .chart import chart_png
from .live import LiveRuns
from .plan import SoakSize
from .run import bare_run, whole_run
from .synthetic_frames import models
from .verdict import Soak


def run_soak(extent: SoakSize) -> Found:
    if sys.platform == "win32":
        raise ToktError("the soak kills processes as only POSIX systems can")
    with tempfile.TemporaryDirectory(prefix="tokt-soak-") as name:
        folder = Path(name)
        made = models()
        say(f"-- {extent.frames} frames with everything around the loop, and faults")
        whole = whole_run(folder / "whole", extent, made)
        say(f"-- {extent.bare_frames} frames with nothing around it")
        quiet = replace(extent, frames=extent.bare_frames)
        bare = bare_run(folder / "bare", quiet, made.good[0])
        say(f"-- {extent.pauses} pauses; the runtime is killed {extent.kills} times")
        live = LiveRuns(folder / "live", made.good[0])
        pauses = live.pauses(extent.pauses, extent.pause_s)
        restart = live.restarts(extent.kills) if extent.kills else None
    about = {"extent": asdict(extent), "machine": machine()}
    found = Soak(whole, bare, pauses, restart, about)
    rows = [(*check[:3], yes_or_no(check.holds)) for check in found.checks]
    report = [
        table(("", "asked", "found", "holds"), rows, "asked", "found"),
        _fault_table(found),
        f"{extent.frames} frames of 180x135 pixels in {whole.seconds:.0f} s; latency: from "
        "a frame's arrival until its report is sent",
        machine_words(about),
    ]
    fault = "" if found.holds else "not everything was as asked"
    return Found("soak", found.to_json(), report, chart_png(found), fault)


def _fault_table(found: Soak) -> Table:
    """Each row of faults.md that was injected: how often, the longest silence, what was said."""
    headings = ("row of faults.md", "times", "longest silence", "bound", "as its row says")
    rows = [
        (
            each.words,
            str(each.times),
            f"{each.longest_s:.2f} s",
            f"{each.bound_s:.2f} s: {each.source}",
            yes_or_no(not each.missing) + "".join(f"; {words}" for words in each.missing),
        )
        for each in found.faults
    ]
    return table(headings, rows, "bound")
