"""`tokt simulate`: render a synthetic mission."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import output


def simulate(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New folder for the mission.")],
    seed: Annotated[int, typer.Option(help="The same seed gives the same bytes.")] = 1,
    frames: Annotated[int, typer.Option(help="Number of stereo pairs.")] = 120,
    width: Annotated[int, typer.Option(help="Frame width in pixels.")] = 1360,
    jobs: Annotated[
        int | None, typer.Option(help="Frames rendered at a time; all cores by default.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Render a synthetic mission with exact labels, masks and depth."""
    from tokt.labels.synthetic.mission import simulate_mission

    mission = simulate_mission(
        folder, seed=seed, n_frames=frames, width=width, jobs=jobs, progress=output.progress
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
