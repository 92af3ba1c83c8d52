"""`tokt reproduce`: the thesis's tables and figures, computed again from a mission's frames."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tokt.cli.options import JsonOption
from tokt.cli.output import print_json, progress, say


def reproduce(
    mission: Annotated[Path, typer.Argument(help="Mission folder (or video).")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for report.html, results.json, tables.")
    ],
    ocean: Annotated[
        Path | None,
        typer.Option(help="The thesis's image of open ocean. Default: an early frame."),
    ] = None,
    other: Annotated[
        Path | None,
        typer.Option(help="The thesis's image of anything else. Default: a rendered texture."),
    ] = None,
    dark: Annotated[
        Path | None,
        typer.Option(help="Badly lit image for figures 5.6 to 5.8. Default: a rendered one."),
    ] = None,
    dark_mask: Annotated[
        Path | None,
        typer.Option(help="Mask of --dark drawn by a person: white where an obstacle is."),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(help="Stereo calibration. Default: calibrate from the frames."),
    ] = None,
    labels: Annotated[
        Path | None,
        typer.Option(help="Label file (CSV). Default: the mission's labels.csv, if there is one."),
    ] = None,
    model: Annotated[
        Path | None, typer.Option(help="Bundle (.tokt) to judge the frames with as well.")
    ] = None,
    sample: Annotated[
        int, typer.Option(help="Number of frames for slow methods, spread over the mission.", min=1)
    ] = 12,
    jobs: Annotated[
        int | None, typer.Option(help="Processes. Default: one per core.", min=1)
    ] = None,
    json: JsonOption = False,
) -> None:
    """Reproduce the thesis's tables and figures, beside other methods and tokt's own.

    Each says what the thesis printed, what came out, and whether the two agree. SLIC superpixels
    are run on a sample of the frames.
    """
    from tokt.features.common.errors import ToktError
    from tokt.studies.thesis.inputs import ReproduceRequest
    from tokt.studies.thesis.run import run_reproduce

    if dark_mask is not None and dark is None:
        raise ToktError("--dark-mask goes together with --dark")
    request = ReproduceRequest(
        mission,
        output,
        ocean,
        other,
        dark,
        dark_mask,
        calibration,
        labels,
        model,
        sample,
        -1 if jobs is None else jobs,
    )
    results = run_reproduce(request, say, progress)
    if json:
        print_json(results)
    else:
        _print(results, output)


def _print(results: dict[str, Any], out: Path) -> None:
    for exhibit in results["exhibits"]:
        print(f"{exhibit['section']}: {exhibit['title']}")
        if exhibit["missing"]:
            print(f"  not made: {exhibit['missing']}")
        for claim in exhibit["claims"]:
            print(f"  {claim['agreement']:>20}: {claim['what']}")
            print(f"{'':24}printed {claim['printed']}; came out {claim['found']}")
    print(f"written: {out / 'report.html'}, results.json, tables and pictures, "
          f"in {results['seconds']:.0f} s")  # fmt: skip
