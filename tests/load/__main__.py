"""Long measurements for developers: the labelling page, the scale of training, the soak."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from tests.load.report import print_report
from tokt.cli.app import run_app
from tokt.cli.output import print_json, progress, say

_NOT_AS_ASKED = 1

Frames = Annotated[int | None, typer.Option(help="So many frames.", min=1)]
Out = Annotated[Path, typer.Option(help="Folder for the figures (JSON) and the chart (PNG).")]
Quick = Annotated[
    bool, typer.Option("--quick", help="Few frames and repetitions: a look, no figures.")
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
OUT = Path("bench-out")

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)


def _end(found: Any, report: Sequence[Any], json: bool, written: Path, fault: str = "") -> None:
    """What each measurement ends with: its tables or its JSON, its file, its fault."""
    if json:
        print_json(found.to_json())
    else:
        print_report(report)
    say(f"written: {written}")
    if fault:
        say(f"warning: {fault}")
        raise typer.Exit(_NOT_AS_ASKED)


@app.command()
def page(
    mission: Annotated[Path | None, typer.Option(help="Default: a rendered one.")] = None,
    labels: Annotated[Path | None, typer.Option(help="Its label file.")] = None,
    frames: Frames = None,
    times: Annotated[bool, typer.Option(help="Measure how long the page lets one wait.")] = True,
    effort: Annotated[bool, typer.Option(help="Measure the labelling effort.")] = False,
    out: Out = OUT,
    quick: Quick = False,
    json: Json = False,
) -> None:
    """The labelling page in a headless Chromium; exit code 1 if a label came out wrong."""
    from .page.bench import EFFORT, FULL, QUICK, TIMES, label_report, run_label_bench

    extent = QUICK if quick else FULL
    if frames is not None:
        extent = replace(extent, frames=frames)
    parts = [part for part, wanted in ((TIMES, times), (EFFORT, effort)) if wanted]
    found = run_label_bench(out, mission, labels, extent, parts, progress, say)
    fault = "" if found.faithful else "not every label came out as it was asked for"
    report = label_report(found.times, found.efforts, found.about)
    _end(found, report, json, out / "label.png", fault)


@app.command()
def scale(frames: Frames = None, out: Out = OUT, quick: Quick = False, json: Json = False) -> None:
    """Time and memory of each step of training on 10^4 to 10^6 patches of rendered frames."""
    from .scale.run import FULL, QUICK, run_scale_bench, scale_report

    extent = QUICK if quick else FULL
    if frames is not None:
        extent = extent.up_to(frames)
    found = run_scale_bench(out, extent, progress, say)
    _end(found, scale_report(found), json, out / "scale.json")


@app.command()
def soak(frames: Frames = None, out: Out = OUT, quick: Quick = False, json: Json = False) -> None:
    """The whole runtime on a million small frames; exit code 1 if anything was not as asked."""
    from .soak.run import FULL, QUICK
    from .soak.soak import run_soak, soak_report

    extent = QUICK if quick else FULL
    if frames is not None:
        extent = extent.of(frames)
    found = run_soak(out, extent, progress, say)
    fault = "" if found.holds else "not everything was as asked"
    _end(found, soak_report(found), json, out / "soak.png", fault)


def main() -> None:
    """Run the measurement that was asked for."""
    run_app(app)


if __name__ == "__main__":
    main()
