"""`tokt bench`: speed against the libraries and the thesis's pipeline, in one run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ..features.errors import ToktError
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
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Its stereo calibration; default: calibration.yml in the mission or beside it.",
        ),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(
            help="Compare results on so many frames of it; default: all. With --label: frames of "
            "the mission that the page shows; default: 10000. With --scale: the most frames; "
            "default: 10000. With --soak: frames to judge; default: 1000000.",
            min=1,
        ),
    ] = None,
    label: Annotated[
        bool,
        typer.Option("--label", help="Measure instead how long the labelling page lets one wait."),
    ] = False,
    effort: Annotated[
        bool,
        typer.Option(
            "--effort", help="Measure instead the labelling effort with suggestions and without."
        ),
    ] = False,
    scale: Annotated[
        bool,
        typer.Option(
            "--scale", help="Measure instead what training costs for 10^4 to 10^6 patches."
        ),
    ] = False,
    soak: Annotated[
        bool,
        typer.Option(
            "--soak",
            help="Run the runtime for long instead: memory, latency, lost datagrams, restarts.",
        ),
    ] = False,
    out: Annotated[
        Path,
        typer.Option(
            help="Folder for bench.json and bench.png, label.json and label.png, scale.json, or "
            "soak.json and soak.png."
        ),
    ] = Path("bench-out"),
    quick: Annotated[
        bool, typer.Option("--quick", help="Few frames and repetitions: a look, no figures.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Speed against scikit-image, mahotas and the thesis's pipeline; exit code 1 if not exact.

    With --label and --effort: the labelling page in a headless Chromium (needs Playwright); exit
    code 1 if a label came out wrong. With --scale: time and memory of each step of training on
    rendered frames, in a temporary folder that needs some GB. With --soak: the whole runtime on
    a million small frames, some 20 minutes; exit code 1 if anything was not as asked.
    """
    if soak:
        if scale or label or effort or mission or labels or calibration:
            raise ToktError("--soak renders its own frames and goes with --frames and --quick")
        _soak_bench(frames, out, quick, json)
        return
    if scale:
        if label or effort or mission or labels or calibration:
            raise ToktError("--scale renders its own mission and goes with --frames and --quick")
        _scale_bench(frames, out, quick, json)
        return
    if calibration and (label or effort or mission is None):
        raise ToktError("--calibration goes together with --mission, without --label and --effort")
    if label or effort:
        _label_bench(mission, labels, frames, label, effort, out, quick, json)
        return
    from ..training.bench.run import FULL, QUICK, run_bench
    from ..training.bench.table import print_table
    from .stereo_file import read_calibration_file

    extent = QUICK if quick else FULL
    if frames is not None:
        extent = replace(extent, compared=frames)
    known = read_calibration_file(calibration) if calibration else None
    found = run_bench(out, mission, labels, extent, progress, say, known)
    if json:
        print_json(found.to_json())
    else:
        print_table(found.results, found.about)
    say(f"chart: {out / 'bench.png'}")
    if not found.exact:
        say("tokt: warning: not every case gave the same as the libraries")
        raise typer.Exit(_NOT_EXACT)


def _label_bench(
    mission: Path | None,
    labels: Path | None,
    frames: int | None,
    times: bool,
    effort: bool,
    out: Path,
    quick: bool,
    json: bool,
) -> None:
    from ..training.bench.label_page import FULL, QUICK, LabelRequest, run_label_bench
    from ..training.bench.label_table import print_label_tables

    extent = QUICK if quick else FULL
    if frames is not None:
        extent = replace(extent, frames=frames)
    request = LabelRequest(mission, labels, extent, times, effort)
    found = run_label_bench(out, request, progress, say)
    if json:
        print_json(found.to_json())
    else:
        print_label_tables(found.times, found.efforts, found.about)
    say(f"chart: {out / 'label.png'}")
    if not found.faithful:
        say("tokt: warning: not every label came out as it was asked for")
        raise typer.Exit(_NOT_EXACT)


def _scale_bench(frames: int | None, out: Path, quick: bool, json: bool) -> None:
    from ..training.bench.scale_run import FULL, QUICK, run_scale_bench
    from ..training.bench.scale_table import print_scale_table

    extent = QUICK if quick else FULL
    if frames is not None:
        extent = extent.up_to(frames)
    found = run_scale_bench(out, extent, progress, say)
    if json:
        print_json(found.to_json())
    else:
        print_scale_table(found)
    say(f"written: {out / 'scale.json'}")


def _soak_bench(frames: int | None, out: Path, quick: bool, json: bool) -> None:
    from ..training.bench.soak import run_soak
    from ..training.bench.soak_extent import FULL, QUICK
    from ..training.bench.soak_table import print_soak_table

    extent = QUICK if quick else FULL
    if frames is not None:
        extent = extent.of(frames)
    found = run_soak(out, extent, progress, say)
    if json:
        print_json(found.to_json())
    else:
        print_soak_table(found)
    say(f"chart: {out / 'soak.png'}")
    if not found.holds:
        say("tokt: warning: not everything was as asked")
        raise typer.Exit(_NOT_EXACT)
