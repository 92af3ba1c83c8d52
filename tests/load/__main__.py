"""Long measurements for developers: labelling page, training's scale, soak, live view, video."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from tests.load.report import Found, print_report
from tokt.cli.app import run_app
from tokt.features.common.terminal import print_json, say

_NOT_AS_ASKED = 1

Frames = Annotated[int | None, Option(help="So many frames.", min=1)]
Out = Annotated[
    Path, Option(help="Folder for the figures (JSON) and the chart (PNG).", file_okay=False)
]
Quick = Annotated[bool, Option("--quick", help="Few frames and repetitions: a look, no figures.")]
Json = Annotated[bool, Option("--json", help="Print one JSON object.")]
OUT = Path("bench-out")

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)


def _end(found: Found, out: Path, json: bool) -> None:
    written = found.write(out)
    if json:
        print_json(found.figures)
    else:
        print_report(found.report)
    say(f"written: {written}")
    if found.fault:
        say(f"warning: {found.fault}")
        raise typer.Exit(_NOT_AS_ASKED)


@app.command()
def page(
    mission: Annotated[Path | None, Option(help="Default: a rendered one.")] = None,
    labels: Annotated[Path | None, Option(help="Its label file.")] = None,
    frames: Frames = None,
    times: Annotated[bool, Option(help="Measure how long the page lets one wait.")] = True,
    effort: Annotated[bool, Option(help="Measure the labelling effort.")] = False,
    out: Out = OUT,
    quick: Quick = False,
    json: Json = False,
) -> None:
    """The labelling page in a headless Chromium; exit code 1 if a label came out wrong."""
    from .page.bench import FULL, QUICK, run_label_bench

    extent = QUICK if quick else FULL
    if frames is not None:
        extent = replace(extent, frames=frames)
    _end(run_label_bench(mission, labels, extent, times, effort), out, json)


@app.command()
def scale(
    frames: Frames = None,
    width: Annotated[int | None, Option(help="Of the frames, in pixels.")] = None,
    out: Out = OUT,
    quick: Quick = False,
    json: Json = False,
) -> None:
    """Time and memory of each step of training on 10^4 to 10^6 patches of rendered frames."""
    from .scale.run import FULL, QUICK, run_scale_bench

    extent = QUICK if quick else FULL
    extent = replace(extent, width=width or extent.width)
    _end(run_scale_bench(extent if frames is None else extent.up_to(frames)), out, json)


@app.command()
def soak(
    frames: Frames = None,
    fault_every: Annotated[int | None, Option(help="A fault each so many frames.", min=1)] = None,
    out: Out = OUT,
    quick: Quick = False,
    json: Json = False,
) -> None:
    """The whole runtime on a million small frames, with faults; exit code 1 if one check fails."""
    from .soak.plan import FULL, QUICK
    from .soak.soak import run_soak

    extent = QUICK if quick else FULL
    extent = extent if frames is None else extent.of(frames)
    _end(run_soak(replace(extent, fault_every=fault_every or extent.fault_every)), out, json)


@app.command()
def view(
    rounds: Annotated[int | None, Option(help="So many rounds.", min=1)] = None,
    out: Out = OUT,
    quick: Quick = False,
    json: Json = False,
) -> None:
    """A verdict's latency with and without a live view; exit code 1 if it grew by more than 5 %."""
    from .view.latency import FULL, QUICK, run_view_bench

    extent = QUICK if quick else FULL
    _end(run_view_bench(replace(extent, rounds=rounds or extent.rounds)), out, json)


@app.command()
def video(
    part: Annotated[
        list[str] | None,
        Option(help="captures, live, share, latency or readers. Repeatable. Default: all."),
    ] = None,
    out: Out = OUT,
    quick: Quick = False,
    json: Json = False,
) -> None:
    """Network video: latency, loss, faults; exit code 1 if a picture or a time is not as asked."""
    from .video.run import ALL, FULL, QUICK, run_video_bench

    extent = QUICK if quick else FULL
    _end(run_video_bench(extent, tuple(part or ALL)), out, json)


def main() -> None:
    run_app(app)


if __name__ == "__main__":
    main()
