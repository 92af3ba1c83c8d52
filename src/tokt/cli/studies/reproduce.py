"""`tokt reproduce`: the thesis's tables and figures, computed again from a mission's frames."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .options import JsonOption
from .output import print_json, progress, say


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
        typer.Option(help="Its image of anything else. Default: a rendered texture."),
    ] = None,
    dark: Annotated[
        Path | None,
        typer.Option(help="A badly lit image, for figures 5.6 to 5.8. Default: a rendered one."),
    ] = None,
    dark_mask: Annotated[
        Path | None,
        typer.Option(help="A person's mask of --dark: an image, white where an obstacle is."),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(help="Stereo calibration. Default: calibrated from the frames."),
    ] = None,
    labels: Annotated[
        Path | None,
        typer.Option(help="Label file (CSV). Default: labels.csv of the mission, if there is one."),
    ] = None,
    model: Annotated[
        Path | None, typer.Option(help="A bundle (.tokt) to judge the frames with, too.")
    ] = None,
    sample: Annotated[
        int, typer.Option(help="Frames, spread over the mission, for slow methods.", min=1)
    ] = 12,
    jobs: Annotated[int | None, typer.Option(help="Processes; default: one a core.", min=1)] = None,
    json: JsonOption = False,
) -> None:
    """Compute the thesis's tables and figures again, beside other methods and tokt's own.

    Each says what the thesis printed, what came out, and whether the two agree. SLIC superpixels
    are run on a sample of the frames.
    """
    from ..features.errors import ToktError
    from ..training.reproduce.material import ReproduceRequest
    from ..training.reproduce.run import run_reproduce

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
