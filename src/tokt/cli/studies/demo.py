"""``tokt demo``: the whole chain, ending with a report to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..features.errors import ToktError
from .options import JsonOption
from .output import print_json, progress, say


def demo(
    mission: Annotated[
        Path | None, typer.Option(help="A real mission; default: a rendered one.")
    ] = None,
    labels: Annotated[Path | None, typer.Option(help="Its label file.")] = None,
    out: Annotated[
        Path, typer.Option(help="Folder for everything the demo makes; emptied first.")
    ] = Path("demo-out"),
    frames: Annotated[
        int, typer.Option(help="Stereo pairs of the rendered mission.", min=60)
    ] = 120,
    width: Annotated[
        int, typer.Option(help="Width in pixels of the rendered frames.", min=360, max=1360)
    ] = 1360,
    json: JsonOption = False,
) -> None:
    """Label file, dataset, training, registry, bundle, store, runtime, UDP: one run of it all."""
    from ..training.demo import run_demo

    if (mission is None) != (labels is None):
        raise ToktError("--mission and --labels go together")
    result = run_demo(out, mission, labels, frames, width, progress, say)
    if json:
        print_json(result)
        return
    say(f"report: {out / 'report.html'}")
