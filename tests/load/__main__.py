"""Long measurements for developers: the labelling page, the scale of training, the soak."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from tokt.cli.app import run_app
from tokt.cli.output import print_json, progress, say

_NOT_AS_ASKED = 1

FramesOption = Annotated[int | None, typer.Option(help="So many frames.", min=1)]
OutOption = Annotated[Path, typer.Option(help="Folder for the figures (JSON) and the chart (PNG).")]
QuickOption = Annotated[
    bool, typer.Option("--quick", help="Few frames and repetitions: a look, no figures.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)


def _end(figures: dict[str, Any] | None, written: Path, fault: str = "") -> None:
    """What each measurement ends with: its JSON where that was asked for, its file, its fault."""
    if figures is not None:
        print_json(figures)
    say(f"written: {written}")
    if fault:
        say(f"warning: {fault}")
        raise typer.Exit(_NOT_AS_ASKED)


@app.command()
def page(
    mission: Annotated[Path | None, typer.Option(help="Default: a rendered one.")] = None,
    labels: Annotated[Path | None, typer.Option(help="Its label file.")] = None,
    frames: FramesOption = None,
    times: Annotated[bool, typer.Option(help="Measure how long the page lets one wait.")] = True,
    effort: Annotated[bool, typer.Option(help="Measure the labelling effort.")] = False,
    out: OutOption = Path("bench-out"),
    quick: QuickOption = False,
    json: JsonOption = False,
) -> None:
    """The labelling page in a headless Chromium; exit code 1 if a label came out wrong."""
    from .page.bench import FULL, QUICK, LabelRequest, print_label_tables, run_label_bench

    extent = QUICK if quick else FULL
    if frames is not None:
        extent = replace(extent, frames=frames)
    request = LabelRequest(mission, labels, extent, times, effort)
    found = run_label_bench(out, request, progress, say)
    if not json:
        print_label_tables(found.times, found.efforts, found.about)
    fault = "" if found.faithful else "not every label came out as it was asked for"
    _end(found.to_json() if json else None, out / "label.png", fault)


@app.command()
def scale(
    frames: FramesOption = None,
    out: OutOption = Path("bench-out"),
    quick: QuickOption = False,
    json: JsonOption = False,
) -> None:
    """Time and memory of each step of training on 10^4 to 10^6 patches of rendered frames."""
    from .scale.run import FULL, QUICK, print_scale_table, run_scale_bench

    extent = QUICK if quick else FULL
    if frames is not None:
        extent = extent.up_to(frames)
    found = run_scale_bench(out, extent, progress, say)
    if not json:
        print_scale_table(found)
    _end(found.to_json() if json else None, out / "scale.json")


@app.command()
def soak(
    frames: FramesOption = None,
    out: OutOption = Path("bench-out"),
    quick: QuickOption = False,
    json: JsonOption = False,
) -> None:
    """The whole runtime on a million small frames; exit code 1 if anything was not as asked."""
    from .soak.run import FULL, QUICK
    from .soak.soak import print_soak_table, run_soak

    extent = QUICK if quick else FULL
    if frames is not None:
        extent = extent.of(frames)
    found = run_soak(out, extent, progress, say)
    if not json:
        print_soak_table(found)
    fault = "" if found.holds else "not everything was as asked"
    _end(found.to_json() if json else None, out / "soak.png", fault)


def main() -> None:
    """Run the measurement that was asked for."""
    run_app(app)


if __name__ == "__main__":
    main()
