"""Days at sea in a quarter of an hour: `tokt run` on a million small frames.

::

    feed.py                           tokt run --source stream:...
    frames after a plan    ── TCP ──> runtime, and all around it
    is it so? v1 as v2?    <── UDP ── v1, v2
    attend.py
    store: another model   ─────────> hot reload
    memory                 <── HTTP ─ metrics
"""

import sys
import tempfile
from dataclasses import asdict, replace
from pathlib import Path

from tests.load.report import Found, machine_words, table, yes_or_no
from tokt.features.common.errors import ToktError
from tokt.features.common.machine import machine
from tokt.features.common.terminal import say

from .chart import chart_png
from .live import LiveRuns
from .plan import SoakSize
from .run import bare_run, whole_run
from .synthetic_frames import bundles
from .verdict import Soak

_MODELS = 3


def run_soak(extent: SoakSize) -> Found:
    if sys.platform == "win32":
        raise ToktError("the soak kills processes as only POSIX systems can")
    with tempfile.TemporaryDirectory(prefix="tokt-soak-") as name:
        folder = Path(name)
        models = bundles(_MODELS)
        say(f"-- {extent.frames} frames with everything around the loop")
        whole = whole_run(folder / "whole", extent, models)
        say(f"-- {extent.bare_frames} frames with nothing around it")
        quiet = replace(extent, frames=extent.bare_frames)
        bare = bare_run(folder / "bare", quiet, models[0])
        say(f"-- {extent.pauses} pauses; the runtime is killed {extent.kills} times")
        live = LiveRuns(folder / "live", models[0])
        pauses = live.pauses(extent.pauses, extent.pause_s)
        restart = live.restarts(extent.kills) if extent.kills else None
    about = {"extent": asdict(extent), "machine": machine()}
    found = Soak(whole, bare, pauses, restart, about)
    rows = [(*check[:3], yes_or_no(check.holds)) for check in found.checks]
    report = [
        table(("", "asked", "found", "holds"), rows, "asked", "found"),
        f"{extent.frames} frames of 180x135 pixels in {whole.seconds:.0f} s; latency: from "
        "a frame's arrival until its report is sent",
        machine_words(about),
    ]
    fault = "" if found.holds else "not everything was as asked"
    return Found("soak", found.to_json(), report, chart_png(found), fault)
