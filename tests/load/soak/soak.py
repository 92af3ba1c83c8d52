"""Days at sea in a quarter of an hour: the whole runtime on a million small frames.

::

    this process              soak_loop                        soak_receiver
    store: another model ──>  source ─> runtime ─── UDP v1 ──> the same as v2?
    metrics, memory     <──             and all     UDP v2 ──> seq, truth, silence
                                        around it
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ...features import atomic
from ...features.errors import ToktError
from ...features.machine import machine
from .soak_chart import chart_png
from .soak_extent import Extent
from .soak_loop import PARTS
from .soak_restart import measure_restart
from .soak_run import run_loop
from .soak_verdict import Soak
from .soak_world import bundles

_MODELS = 3

Progress = Callable[..., Any]
Say = Callable[[str], None]


def run_soak(out: Path, extent: Extent, progress: Progress, say: Say) -> Soak:
    """Soak, and write ``soak.json`` and ``soak.png`` into `out`.

    Parameters
    ----------
    out : Path
    extent : Extent
    progress, say : callable
        Where progress and remarks go.

    Raises
    ------
    ToktError
        If the folder cannot be had, or a program of the soak fails.
    """
    if sys.platform == "win32":
        raise ToktError("--soak kills processes as only POSIX systems can")
    if out.exists() and not out.is_dir():
        raise ToktError(f"{out} is not a folder; choose another with --out")
    with tempfile.TemporaryDirectory(prefix="tokt-soak-") as name:
        folder = Path(name)
        models = bundles(_MODELS)
        say(f"-- {extent.frames} frames with everything around the loop")
        whole = run_loop(folder / "whole", extent, models, PARTS, say)
        say(f"-- {extent.bare_frames} frames with nothing around it")
        quiet = replace(extent, frames=extent.bare_frames, pause_s=0.0)
        bare = run_loop(folder / "bare", quiet, models, (), say)
        restart = None
        if extent.kills:
            say(f"-- the runtime is killed {extent.kills} times")
            restart = measure_restart(folder / "restart", models[0], extent.kills, progress)
    found = Soak(whole, bare, restart, {"extent": asdict(extent), "machine": machine()})
    text = json.dumps(found.to_json(), indent=2, ensure_ascii=False, allow_nan=False)
    atomic.write_text(out / "soak.json", text + "\n")
    atomic.write_bytes(out / "soak.png", chart_png(found))
    return found
