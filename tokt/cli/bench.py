"""`tokt bench`: speed against the libraries and the thesis's pipeline, in one run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from .options import JsonOption
from .output import print_json, progress, say

_NOT_EXACT = 1


def bench(
    mission: Annotated[
        Path | None, typer.Option(help="Frames to measure on; default: rendered ones.")
    ] = None,
    labels: Annotated[
        Path | None, typer.Option(help="Its label file; default: labels.csv in the mission.")
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(help="Compare results on so many frames of it; default: all.", min=1),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for bench.json and bench.png.")] = Path(
        "bench-out"
    ),
    quick: Annotated[
        bool, typer.Option("--quick", help="Few frames and repetitions: a look, no figures.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Speed against scikit-image, mahotas and the thesis's pipeline; exit code 1 if not exact."""
    from ..training.bench.run import FULL, QUICK, run_bench
    from ..training.bench.table import print_table

    effort = QUICK if quick else FULL
    if frames is not None:
        effort = replace(effort, compared=frames)
    found = run_bench(out, mission, labels, effort, progress, say)
    if json:
        print_json(found.to_json())
    else:
        print_table(found.results, found.about)
    say(f"chart: {out / 'bench.png'}")
    if not found.exact:
        say("tokt: warning: not every case gave the same as the libraries")
        raise typer.Exit(_NOT_EXACT)
