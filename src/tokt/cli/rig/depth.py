"""`tokt depth`: depth pictures, a point cloud, and depth by frame."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer

from tokt.cli.options import JsonOption
from tokt.cli.output import print_json, progress

_REASONS = 3
"""Why pairs could not be judged: so many reasons are told, the most frequent ones."""


def depth(
    mission: Annotated[Path, typer.Argument(help="Mission folder with Left/ and Right/.")],
    calibration: Annotated[
        Path, typer.Option("--calibration", metavar="FILE", help="Stereo calibration file.")
    ],
    ply: Annotated[
        Path | None, typer.Option(metavar="FILE", help="PLY file for a point cloud of one frame.")
    ] = None,
    ply_frame: Annotated[
        int | None, typer.Option(help="Frame of the point cloud. Default: the nearest one.")
    ] = None,
    ply_farthest: Annotated[
        float, typer.Option(help="Farthest distance in the point cloud, in metres.", min=0)
    ] = 10.0,
    out: Annotated[
        Path,
        typer.Option(help="Folder for depth.csv, depth.png, depth.json and frames/depth_N.png."),
    ] = Path("depth-out"),
    frames: Annotated[
        str | None, typer.Option(help="Use these frames only, such as 1-99,132-246.")
    ] = None,
    pictures: Annotated[
        str | None,
        typer.Option(
            help="Frames to draw, such as 170,186, or none. Default: those of --frames, else a "
            "dozen with an obstacle."
        ),
    ] = None,
    stereo: Annotated[str, typer.Option(help="bm (block matching) or sgbm (semi-global).")] = "bm",
    scale: Annotated[
        float, typer.Option(help="Scale at which frames are matched, at most 1.")
    ] = 0.5,
    rate: Annotated[
        float | None, typer.Option(metavar="FPS", help="Frames per second, for the closing speed.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Measure depth in a mission's stereo pairs: pictures, depth by frame, a point cloud.

    A pair that cannot be judged is a row that says why. Matched pixels only: open water has no
    depth, and what is not matched is not clear.
    """
    from tokt.cli.stereo_file import read_calibration_file
    from tokt.features.frames.mission import open_mission, parse_frames
    from tokt.training.rig.depth.run import DepthRequest, run_depth

    chosen = None if frames is None else parse_frames(frames)
    opened = open_mission(mission)
    known = read_calibration_file(calibration)
    request = DepthRequest(
        chosen,
        None if pictures is None else [] if pictures == "none" else parse_frames(pictures),
        rate,
        stereo,
        scale,
        ply,
        ply_frame,
        ply_farthest,
    )
    found = run_depth(opened, known, out, request, progress)
    if json:
        print_json(found)
    else:
        _print(found, out)


def _print(found: dict[str, Any], out: Path) -> None:
    from tokt.inference.verdict import UNKNOWN

    print(
        f"{found['mission']}: {found['frames']} pairs, {found['obstacle']} with an obstacle, "
        f"{found['clear']} clear, {found['unknown']} unknown"
    )
    reasons = Counter(row["health"] for row in found["rows"] if row["status"] == UNKNOWN)
    for reason, count in reasons.most_common(_REASONS):
        print(f"  unknown in {count}: {reason}")
    if found["detected"]:
        first, last = found["detected"]
        gaps = found["gaps"]
        print(
            f"  first of three frames in a row with an obstacle: {first}; last: {last}; "
            + (f"{gaps['count']} without depth: {gaps['frames']}" if gaps["count"] else "no gap")
        )
    if found["nearest"]:
        least = found["nearest"]
        print(
            f"  nearest: frame {least['frame']}, near end {least['distance_m']:.2f} m, "
            f"median {least['median_m']:.2f} m"
        )
    for measure, words in (("median_m", "median depth"), ("distance_m", "near end")):
        if found[measure]:
            print(f"  {words}: {_steadiness(found[measure], *found['detected'])}")
    if found["clear_valid_fraction"]:
        clear = found["clear_valid_fraction"]
        where = f" (frames {clear['frames_above_0']})" if clear["frames_above_0"] else ""
        print(f"  matched in clear frames: at most {clear['max']:.2g} of the view{where}")
    drawn = len(found["pictures"])
    print(f"written: {out / 'depth.csv'}, depth.png, depth.json and {drawn} pictures in frames/")
    if found["ply"]:
        cloud = found["ply"]
        print(
            f"point cloud: {cloud['file']}, {cloud['points']} points of frame {cloud['frame']} "
            f"({cloud['matched']} matched, {cloud['out_of_range']} out of range, "
            f"{cloud['outliers']} outliers)"
        )


def _steadiness(figures: dict[str, Any], first: int, last: int) -> str:
    """How a depth runs over the frames with an obstacle, the first to the last."""
    turn = figures["nearest_frame"]
    if figures["monotone"]:
        words = f"falls to frame {turn} and rises after it"
        if turn in (first, last):
            words = f"falls to frame {turn}" if turn == last else f"rises from frame {turn}"
    else:
        parts = [
            f"{name} at {figures[key]}"
            for key, name in (("not_falling", "does not fall"), ("not_rising", "does not rise"))
            if figures[key]
        ]
        words = f"least at frame {turn}, {'; '.join(parts)}"
    jitter = figures["jitter_m"]
    if jitter is None:
        return words
    worst = f"{jitter['max']:.3f} m at most (frame {jitter['at_frame']})"
    return f"{words}; beside the mean of its neighbours {jitter['median']:.3f} m median, {worst}"
