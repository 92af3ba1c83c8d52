"""`tokt bench`: speed against the libraries and the thesis's pipeline, in one run."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tokt.cli.options import JsonOption
from tokt.cli.output import print_json, progress, say
from tokt.features.common.errors import ToktError

if TYPE_CHECKING:
    from tokt.studies.speed.paired_timing import Result

_NOT_EXACT = 1
_PLAIN_WIDTH = 170


def bench(
    mission: Annotated[
        Path | None, typer.Option(help="Mission to measure on. Default: a rendered one.")
    ] = None,
    labels: Annotated[
        Path | None, typer.Option(help="Label file of the mission. Default: its labels.csv.")
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Stereo calibration. Default: calibration.yml in the mission or beside it.",
        ),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(
            help="Number of frames to compare results on. Default: all.",
            min=1,
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(help="Folder for bench.json and bench.png."),
    ] = Path("bench-out"),
    quick: Annotated[
        bool, typer.Option("--quick", help="Measure few frames, few times: a first look only.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Measure speed against the libraries and the thesis's pipeline; exit code 1 if not exact."""
    if calibration and mission is None:
        raise ToktError("--calibration goes together with --mission")
    from tokt.cli.stereo_file import read_calibration_file
    from tokt.studies.speed.run import FULL, QUICK, run_bench

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


def _figure(value: float) -> str:
    return f"{value:.3f}" if value < 10 else f"{value:.1f}"


def _remark(case: Result) -> str:
    """What a case has to say besides its times."""
    extras = case.extras
    if "baseline_patches_per_s" in extras:
        pace = (extras["baseline_patches_per_s"], extras["ours_patches_per_s"])
        return (
            f"{pace[0]:,.0f} to {pace[1]:,.0f} patches a second, {extras['processes']} process(es)"
        )
    if extras.get("ours_mb") and extras.get("baseline_mb"):
        return f"peak memory {extras['baseline_mb']:.0f} MB to {extras['ours_mb']:.0f} MB"
    if "pairs_checked" in extras:
        return _stereo_remark(extras)
    if "pictures_checked" in extras:
        return (
            f"ours against ours: {extras['baseline_is']} against preset best "
            f"({extras['features']} features; pictures alone {_figure(extras['floor_ms'])} ms); "
            f"asked: {extras['asked']}"
        )
    if "max_relative_difference" in extras:
        worst = extras["max_relative_difference"]
        return "not finite" if worst is None else f"largest relative difference {worst:.1g}"
    if "obstacle_patches" in extras:
        refused = f", {extras['frames_refused']} refused" if extras["frames_refused"] else ""
        ties = f", {extras['ties']} ties" if extras["ties"] else ""
        return (
            f"{extras['frames_checked']} frames compared, {extras['obstacle_patches']} obstacle "
            f"patches{refused}{ties}; baseline the thesis's way, "
            f"libraries used well {_figure(extras['libraries_ms'])} ms"
        )
    if "patches_checked" in extras:
        return f"{extras['patches_checked']} patches compared"
    if "not_the_detector_median_ms" in extras:
        return _latency_remark(extras)
    return str(extras["of"])


def _latency_remark(extras: Mapping[str, Any]) -> str:
    """The tails, and what the loop adds to the detector."""
    ours, own = (
        [_figure(extras[f"{name}_{place}_ms"]) for place in ("median", "p99", "max")]
        for name in ("ours", "not_the_detector")
    )
    return (
        f"{extras['of']}: p99 {ours[1]}, longest {ours[2]} ms; of it not the detector: median "
        f"{own[0]}, p99 {own[1]} ms"
    )


def _stereo_remark(extras: Mapping[str, Any]) -> str:
    """The obstacles of both ways, the times of pairs with and without one, and what is exact."""
    seen, count = extras["obstacle_pairs"], extras["pairs_checked"]
    parts = [f"obstacle in {seen['baseline']} (thesis) and {seen['ours']} (ours) of {count} pairs"]
    for key in ("with_obstacle", "without_obstacle"):
        kind = extras[key]
        if kind is not None:
            times = f"{_figure(kind['baseline_ms'])} to {_figure(kind['ours_ms'])} ms"
            parts.append(f"{key.replace('_', ' ')}: {times}, {kind['ratio']:.3g}x")
    parts.append(f"exact: {extras['exact_is']}")
    return "; ".join(parts)


def print_table(results: Sequence[Result], about: Mapping[str, Any]) -> None:
    """Print the results on standard output, as wide as the terminal or as plain text."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else _PLAIN_WIDTH, highlight=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("case", no_wrap=True)
    for heading in ("baseline ms", "tokt ms", "ratio", "spread", "floor ms", "exact"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    for case in results:
        floor = case.extras.get("floor_ms")
        table.add_row(
            case.name,
            _figure(case.baseline_ms),
            _figure(case.ours_ms),
            f"{case.ratio:.3g}x",
            f"{case.spread[0]:.3g}-{case.spread[1]:.3g}",
            "" if floor is None else _figure(floor),
            "yes" if case.exact else "NO",
            _remark(case),
        )
    console.print(table)
    for line in about_lines(about):
        console.print(line, markup=False)


def about_lines(about: Mapping[str, Any]) -> list[str]:
    """What was measured on what, in sentences."""
    machine, kernels = about["machine"], about["kernels"]
    versions = ", ".join(
        f"{name} {machine[name]}"
        for name in ("python", "numpy", "opencv", "scikit-image", "mahotas", "scikit-learn")
    )
    lines = [
        f"kernels: {kernels['name']} ({kernels['why']})",
        f"mission: {about['mission']}, frames of {about['frame_size']}; "
        f"{about['frames']['compared']} compared, {about['frames']['timed']} timed",
        f"stereo: {about['stereo']}",
        f"model: {about['model']}. A figure of speed only: nothing is said of accuracy.",
        f"spread: {about['spread_is']}",
        f"machine: {machine['cpu']}, {machine['cores']} core(s); {versions}",
    ]
    if kernels["is_library"]:
        lines.insert(1, "these kernels ARE the libraries: a kernel's ratio is about 1 by nature")
    return lines
