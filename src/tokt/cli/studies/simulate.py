"""`tokt simulate`: render a synthetic mission, or fly a vehicle through rendered water."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tokt.cli import output
from tokt.features.common.errors import ToktError

_FOR_MISSIONS = ("frames",)
_FOR_CLOSED_LOOP = ("scenes", "methods", "runs", "model")


def simulate(
    context: typer.Context,
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New folder to write.")],
    seed: Annotated[
        int,
        typer.Option(
            help="Seed; the same one gives the same bytes. With --closed-loop: of the first run."
        ),
    ] = 1,
    frames: Annotated[int, typer.Option(help="Mission: number of stereo pairs to render.")] = 120,
    width: Annotated[
        int | None,
        typer.Option(
            help="Frame width in pixels. Default: 1360 for a mission, 360 in the closed loop."
        ),
    ] = None,
    closed_loop: Annotated[
        bool,
        typer.Option(
            "--closed-loop",
            help="Fly a vehicle that tokt run steers, instead of rendering a mission.",
        ),
    ] = False,
    scenes: Annotated[
        str | None, typer.Option(help="Closed loop: scenes, separated by commas. Default: all.")
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(
            help="Closed loop: any of texture,disparity,either,fallback,none. Default: all."
        ),
    ] = None,
    runs: Annotated[
        int, typer.Option(help="Closed loop: number of runs of each scene and method.")
    ] = 5,
    model: Annotated[
        Path | None,
        typer.Option(
            metavar="BUNDLE",
            help="Closed loop: model to fly. Default: one trained on rendered missions.",
        ),
    ] = None,
    jobs: Annotated[int | None, typer.Option(help="Processes. Default: one per core.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Render a synthetic mission with exact labels, masks and depth; or fly the closed loop."""
    _refuse(context, _FOR_MISSIONS if closed_loop else _FOR_CLOSED_LOOP, closed_loop)
    if closed_loop:
        from .closed_loop import fly_and_report

        fly_and_report(folder, scenes, methods, seed, runs, width, model, jobs, as_json)
        return
    _mission(folder, seed, frames, width, jobs, as_json)


def _refuse(context: typer.Context, names: tuple[str, ...], closed_loop: bool) -> None:
    """Refuse options that would do nothing."""
    for name in names:
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            where = "for a mission, not for --closed-loop" if closed_loop else "for --closed-loop"
            raise ToktError(f"--{name} is {where}")


def _mission(
    folder: Path, seed: int, frames: int, width: int | None, jobs: int | None, as_json: bool
) -> None:
    from tokt.studies.simulation.rendering.synthetic_mission import simulate_mission
    from tokt.studies.simulation.scene.rig import FULL_WIDTH

    mission = simulate_mission(
        folder,
        seed=seed,
        n_frames=frames,
        width=FULL_WIDTH if width is None else width,
        jobs=jobs,
        progress=output.progress,
    )
    if as_json:
        output.print_json(mission.to_json())
        return
    nearest = "never in view" if mission.nearest_m is None else f"nearest {mission.nearest_m:.2f} m"
    print(
        f"{mission.path}: {mission.frames} stereo pairs of {mission.width}x{mission.height}, "
        f"{mission.ocean_frames} of open ocean, {mission.obstacle_frames} with the tower, {nearest}"
    )
    print("patches: " + ", ".join(f"{count} {label}" for label, count in mission.patches.items()))
