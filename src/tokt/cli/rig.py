"""`tokt calibrate` and `tokt depth`: two cameras, and the depth that their pairs show."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from tokt.features.common.errors import ToktError
from tokt.features.common.terminal import say

from .options import FramesOption, JsonOption, is_written
from .output import answer, progress
from .output import print_line as print

if TYPE_CHECKING:
    from tokt.features.frames.mission import Mission
    from tokt.inference.stereo.calibration import StereoCalibration
    from tokt.training.rig.calibrate.checkerboard import BoardCalibration
    from tokt.training.rig.calibrate.self_calibration import SelfCalibration, StartingRig

NOT_GOOD = 1
"""Exit code of --check for a calibration that is shifted or unusable."""
_REASONS = 3  # why pairs could not be judged: so many reasons are told, the most frequent ones


def calibrate(
    context: typer.Context,
    sources: Annotated[
        list[Path],
        Argument(
            metavar="MISSION|FILE...",
            help="Folder with Left/ and Right/: a mission, or checkerboards with --board. Or a "
            "calibration of another tool to convert, in one file or several.",
        ),
    ],
    output: Annotated[
        Path | None,
        Option("-o", "--output", help="Calibration file to write: .yml, .json or .xml."),
    ] = None,
    baseline: Annotated[
        float | None,
        Option(help="Distance between the cameras in mm. Default: 305.5 (the 2016 mission)."),
    ] = None,
    focal: Annotated[
        float | None, Option(help="Focal length in px. Default: 2222.7 at a width of 1360 px.")
    ] = None,
    start: Annotated[
        Path | None, Option(help="Start from this calibration's focal length and distortion.")
    ] = None,
    free: Annotated[
        str | None,
        Option(
            help="Parameters to estimate besides rotation, direction and focal ratio: of "
            "k1,k2,focal,principal, or none. Default: k1,k2; with --start none."
        ),
    ] = None,
    frames: Annotated[str | None, Option(help="Use these frames only, such as 160-205.")] = None,
    fit: Annotated[
        str,
        Option(
            help="Frame numbers to fit to. even, odd: tested on the others. alternate: tested on "
            "every second one, then fitted to all. all: not tested."
        ),
    ] = "alternate",
    report: Annotated[Path | None, Option(help="HTML report to write.")] = None,
    check: Annotated[
        bool,
        Option(
            "--check",
            help="Check --calibration on the mission's frames instead. Exit code 0: good; 1: "
            "shifted or unusable.",
        ),
    ] = False,
    calibration: Annotated[
        Path | None, Option(help="Calibration file to check, of any form.")
    ] = None,
    board: Annotated[
        str | None, Option(help="Inner corners of a checkerboard, such as 9x6.")
    ] = None,
    square: Annotated[float | None, Option(help="Side of the board's squares in mm.")] = None,
    json: JsonOption = False,
) -> None:
    """Calibrate two cameras, or convert another tool's calibration.

    Two cameras are calibrated from a mission's frames or from checkerboards. A file is converted
    into the form that `tokt run` reads.
    """
    if any(path.is_file() for path in sources):
        _convert(context, sources, output, json)
        return
    mission = _one_mission(sources)
    if check:
        if calibration is None:
            raise ToktError("--check needs --calibration FILE")
        _check(mission, calibration, frames, json)
        return
    if calibration is not None:
        raise ToktError("--calibration goes with --check; to start from a file, use --start")
    if output is None:
        raise ToktError("give -o FILE to write the calibration to (or --check to measure one)")
    _check_names(output, report)
    if board is not None:
        _from_boards(mission, board, square, output, json)
        return
    if square is not None:
        raise ToktError("--square goes with --board")
    from tokt.features.frames.mission import open_mission, parse_frames
    from tokt.inference.stereo.calibration_writer import write_calibration
    from tokt.training.rig.calibrate.self_calibration import PARTS, self_calibrate

    known = _start(mission, baseline, focal, start, free)
    if fit not in PARTS:
        raise ToktError(f"--fit is one of {', '.join(PARTS)}, not {fit!r}")
    say(f"start: {known.words}")
    wanted = parse_frames(frames) if frames else None
    opened = open_mission(mission)
    found = self_calibrate(opened, known, progress, wanted, fit)
    write_calibration(output, found.calibration, found.notes())
    if report is not None:
        from tokt.training.rig.calibrate.report import write_report

        write_report(report, found, opened)
    value = {"calibration": str(output), **found.to_json()}
    answer(json, value, lambda: _print_self(found, output, report))


def _one_mission(sources: list[Path]) -> Path:
    if len(sources) > 1:
        raise ToktError(f"calibrate takes one mission, not {len(sources)}")
    return sources[0]


def _convert(context: typer.Context, files: list[Path], output: Path | None, json: bool) -> None:
    """Write a calibration of another tool's form as the file that a run reads."""
    from tokt.inference.stereo.calibration_writer import write_calibration
    from tokt.training.calibration.any_form import describe_calibration_file

    for name in sorted(context.params.keys() - {"sources", "output", "json"}):
        if is_written(context, name):
            raise ToktError(f"--{name} is for a mission, not for converting a calibration file")
    if output is None:
        raise ToktError("give -o FILE to write the calibration to")
    _check_names(output, None)
    described = describe_calibration_file(*files)
    calibration = described.usable(say)
    names = ", ".join(file.name for file in files)
    write_calibration(output, calibration, {"converted_from": described.form, "files": names})
    width, height = calibration.frame_size
    found = {
        "calibration": str(output),
        "form": described.form,
        "frame_size": [width, height],
        "oddities": described.oddities,
    }
    answer(json, found, lambda: print(f"written: {output}, from {described.form}"))


def _check_names(output: Path, report: Path | None) -> None:
    """Refuse names that could not be written before minutes of work, not after."""
    known = (".yml", ".yaml", ".json", ".xml")
    if output.suffix.lower() not in known:
        raise ToktError(f"a calibration file ends in {', '.join(known)}, not as {output.name}")
    for file in (output, report):
        if file is not None and not file.absolute().parent.is_dir():
            raise ToktError(f"there is no folder {file.parent} to write {file.name} to")


def _start(
    mission: Path, baseline: float | None, focal: float | None, start: Path | None, free: str | None
) -> StartingRig:
    from tokt.features.frames.mission import open_mission
    from tokt.training.calibration.any_form import describe_calibration_file
    from tokt.training.rig.calibrate.self_calibration import (
        BASELINE_MM,
        parse_free,
        plain_start,
        start_from,
    )

    for name, value in (("--baseline", baseline), ("--focal", focal)):
        if value is not None and not 0 < value < float("inf"):
            raise ToktError(f"{name} is a positive number, not {value:g}")
    if focal is not None and start is not None:
        raise ToktError("give --focal or --start, not both")
    opened = open_mission(mission)
    freed = None if free is None else parse_free(free)
    length = baseline or BASELINE_MM
    if baseline is None:
        say(f"baseline taken as {BASELINE_MM} mm, that of the mission of 2016 (--baseline)")
    if start is None:
        return plain_start(opened, length, focal, freed)
    given = describe_calibration_file(start)
    return start_from(given.calibration, not given.refusals, opened, length, freed)


def _print_self(found: SelfCalibration, output: Path, report: Path | None) -> None:
    before, after = found.before, found.after
    print(f"{found.mission}: {len(found.matches)} frames with enough points that both cameras see")
    print(f"  {found.split_words()}")
    print(
        f"  vertical error {'held out' if found.held_out else 'NOT held out'}, full-resolution px, "
        f"{len(after.row_px)} matches:"
    )
    print(f"    before  median {before.median_px:7.2f}  p90 {before.p90_px:7.2f}")
    print(f"    after   median {after.median_px:7.2f}  p90 {after.p90_px:7.2f}")
    print(f"  {'':13}{'value':>12}{'sigma':>11}{'all free':>11}{'sigma then':>11}")
    for one in found.uncertainty.parameters:
        figures = "".join(
            f"{'-' if value is None else format(value, '.3g' if i % 2 == 0 else '.5g'):>11}"
            for i, value in enumerate((one.sigma, one.value_all_free, one.sigma_all_free))
        )
        print(f"  {one.name:13}{one.value:12.6g}{figures} {one.unit:4}{one.words()}")
    print(
        "  Pictures have no scale: every distance is as right as the baseline. "
        + _focal_words(found)
    )
    print(f"written: {output}" + (f", {report}" if report else ""))


def _focal_words(found: SelfCalibration) -> str:
    here, *others = found.uncertainty.focal
    words = [
        f"{step.focal_px:.0f} px gives {step.vertical_median_px:.2f} px and depths "
        f"x {step.depth_scale:.2f}"
        for step in others
    ]
    return (
        f"With f = {here.focal_px:.0f} px the vertical error is {here.vertical_median_px:.2f} px; "
        f"{', '.join(words)}."
    )


def _check(mission: Path, file: Path, frames: str | None, json: bool) -> None:
    """Measure a calibration on a mission's frames, and end with the exit code of the answer."""
    from tokt.features.frames.mission import frame_size, open_mission
    from tokt.training.calibration.any_form import describe_calibration_file
    from tokt.training.rig.calibrate.vertical_error import GOOD, UNUSABLE, measurable

    described = describe_calibration_file(file)
    opened = open_mission(mission)
    found: dict[str, Any] = {"calibration": str(file), "mission": opened.name,
                             "form": described.form, "oddities": described.oddities}  # fmt: skip
    size, given = frame_size(opened), described.calibration.frame_size
    faults = list(described.refusals)
    if given != size:
        mission_is = f"the mission's are {size[0]}x{size[1]}"
        faults.append(f"it is of {given[0]}x{given[1]} frames, {mission_is}")
    elif measurable(described.calibration):
        found |= _measured(described.calibration, opened, frames)
    if faults:
        found |= {"state": UNUSABLE, "reason": "; ".join(faults)}
    answer(json, found, lambda: _print_check(found))
    if found["state"] != GOOD:
        raise typer.Exit(NOT_GOOD)


def _measured(
    calibration: StereoCalibration, mission: Mission, frames: str | None
) -> dict[str, Any]:
    from tokt.features.frames.mission import format_frames, parse_frames
    from tokt.training.rig.calibrate.frame_selection import match_mission
    from tokt.training.rig.calibrate.vertical_error import CHECKED_FRAMES, check_calibration

    wanted = parse_frames(frames) if frames else None
    matches = match_mission(mission, wanted, progress, CHECKED_FRAMES, spread=True)
    return {
        **check_calibration(calibration, matches).to_json(),
        "frames": format_frames(one.frame for one in matches),
    }


def _print_check(answer: dict[str, Any]) -> None:
    print(f"{answer['calibration']} on {answer['mission']}: {answer['state']}: {answer['reason']}")
    for oddity in answer["oddities"]:
        print(f"  {oddity}")
    if "vertical_error" not in answer:
        return
    error, trimmed = answer["vertical_error"], answer["after_trim"]
    print(
        f"  vertical error at full resolution: median {error['median']:.2f} px, "
        f"p90 {error['p90']:.2f} px ({error['matches']} matches in frames {answer['frames']})"
    )
    print(
        f"  with a row trim of {answer['trim_px']:+.2f} px: median {trimmed['median']:.2f} px, "
        f"p90 {trimmed['p90']:.2f} px"
    )
    print("  rows alone say nothing of the zero of disparity: distances are not checked")


def _from_boards(folder: Path, board: str, square: float | None, output: Path, json: bool) -> None:
    from tokt.features.frames.mission import open_mission
    from tokt.inference.stereo.calibration_writer import write_calibration
    from tokt.training.rig.calibrate.checkerboard import calibrate_boards, parse_board

    if square is None or not 0 < square < float("inf"):
        raise ToktError("--board needs --square MM, the side of the board's squares")
    found = calibrate_boards(open_mission(folder), parse_board(board), square, progress)
    write_calibration(output, found.calibration, found.notes())
    value = {"calibration": str(output), **found.to_json()}
    answer(json, value, lambda: _print_boards(found, output))


def _print_boards(found: BoardCalibration, output: Path) -> None:
    print(f"{len(found.frames)} of {found.looked_at} pairs show the whole board in both pictures")
    print(
        f"  reprojection error: left {found.left_px:.3f} px, right {found.right_px:.3f} px, "
        f"both together {found.stereo_px:.3f} px (root mean square)"
    )
    error = found.held_out
    print(
        f"  vertical error on {len(found.test_frames)} boards held out of a first fit: median "
        f"{error.median_px:.3f} px, p90 {error.p90_px:.3f} px. The calibration is fitted to all "
        "boards"
    )
    baseline = found.baseline_mm
    print(f"  the cameras stand {baseline:.2f} mm apart, focal length {found.focal_px:.1f} px")
    print(f"written: {output}")


def depth(
    mission: Annotated[Path, Argument(help="Mission folder with Left/ and Right/.")],
    calibration: Annotated[Path, Option(help="Stereo calibration file.")],
    ply: Annotated[Path | None, Option(help="PLY file for a point cloud.")] = None,
    ply_frame: Annotated[
        int | None, Option(help="Frame of the point cloud. Default: the nearest one.")
    ] = None,
    ply_farthest: Annotated[
        float, Option(help="Farthest distance in the point cloud, in metres.", min=0)
    ] = 10.0,
    fused: Annotated[
        bool,
        Option(
            "--fused",
            help="Write one cloud of what 3 or more frames agree on: --ply, or fused.ply.",
        ),
    ] = False,
    odometry: Annotated[
        Path | None,
        Option(
            help="Poses of the left camera, as tokt run takes them. Default: those of --log, else "
            "estimated from the frames, with errors that add up."
        ),
    ] = None,
    log: Annotated[
        Path | None, Option(help="Log of a run over these frames, for places and odometry.")
    ] = None,
    export: Annotated[
        str | None,
        Option(metavar="colmap|opensfm", help="Folder in --out for it: frames, rig, poses."),
    ] = None,
    out: Annotated[
        Path, Option(help="Folder for depth.csv, depth.png, depth.json and frames/depth_N.png.")
    ] = Path("depth-out"),
    frames: FramesOption = None,
    pictures: Annotated[
        str | None,
        Option(
            help="Frames to draw, such as 170,186, or none. Default: those of --frames, else a "
            "dozen with an obstacle."
        ),
    ] = None,
    stereo: Annotated[str, Option(help="Block matching, or semi-global matching.")] = "bm",
    scale: Annotated[float, Option(help="Scale at which frames are matched, at most 1.")] = 0.5,
    rate: Annotated[float | None, Option(help="Frames per second, for the closing speed.")] = None,
    json: JsonOption = False,
) -> None:
    """Measure depth in a mission's stereo pairs.

    It writes pictures, depth by frame and a point cloud. A pair that cannot be judged is a row that
    says why. Matched pixels have a depth, open water has none: what is not matched is not clear.
    """
    from tokt.features.frames.mission import open_mission, parse_frames
    from tokt.training.calibration.any_form import read_calibration_file
    from tokt.training.rig.depth.run import DepthRequest, run_depth

    chosen = None if frames is None else parse_frames(frames)
    opened = open_mission(mission)
    known = read_calibration_file(calibration, say)
    drawn = None if pictures is None else [] if pictures == "none" else parse_frames(pictures)
    clouds = ply, ply_frame, ply_farthest, fused, odometry, log, export
    request = DepthRequest(chosen, drawn, rate, stereo, scale, *clouds)
    found = run_depth(opened, known, out, request, progress)
    answer(json, found, lambda: _print_depth(found, out))


def _print_depth(found: dict[str, Any], out: Path) -> None:
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
        of = f"frame {cloud['frame']}" if "frame" in cloud else f"frames {cloud['frames']}"
        print(
            f"point cloud: {cloud['file']}, {cloud['points']} points of {of} "
            f"({cloud['matched']} matched, {cloud['out_of_range']} out of range, "
            f"{cloud['outliers']} outliers)"
        )
        print(f"  metres in {cloud['axes']}")
    if found["export"]:
        words = "written: {folder}, {pairs} pairs, {poses} with a pose, {places} with a place"
        print(f"{words}\n  poses: {{axes}}".format(**found["export"]))


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
