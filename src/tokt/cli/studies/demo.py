"""``tokt demo``: the whole chain, ending with a report to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tokt.cli.options import JsonOption
from tokt.cli.output import print_json, progress, say
from tokt.features.common.errors import ToktError


def demo(
    mission: Annotated[
        Path | None, typer.Option(help="Mission to use. Default: a rendered one.")
    ] = None,
    labels: Annotated[Path | None, typer.Option(help="Label file of the mission.")] = None,
    out: Annotated[Path, typer.Option(help="Output folder; emptied first.")] = Path("demo-out"),
    frames: Annotated[
        int, typer.Option(help="Stereo pairs of the rendered mission.", min=60)
    ] = 120,
    width: Annotated[
        int, typer.Option(help="Width in pixels of the rendered frames.", min=360, max=1360)
    ] = 1360,
    json: JsonOption = False,
) -> None:
    """Run the whole chain, from a label file to UDP datagrams, and write a report."""
    from tokt.studies.demo.demo import run_demo

    if (mission is None) != (labels is None):
        raise ToktError("--mission and --labels go together")
    result = run_demo(out, mission, labels, frames, width, progress, say)
    if json:
        print_json(result)
        return
    say(f"report: {out / 'report.html'}")
